"""How good a capture is: its numbers as JSON, a page of them, and a contact sheet."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..capture.photo import UNTURNED, Photo
from ..capture.quality.next_view import HIGHLIGHT_ANGLE
from ..capture.stages import CaptureResult
from ..errors import CaptureError
from ..io import files
from ..io.provenance import machine, versions
from .canvas import LABEL_HEIGHT, PICTURE_GAP, SHEET_MARGIN, SHEET_WIDTH, Canvas
from .colours import SHEET_ACCENT, SHEET_BACK, SHEET_QUIET, SHEET_TEXT
from .page import write_page
from .pictures import at_most, picture_uri, png_uri

SCHEMA_VERSION = 1
A_ROW, SMALL_A_ROW = 5, 8  # photos in a row of the contact sheet: used, rejected
THUMBNAIL, FULL = 240, 400  # pixels on the page, and of a rejected photo as it is read
PLAN_REACH = 0.75  # half the side of the plan, patch sides, at least
# of the coverage map; readable beside each other in grey, too
SEEN, UNSEEN = (0.93, 0.80, 0.50), (0.36, 0.42, 0.50)


def write_quality(result: CaptureResult, folder: str | Path) -> None:
    """Write ``quality.json``, ``quality.html`` and ``contact.jpg``.

    Raises:
        OutputError: the folder cannot be written to.
    """
    folder, record = Path(folder), quality_record(result)
    rejected = {photo.name: _shown(photo) for photo in result.photos if photo.name in result.rig.rejected}
    files.write_json(folder / "quality.json", record)
    _contact_sheet(folder / "contact.jpg", result, rejected)
    pictures = {name: picture_uri(at_most(photo, THUMBNAIL), 0) for name, photo in
                [*zip(result.used, result.capture.photos),
                 *((n, p) for n, p in rejected.items() if p is not None)]}
    write_page(folder / "quality.html", "report/capture.html", title=f"Capture: {_name(result)}",
               record=record, pictures=pictures, plan=_plan(result),
               coverage=png_uri(_coverage_picture(result.coverage)))


def quality_record(result: CaptureResult) -> dict:
    """All numbers of the page; docs/formats.md explains each."""
    number = {name: f"{i:02d}" for i, name in enumerate(result.used)}
    rows = []
    for photo in result.photos:
        name, quality = photo.name, result.qualities.get(photo.name)
        pose = result.rig.poses.get(name)
        numbers = {key: value for key, value in vars(quality).items() if key != "name"} if quality else {}
        rows.append({"name": name, "used": name in number, "number": number.get(name),
                     "reason": result.rig.rejected.get(name),
                     "reprojection_error": result.rig.errors.get(name), "exif": photo.exif,
                     "camera": None if pose is None else np.asarray(pose.position).tolist(), **numbers})
    next_view, shading = result.next_view, result.shading
    return {
        "schema_version": SCHEMA_VERSION, "photos": rows, "used": len(result.used),
        "calibration": result.capture.calibration, "unit": result.rig.unit, "patch": result.rig.size,
        "resolution": result.capture.resolution, "transfer": result.capture.transfer,
        "coverage": {"share": result.covered, "lobe_degrees": math.degrees(HIGHLIGHT_ANGLE)},
        "stand": None if next_view is None else {"camera": list(next_view.camera), "gain": next_view.gain,
                                                 "near": result.used[next_view.near],
                                                 "words": next_view.words},
        "flash": list(map(float, result.rig.lens.flash)),
        "vignetting": list(map(float, result.rig.lens.vignetting)), "focal": float(result.rig.lens.focal),
        "log_exposure": {name: value for name, value in (shading.log_exposure if shading else {}).items()
                         if name in number},
        "warnings": list(result.warnings), "versions": versions(), "machine": machine()}


def _name(result: CaptureResult) -> str:
    return result.photos[0].path.absolute().parent.name


def _shown(photo: Photo) -> Tensor | None:
    """A photo as its owner knows it, upright and small; None where it cannot be read."""
    try:
        pixels = photo.pixels(FULL)
    except CaptureError:
        return None
    pixels = np.rot90(pixels, -UNTURNED.get(photo.orientation, 0))
    display = torch.from_numpy(pixels / np.iinfo(pixels.dtype).max).float()
    return display.clamp(0, 1) ** (1 / 2.2) if photo.linear else display


def _coverage_picture(angle: Tensor) -> Tensor:
    """Light where some photo shows a highlight, dark where none does, R x R x 3."""
    return torch.where((angle <= HIGHLIGHT_ANGLE)[..., None], torch.tensor(SEEN),
                       torch.tensor(UNSEEN)).float()


def _plan(result: CaptureResult) -> dict:
    """Cameras seen from above, in patch sides with y down, for the page's drawing."""
    sides = {name: (np.asarray(pose.position) / result.rig.size).tolist()
             for name, pose in result.rig.poses.items()}
    next_place = None if result.next_view is None else [x / result.rig.size for x in result.next_view.camera]
    places = [*sides.values(), *([next_place] if next_place else [])]
    half = max(PLAN_REACH, 0.1 + max(abs(x) for place in places for x in place[:2]))
    return {"half": half, "cameras": [(name, x, -y) for name, (x, y, _) in sides.items()],
            "stand": next_place and (next_place[0], -next_place[1])}


