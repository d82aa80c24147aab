"""The overview of a fit: one picture of its maps, photos and re-renderings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from torch import Tensor

from ..errors import CaptureError
from ..material.maps import CHANNELS, SVBRDF, TITLES, shown_map
from .canvas import HEADER_HEIGHT, LABEL_HEIGHT, PICTURE_GAP, SHEET_MARGIN, SHEET_WIDTH, Canvas, square_side
from .colours import SHEET_ACCENT, SHEET_QUIET, SHEET_TEXT

LARGEST_MAP, LARGEST_PHOTO = 397, 264  # pixels a side
SHOWN = 9  # photos


def write_sheet(path: str | Path, svbrdf: SVBRDF, photos: Tensor, rerendered: Tensor, *, rmse: float,
                per_photo: Sequence[float], names: Sequence[str], title: str, guess: Tensor | None = None,
                remarks: Mapping[str, str] | None = None) -> None:
    """Write one PNG, 1680 pixels wide: the maps, and below them photos, re-renderings and differences.

    Colour maps are shown in sRGB, roughness and metallic as they are, normals as (n + 1) / 2. At most nine
    photos are shown.

    Args:
        path: the PNG to write or replace.
        svbrdf: the material.
        photos: N x R x R x 3, display values in [0, 1].
        rerendered: the same shape, display values in [0, 1] (``color.to_display`` of the radiance).
        rmse: the error over all photos, in display values.
        per_photo: the error of each.
        names: a name for each photo.
        title: the heading.
        guess: guessed diffuse map, R x R x 3, linear, or None.
        remarks: a few words beside the name of some maps, by map.

    Raises:
        CaptureError: photos, re-renderings, errors and names of different number or shape.
        OutputError: the file cannot be written.
    """
    count = len(photos)
    if not count or photos.shape != rerendered.shape or not count == len(per_photo) == len(names):
        raise CaptureError("a re-rendering, an error and a name for each photo",
                           f"photos {tuple(photos.shape)}, re-rendered {tuple(rerendered.shape)}, "
                           f"{len(per_photo)} errors, {len(names)} names",
                           "give all of them for the same photos")
    shown = min(count, SHOWN)
    behind = {name: f"  ·  {remark}" for name, remark in (remarks or {}).items()}
    tiles = [(TITLES[name] + behind.get(name, ""), shown_map(name, svbrdf[name]))
             for name in CHANNELS[svbrdf.bsdf]]
    tiles += [] if guess is None else [("Guessed diffuse", shown_map("diffuse", guess))]
    large, small = square_side(len(tiles), LARGEST_MAP), square_side(shown, LARGEST_PHOTO)
    photo_top = HEADER_HEIGHT + LABEL_HEIGHT + large
    sheet = Canvas(photo_top + 3 * (LABEL_HEIGHT + small) + LABEL_HEIGHT + 20)

    sheet.text(SHEET_MARGIN, 52, title, 22, SHEET_TEXT, weight="bold")
    sheet.text(SHEET_WIDTH - SHEET_MARGIN, 52, f"{rmse:.4f}", 24, SHEET_ACCENT, weight="bold", ha="right")
    which = ("1 photo" if count == 1
             else f"{count} photos" + (f", {shown} of them shown" if shown < count else ""))
    sheet.text(SHEET_WIDTH - SHEET_MARGIN, 80, f"re-rendering RMSE, {which}", 11, SHEET_QUIET, ha="right")

    for i, (label, image) in enumerate(tiles):
        x = SHEET_MARGIN + i * (large + PICTURE_GAP)
        sheet.text(x, HEADER_HEIGHT + LABEL_HEIGHT - 9, label, 11, SHEET_TEXT)
        sheet.image(x, HEADER_HEIGHT + LABEL_HEIGHT, large, image)
    first, second = (images[:shown].detach().cpu().float() for images in (photos, rerendered))
    for row, (label, images) in enumerate((("Photos", first), ("Re-rendered", second),
                                           ("Difference × 4", 4 * (first - second).abs()))):
        y = photo_top + row * (LABEL_HEIGHT + small) + LABEL_HEIGHT
        sheet.text(SHEET_MARGIN, y - 9, label, 11, SHEET_TEXT)
        for i, image in enumerate(images):
            sheet.image(SHEET_MARGIN + i * (small + PICTURE_GAP), y, small, image)
    for i in range(shown):
        x, y = SHEET_MARGIN + i * (small + PICTURE_GAP), photo_top + 3 * (LABEL_HEIGHT + small) + 20
        sheet.text(x, y, names[i], 10, SHEET_QUIET)
        sheet.text(x + small, y, f"{per_photo[i]:.4f}", 10, SHEET_TEXT, ha="right")
    sheet.write(Path(path))
