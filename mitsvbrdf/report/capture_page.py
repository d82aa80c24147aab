"""The quality of a capture: its numbers as JSON, and a page that shows them."""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..capture.photo import Photo
from ..capture.quality.next_view import HIGHLIGHT_ANGLE
from ..capture.stages import CaptureResult
from ..errors import CaptureError
from ..io import files
from ..io.decode import UNTURNED
from ..io.provenance import machine, versions
from .page import write_page
from .pictures import at_most, picture_uri, png_uri

SCHEMA_VERSION = 1
THUMBNAIL, FULL = 240, 400  # pixels a side: of a photo on the page; of a rejected photo when it is read
PLAN_REACH = 0.75  # least half side of the plan, in patch sides
# colours of the coverage map; distinct in grey, too
SEEN, UNSEEN = (0.93, 0.80, 0.50), (0.36, 0.42, 0.50)


def write_quality(result: CaptureResult, folder: str | Path) -> None:
    """Write ``quality.json`` and ``quality.html``."""
    folder, record = Path(folder), quality_record(result)
    files.write_json(folder / "quality.json", record)
    rejected = [(photo.name, _shown(photo)) for photo in result.photos if photo.name in result.rig.rejected]
    pictures = {name: picture_uri(at_most(photo, THUMBNAIL), 0)
                for name, photo in [*zip(result.used, result.capture.photos), *rejected] if photo is not None}
    # light where some photo shows a highlight, dark where none does
    coverage = torch.where((result.coverage <= HIGHLIGHT_ANGLE)[..., None], torch.tensor(SEEN),
                           torch.tensor(UNSEEN)).float()
    title = f"Capture: {result.photos[0].path.absolute().parent.name}"
    write_page(folder / "quality.html", "report/capture.html", title=title, record=record,
               pictures=pictures, plan=_plan(result), coverage=png_uri(coverage))


def quality_record(result: CaptureResult) -> dict:
    """All numbers of the page; docs/formats.md explains the main ones."""
    number = {name: f"{i:02d}" for i, name in enumerate(result.used)}
    rows, known = [], result.capture.calibrated
    for photo in result.photos:
        name, quality = photo.name, result.qualities.get(photo.name)
        pose = result.rig.poses.get(name) if known else None
        numbers = {key: value for key, value in vars(quality).items() if key != "name"} if quality else {}
        rows.append({"name": name, "used": name in number, "number": number.get(name),
                     "reason": result.rig.rejected.get(name),
                     "tags": result.rig.tags.get(name),
                     "reprojection_error": result.rig.errors.get(name), "exif": photo.exif,
                     "camera": None if pose is None else np.asarray(pose.position).tolist(), **numbers})
    next_view, shading = result.next_view, result.shading
    return {
        "schema_version": SCHEMA_VERSION, "photos": rows, "used": len(result.used),
        "calibration": result.capture.calibration, "unit": result.rig.unit, "patch": result.rig.size,
        "resolution": result.capture.resolution, "transfer": result.capture.transfer,
        "coverage": {"share": result.covered if known else None,
                     "lobe_degrees": math.degrees(HIGHLIGHT_ANGLE)},
        "stand": None if next_view is None else {"camera": list(next_view.camera), "gain": next_view.gain,
                                                 "near": result.used[next_view.near],
                                                 "words": next_view.words},
        "flash": list(map(float, result.rig.lens.flash)),
        "vignetting": list(map(float, result.rig.lens.vignetting)),
        "focal": float(result.rig.lens.focal) if known else None,
        "log_exposure": {name: value for name, value in (shading.log_exposure if shading else {}).items()
                         if name in number},
        "warnings": list(result.warnings), "versions": versions(), "machine": machine()}


def _shown(photo: Photo) -> Tensor | None:
    """A photo as viewers show it, upright and small; None if it cannot be read."""
    try:
        pixels = photo.pixels(FULL)
    except CaptureError:
        return None
    pixels = np.rot90(pixels, -UNTURNED.get(photo.orientation, 0))
    display = torch.from_numpy(pixels / np.iinfo(pixels.dtype).max).float()
    return display.clamp(0, 1) ** (1 / 2.2) if photo.linear else display


def _plan(result: CaptureResult) -> dict:
    """Cameras seen from above, in patch sides with y down, for the page's drawing."""
    sides = {name: (np.asarray(pose.position) / result.rig.size).tolist()
             for name, pose in result.rig.poses.items()}
    next_place = None if result.next_view is None else [x / result.rig.size for x in result.next_view.camera]
    places = [*sides.values(), *([next_place] if next_place else [])]
    half = max(PLAN_REACH, 0.1 + max(abs(x) for place in places for x in place[:2]))
    dots = [(name, x, -y) for name, (x, y, _) in sides.items()]
    # a number is below its dot if another dot is in its way
    cameras = [(name, x, y, y + (0.075 if any(abs(x - u) < 0.06 and 0 < y - v < 0.1 for _, u, v in dots)
                                 else -0.035)) for name, x, y in dots]
    return {"half": half, "cameras": cameras, "stand": next_place and (next_place[0], -next_place[1])}
