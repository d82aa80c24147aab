"""What a library holds, told from its manifest and its files."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ... import __version__
from ...errors import MapsError
from ...io.files import write_json
from ...io.json import load
from ..manifest import FILE, Manifest, now
from ..places.place import QUARANTINE, ROW

if TYPE_CHECKING:
    from ...capture import Capture
    from ...render import Renderer

INDEX = "library.json"
UNFINISHED = "running", "pending"
# Of a row, what its readers count with.
_KINDS = ROW | {"attempts": (int,), "tags": (list,), "method": (str,)}


def row_of(folder: Path, shown: Capture | None, engine: Renderer) -> dict:
    """What the list of materials says of a fit.

    Args:
        folder: of the fit.
        shown: its photos and some that it left out; None where it used all.
        engine: predicts those.
    """
    from ...evaluate import placed
    from ...evaluate.placement import predict
    from ...fit.record import record_in
    from ...fit.result import Fit

    record, error = record_in(folder), None
    if (folder / "report.json").is_file():
        error = load(folder / "report.json")["held_out_rmse"]
    elif shown is not None:
        fit = Fit.of_maps(folder)
        around = placed(shown, fit)
        unseen = around.pick([number for number in around.index if number not in fit.seen])
        error = predict(fit.svbrdf, unseen, engine, fit.flash_offset)[1]
    burn_in = [value for name, value in record["burn_in"].items() if name in ("specular", "roughness")]
    there = {name: name if (folder / name).is_file() else None for name in ("preview.jpg", "report.html")}
    return {"error": record["rerender_rmse"], "left_out_error": error, "burn_in": max(burn_in, default=None),
            "warnings": record["warnings"], "method": record["method"],
            "resolution": record["capture"]["resolution"],
            "photos": len(record["capture"]["photos"]), "date": now(), "preview": there["preview.jpg"],
            "report": there["report.html"]}


def rows(manifest: Manifest, wanted: bool = True) -> Iterator[dict]:
    """One row a material, as ``library.json`` has it.

    Args:
        manifest: of the library.
        wanted: whether results that a newer one of the same capture took the place of are left out.

    Raises:
        OutputError: a row holds something else.
    """
    for each in manifest.materials(wanted=wanted):
        try:
            row = _row(each)
            if wrong := next((name for name, kinds in _KINDS.items() if not isinstance(row[name], kinds)),
                             None):
                raise ValueError(f"its {wrong} is of another kind")
        except (ValueError, KeyError, TypeError, RecursionError) as reason:
            raise manifest.wrong(f"{reason} in the row of {each['name']}") from None
        yield row | {"log": _log(manifest.path.parent, row["folder"]) if row["state"] == "failed" else None}


def _log(home: Path, folder: str) -> str | None:
    """The path below the library of what a fit that failed printed; None where it printed nothing."""
    path = f"{folder}/log.txt"
    try:
        return path if (home / path).stat().st_size else None
    except OSError:
        return None


def _row(each: sqlite3.Row) -> dict:
    asked, known = json.loads(each["asked"]), json.loads(each["row"] or "null") or {}
    folder = each["folder"] if each["state"] != "failed" else f"{QUARANTINE}/{each['folder']}"

    def inside(name: str | None) -> str | None:
        return f"{folder}/{name}" if name else None

    empty: dict = {"error": None, "left_out_error": None, "burn_in": None, "warnings": [], "photos": None}
    return empty | known | {
        "name": each["name"], "id": each["identity"][:8], "folder": folder, "state": each["state"],
        "reason": each["reason"],
        "seconds": each["seconds"] or known.get("seconds"), "peak_bytes": each["peak_bytes"],
        "attempts": each["attempts"],
        "date": each["date"], "tags": json.loads(each["tags"]), "method": asked["config"]["method"],
        "resolution": known.get("resolution", asked["options"]["resolution"]), "worker": each["worker"],
        "host": each["host"],
        "source": each["source"], "options": each["own"],
        "preview": inside(known.get("preview")) if each["state"] == "done" else None,
        "report": inside(known.get("report")) if each["state"] == "done" else None}


def library_of(manifest: Manifest, title: str, progress: dict | None = None,
               command: str | None = None) -> dict:
    """All that the page of a library shows.

    Args:
        manifest: of the library.
        title: its name.
        progress: ``per_hour`` and ``left_seconds`` while a batch runs.
        command: that of the batch.
    """
    materials = list(rows(manifest))
    stopped = not progress and any(row["state"] in UNFINISHED for row in materials)
    found = {"title": title, "made": now(), "version": __version__, "stopped": stopped, "command": command,
             "materials": materials}
    return found | ({"progress": progress} if progress else {})


def write_library(home: Path, manifest: Manifest, title: str, progress: dict | None = None,
                  command: str | None = None) -> None:
    """Write ``library.json``, for pandas and others, and the page ``index.html``."""
    from .page import write_library_page

    library = library_of(manifest, title, progress, command)
    write_json(home / INDEX, _finite(library))
    write_library_page(home, _finite(library))


def _finite(value: Any) -> Any:
    """JSON without NaN and infinity, which it cannot hold: None in their place."""
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def open_library(folder: Path) -> Manifest:
    """The manifest of a library, to look at.

    Raises:
        MapsError: the folder is none.
    """
    if not (folder / FILE).is_file():
        raise MapsError("the LIBRARY of a batch", f"{folder}, which has no {FILE}",
                        "`mitsvbrdf batch` makes one")
    return Manifest(folder / FILE, readonly=True)