def _contact_sheet(path: Path, result: CaptureResult, rejected: dict[str, Tensor | None]) -> None:
    """Rectified photos with numbers and a dot below each camera; then the rejected ones with the reason."""
    large = (SHEET_WIDTH - 2 * SHEET_MARGIN - (A_ROW - 1) * PICTURE_GAP) // A_ROW
    small = (SHEET_WIDTH - 2 * SHEET_MARGIN - (SMALL_A_ROW - 1) * PICTURE_GAP) // SMALL_A_ROW
    header, reason_height = 96, 112
    rows, small_rows = -(-len(result.used) // A_ROW), -(-len(rejected) // SMALL_A_ROW)
    below = header + rows * (large + LABEL_HEIGHT)
    sheet = Canvas(below + 10 + (LABEL_HEIGHT if rejected else 0) + small_rows * (small + reason_height))
    sheet.text(SHEET_MARGIN, 52, _name(result), 22, SHEET_TEXT, weight="bold")
    sheet.text(SHEET_WIDTH - SHEET_MARGIN, 52, f"{len(result.used)} of {len(result.photos)} photos used", 16,
               SHEET_ACCENT, weight="bold", ha="right")
    patch = f"patch of {result.rig.size:.3g} cm; " if result.rig.unit == "cm" else ""
    sheet.text(SHEET_MARGIN, 82, f"{patch}a dot is below where the camera stood", 11, SHEET_QUIET)
    for i, (name, photo) in enumerate(zip(result.used, result.capture.photos)):
        x, y = SHEET_MARGIN + i % A_ROW * (large + PICTURE_GAP), header + i // A_ROW * (large + LABEL_HEIGHT)
        sheet.image(x, y, large, at_most(photo, 512))
        at = np.asarray(result.rig.poses[name].position) / result.rig.size
        right, down = (int(large * np.clip(0.5 + way, 0.03, 0.97)) for way in (at[0], -at[1]))
        for points, colour in ((18, SHEET_BACK), (13, SHEET_ACCENT)):
            sheet.text(x + right, y + down, "●", points, colour, ha="center", va="center")
        sheet.text(x, y + large + 20, f"{i:02d}  {name}", 10, SHEET_TEXT)
    if rejected:
        sheet.text(SHEET_MARGIN, below + 22, "Rejected", 12, SHEET_TEXT)
    for i, (name, photo) in enumerate(rejected.items()):
        x = SHEET_MARGIN + i % SMALL_A_ROW * (small + PICTURE_GAP)
        y = below + LABEL_HEIGHT + i // SMALL_A_ROW * (small + reason_height)
        if photo is not None:
            side = max(photo.shape[:2])
            framed = torch.full((side, side, 3), 0.1)
            top, left = (side - photo.shape[0]) // 2, (side - photo.shape[1]) // 2
            framed[top : top + photo.shape[0], left : left + photo.shape[1]] = photo
            sheet.image(x, y, small, framed)
        reason = textwrap.wrap(result.rig.rejected[name], 30, max_lines=5, placeholder=" …")
        for n, line in enumerate([name, *reason]):
            sheet.text(x, y + small + 16 + 16 * n, line, 8, SHEET_QUIET if n else SHEET_TEXT)
    sheet.write(path)
