"""Reading of ``fit.json``: the types of its fields, and checks for missing or wrong ones."""

from pathlib import Path
from typing import Any, Generic, TypeVar

from .. import color
from ..errors import ConfigError
from ..io.json import NUMBER, load, shape_error
from ..material.maps import CHANNELS

FILE = "fit.json"
SCHEMA_VERSION = 1
FORMER = {"left_out": "omitted", "finish": "detail"}  # names of fields in fit.json of earlier versions
LATER: dict[str, Any] = {"used": [], "calibrated_rmse": None}  # fields that earlier versions did not write
# Types of the fields that a page needs from fit.json; see :func:`~mitsvbrdf.io.json.shape_error`.
_SHAPE = {"method": str, "renderer": str, "bsdf": str, "rerender_rmse": NUMBER, "per_photo": {str: NUMBER},
    "calibrated_rmse": NUMBER | None,
    "confidence": {str: {"median_sd": NUMBER, "determined_share": NUMBER}}, "burn_in": {str: NUMBER},
    "warnings": [str], "stopped": str, "undone_steps": int, "undone": [{"iteration": int, "reason": str}],
    "seconds": NUMBER, "iterations": int, "seed": int,
    "config": {"fix": [str], "grey_specular": bool}, "command": {str: object},
    "omitted": [{"what": str, "why": str}], "used": [{"what": str, "how": str}],
    "capture": {"photos": [int], "resolution": int, "transfer": str, "calibrated": bool, "notes": [str]},
    "versions": {str: object}, "machine": {str: object}, "trace": [{str: NUMBER}]}
# Types of the fields from which views and light are read.
_KNOWN = {"views": {"size": NUMBER, "falloff": str, "camera": [[NUMBER]], "light": [[NUMBER]],
              "intensity": [[NUMBER]]},
    "flash_offset": dict | None, "capture": {"name": str | None, "photos": [int], "transfer": str}}
_BESIDE = {"calibration": dict, "variant": str | None, "detail": dict}  # fields that may be missing
# Sentences of the page about the origin of the views.
FROM = {"given": "The views are those of the capture's calibration",
        "sheet": "The views come from a sheet of tags",
        "photos": "The views come from features that the photos share",
        "none": "The views are a stated default geometry",
        "estimated": "The views were estimated from the rectified photos alone"}
_CALIBRATION = {"from": str, "estimated": bool, "refined": bool, "log_power_sd": NUMBER,
                "camera_sd": {str: [NUMBER]}, "log_exposure_sd": {str: NUMBER}, "flash_offset_sd": [NUMBER]}
T = TypeVar("T")


class Fact(Generic[T]):
    """An attribute of a fit that is read from its record; ``default`` if the record lacks the field.

    ``place``: names of the outer dicts, outermost first, then of the field. Default: the attribute's name.
    """

    def __init__(self, default: Any = ..., *place: str) -> None:
        self.default, self.place = default, place

    def __set_name__(self, owner: type, name: str) -> None:
        self.place = self.place or (name,)

    def __get__(self, fit: Any, owner: type | None = None) -> T:
        inside, name = fit.record, self.place[-1]
        for outer in self.place[:-1]:
            inside = inside.get(outer, {})
        return inside[name] if self.default is ... else inside.get(name, self.default)


def record_in(folder: Path) -> dict:
    """The content of a fit's ``fit.json``, unchecked; former names of fields are replaced.

    OSError: it cannot be read. ValueError: it is no JSON.
    """
    record = load(folder / FILE)
    for former, name in FORMER.items() if isinstance(record, dict) else ():
        if former in record and name not in record:
            record[name] = record.pop(former)
    return LATER | record if isinstance(record, dict) else record


def checked(record: dict) -> dict:
    """The given record. ValueError: names a field of a wrong type, or a missing field of views or light."""
    shape = _KNOWN | {name: kind for name, kind in (_SHAPE | _BESIDE).items() if name in record
                      and name not in _KNOWN}
    if wrong := shape_error(record, shape):
        raise ValueError(wrong)
    try:
        color.parts(record["capture"]["transfer"])
    except ConfigError:
        raise ValueError("unknown transfer") from None
    if record.get("bsdf", "roughconductor") not in CHANNELS:
        raise ValueError("unknown bsdf")
    return record


def missing(record: dict) -> str:
    """The first field that is missing or wrong for a page; empty text if there is none."""
    if record.get("schema_version") != SCHEMA_VERSION:
        return f"schema_version {record.get('schema_version')!r}"
    if wrong := shape_error(record, _SHAPE):
        return wrong
    if calibration := record.get("calibration"):
        # a deviation that was not estimated is None
        shape = {name: kind for name, kind in _CALIBRATION.items()
                 if not name.endswith("_sd") or calibration.get(name) is not None}
        if calibration.get("camera_sd"):
            shape["log_exposure_sd"] = {str: NUMBER}
        if wrong := shape_error(calibration, shape, "calibration"):
            return wrong
        if calibration["from"] not in FROM:
            return "calibration.from"
    names, count = list(record["per_photo"]), len(record["views"]["camera"])
    whole = (names == [f"{number:02d}" for number in record["capture"]["photos"]] and count == len(names) > 0
             and all({"seconds", "rerender_rmse"} <= set(row) for row in record["trace"]))
    return "" if whole else "per_photo, views and trace do not fit together"
