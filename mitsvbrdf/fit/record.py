"""``fit.json``: written, and read back."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import get_args

from .. import color
from ..capture import Capture
from ..errors import MapsError, MitsvbrdfError
from ..io import files
from ..io.json import NUMBER, error_text, load, shape_error
from ..io.provenance import machine, versions
from ..material.map_files import DETAIL, FORMER_DETAIL, MAP_FOLDERS, load_maps
from ..material.maps import CHANNELS, SVBRDF
from ..measure.burn_in import burn_in, local_burn_in
from ..render import Renderer, RendererName, make_renderer
from ..views import Falloff, Views
from .confidence import confidence
from .fixed_maps import described
from .methods import method_name
from .result import FitResult

FILE = "fit.json"
SCHEMA_VERSION = 1
NONE = type(None)
FORMER = {"left_out": "omitted", "finish": "detail"}  # names of fields in fit.json of earlier versions
# What a page needs of fit.json, as types; see :func:`~mitsvbrdf.io.json.shape_error`.
_SHAPE = {
    "method": str, "renderer": str, "bsdf": str, "rerender_rmse": NUMBER, "per_photo": {str: NUMBER},
    "calibrated_rmse": (*NUMBER, NONE),
    "confidence": {str: {"median_sd": NUMBER, "determined_share": NUMBER}}, "burn_in": {str: NUMBER},
    "warnings": [str],
    "stopped": str, "undone_steps": int, "undone": [{"iteration": int, "reason": str}],
    "restarts": [{"iteration": int, "reason": str}], "seconds": NUMBER, "iterations": int, "seed": int,
    "config": {"fix": [str], "grey_specular": bool}, "command": {str: object},
    "omitted": [{"what": str, "why": str}],
    "used": [{"what": str, "how": str}],
    "capture": {"photos": [int], "resolution": int, "transfer": str, "calibrated": bool, "notes": [str]},
    "versions": {str: object}, "machine": {str: object}, "trace": [{str: NUMBER}]}
# What the maps' views and light are read from.
_KNOWN = {
    "views": {"size": NUMBER, "falloff": str, "camera": [[NUMBER]], "light": [[NUMBER]],
              "intensity": [[NUMBER]]},
    "flash_offset": (dict, NONE), "capture": {"name": (str, NONE), "photos": [int], "transfer": str}}
# where they are there
_BESIDE = {"calibration": dict, "variant": (str, NONE), "detail": dict, "profile": dict}


def capture_name(capture: Capture) -> str:
    """Name of the folder of the photos; empty where they come from none."""
    return capture.source.name if capture.source else ""


@dataclass(frozen=True)
class SavedFit:
    """A fit as its folder tells it; the defaults are those of maps that come without one.

    Args:
        falloff: of its light.
        transfer: of its photos; None when unknown.
        flash_offset: (x, y) of the flash beside the lens in patch sides, or None.
        capture: name of the folder of its photos; None when unknown.
        seen: numbers of the photos it used.
        views: theirs, as fitted; None when unknown.
        method: how it was fitted; None when unknown.
        estimated: whether the views were estimated from the photos.
        light_power_factor: what the light power that the capture states is to be multiplied by, as its maps
            told.
        path: its folder.
        record: what its ``fit.json`` holds.
    """

    falloff: Falloff = "inverse-square"
    transfer: color.Transfer | None = None
    flash_offset: tuple[float, float] | None = None
    capture: str | None = None
    seen: tuple[int, ...] = ()
    views: Views | None = None
    method: str | None = None
    estimated: bool = False
    light_power_factor: float = 1.0
    path: Path = Path()
    record: dict = field(default_factory=dict, repr=False)

    def of(self, capture: Capture) -> bool:
        """Whether it was fitted to photos of this capture, as the names of the folders tell."""
        return self.capture == capture_name(capture)

    def label(self, capture: Capture, number: int) -> str:
        """Name of a photo, and whether the fit saw it, where it was fitted to this capture."""
        if not self.of(capture):
            return f"{number:02d}"
        return f"{number:02d} ({'seen' if number in self.seen else 'left out'})"

    @property
    def side_metres(self) -> float | None:
        """Side of its patch; None where no sheet in the photos told the unit of its views."""
        sheet = self.views is not None and self.record.get("calibration", {}).get("from") == "sheet"
        return self.views.size / 100 if sheet and self.views else None

    @property
    def fixed(self) -> list[str]:
        """Names of the maps that were not fitted."""
        return list(described(self.record["config"]["fix"]))

    @property
    def names(self) -> list[str]:
        """Names of the photos that the fit used."""
        return list(self.record["per_photo"])

    @cached_property
    def svbrdf(self) -> SVBRDF:
        """Its maps."""
        return load_maps(self.path / "maps", self.record["bsdf"])

    @cached_property
    def detail(self) -> SVBRDF | None:
        """One plausible draw of what no photo shows; None where none was asked for."""
        if "detail" not in self.record:
            return None
        folder = self.path / DETAIL
        return load_maps(folder if folder.is_dir() else self.path / FORMER_DETAIL, self.record["bsdf"])

    def renderer(self) -> Renderer | None:
        """That of the fit; None for one that is not ours."""
        name, variant = self.record["renderer"], self.record.get("variant")
        return make_renderer(name, variant or "llvm_ad_rgb") if name in get_args(RendererName) else None

    def unchanged(self) -> bool:
        """Whether its ``fit.json`` still says the same."""
        return record_in(self.path) == self.record


def record_in(folder: Path) -> dict:
    """What the ``fit.json`` of a fit holds, unchecked, with the present names of its fields.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no JSON.
    """
    record = load(folder / FILE)
    for former, name in FORMER.items() if isinstance(record, dict) else ():
        if former in record and name not in record:
            record[name] = record.pop(former)
    return record


def read_fit(maps: str | Path) -> SavedFit:
    """What is known of the fit that maps come from; the defaults where there is no ``fit.json``.

    Args:
        maps: a fit's folder, or the ``maps`` or ``detail`` folder inside it.

    Raises:
        MapsError: the ``fit.json`` cannot be understood.
    """
    folder = Path(os.path.abspath(maps))
    folder = folder.parent if folder.name in MAP_FOLDERS else folder
    return _read(folder) if (folder / FILE).is_file() else SavedFit(path=folder)


def read_whole_fit(folder: str | Path) -> SavedFit:
    """A fit's folder with all that its page needs.

    Raises:
        MapsError: it is none, or not a whole one.
    """
    folder = Path(folder)
    if not (folder / FILE).is_file():
        raise MapsError("a folder that `mitsvbrdf fit` wrote", f"{folder}, which has no {FILE}",
                        "give the OUT of a fit")
    fit = _read(folder)
    if wrong := _missing(fit):
        raise MapsError(f"a {FILE} of schema version {SCHEMA_VERSION}",
                        f"{folder / FILE}, whose {wrong} is missing or of another kind",
                        "fit again with this version")
    _ = fit.svbrdf  # maps that cannot be read are an error here
    return fit


def _read(folder: Path) -> SavedFit:
    try:
        record = record_in(folder)
        shape = _KNOWN | {name: kind for name, kind in (_SHAPE | _BESIDE).items() if name in record
                          and name not in _KNOWN}
        if wrong := shape_error(record, shape):
            raise ValueError(f"{wrong} is missing or of another kind")
        offset, views, known = record["flash_offset"], record["views"], record.get("calibration", {})
        fit = SavedFit(
            falloff=views["falloff"], transfer=record["capture"]["transfer"],
            flash_offset=None if offset is None else (float(offset["x"]), float(offset["y"])),
            capture=record["capture"]["name"], seen=tuple(record["capture"]["photos"]),
            views=Views.of(views["camera"], views["light"], views["intensity"], views["size"],
                           views["falloff"]),
            method=record.get("method"), estimated=known.get("estimated", False) is True,
            light_power_factor=float(known.get("power_told") or 1.0), path=folder, record=record)
        if fit.transfer not in get_args(color.Transfer):
            raise ValueError("unknown transfer")
        if record.get("bsdf", "roughconductor") not in CHANNELS:
            raise ValueError("unknown bsdf")
    except (OSError, ValueError, KeyError, TypeError, MitsvbrdfError) as reason:
        raise MapsError(f"a {FILE} of this package", f"{folder / FILE}: {error_text(reason)}",
                        "move it away to read the maps alone") from None
    return fit


def _missing(fit: SavedFit) -> str:
    """What the record lacks for a page; empty text where it is whole."""
    if fit.record.get("schema_version") != SCHEMA_VERSION:
        return "schema_version"
    # older records lack these
    if wrong := shape_error({"used": [], "calibrated_rmse": None, **fit.record}, _SHAPE):
        return wrong
    whole = (fit.names == [f"{number:02d}" for number in fit.seen]
             and fit.views is not None and len(fit.views) == len(fit.names) > 0
             and all({"seconds", "rerender_rmse"} <= set(row) for row in fit.record["trace"]))
    return "" if whole else "per_photo, views or trace"


def write_record(folder: Path, result: FitResult, capture: Capture, command: dict) -> None:
    """Write ``fit.json``: everything about a fit that fits into JSON; ``docs/formats.md`` explains each
    field.

    Args:
        folder: of the fit.
        result: the fit.
        capture: the photos it was fitted to.
        command: options of the command line, kept in it.

    Raises:
        OutputError: it cannot be written.
    """
    files.write_json(folder / FILE, _record(result, capture, command))


def _record(result: FitResult, capture: Capture, command: dict) -> dict:
    views = result.views
    offset = result.flash_offset
    return {
        "schema_version": SCHEMA_VERSION,
        "method": method_name(result.config),
        "renderer": result.renderer, "variant": result.variant, "bsdf": result.svbrdf.bsdf,
        "rerender_rmse": result.rerender_rmse,
        "per_photo": dict(zip(capture.names, result.per_photo)), "calibrated_rmse": result.calibrated_rmse,
        "confidence": confidence(result.deviations), "burn_in": burn_in(result.svbrdf, views),
        "local_burn_in": local_burn_in(result.svbrdf, views), "warnings": list(result.warnings),
        "stopped": result.stopped, "undone_steps": len(result.undone), "undone": list(result.undone),
        "restarts": list(result.restarts),
        "seconds": result.trace[-1]["seconds"], "iterations": result.trace[-1]["iteration"],
        "seed": result.config.seed, "config": asdict(result.config), "command": command,
        "omitted": [{"what": what, "why": why} for what, why in result.omitted],
        "used": [{"what": what, "how": how} for what, how in result.used],
        "capture": {"name": capture.source.name if capture.source else None, "photos": list(capture.index),
                    "resolution": capture.resolution, "transfer": capture.transfer,
                    "calibrated": capture.calibrated, "notes": list(capture.notes)},
        "views": {"size": views.size, "falloff": views.falloff, "camera": views.camera.tolist(),
                  "light": views.light.tolist(), "intensity": views.intensity.tolist()},
        "flash_offset": None if offset is None else {"x": offset[0] / views.size, "y": offset[1] / views.size,
                                                     "unit": "patch sides"},
        "calibration": result.calibration,
        **({"profile": result.profile} if result.profile else {}),
        **({"detail": result.detail_record} if result.detail_record else {}),
        "versions": versions(),
        "machine": machine(),
        "trace": result.trace,
    }
