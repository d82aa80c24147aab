"""The overview of a fit: one picture of its maps, photos and re-renderings."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import BboxImage
from matplotlib.transforms import Bbox
from torch import Tensor

from .. import color
from ..io import files
from ..material.maps import CHANNELS, SVBRDF, TITLES, shown_map

# In pixels of the sheet. Between the margins, 9, 5 or 4 squares with their gaps fit exactly.
WIDTH, MARGIN, GAP, LABEL, HEADER = 1680, 34, 8, 34, 92
LARGEST_MAP, LARGEST_PHOTO = 397, 264
SHOWN = 9  # photos
# The sheet is dark, so that the pictures are the brightest on it.
BACK, TEXT, QUIET, ACCENT = "#131519", "#eceef1", "#9198a3", "#f2b84b"


class Canvas:
    """A dark page addressed in pixels from its top left."""

    def __init__(self, height: int) -> None:
        self.height = height
        self.figure = Figure(figsize=(WIDTH / 100, height / 100), dpi=100, facecolor=BACK)

    def text(self, x: int, y: int, text: str, points: float, colour: str, **how: Any) -> None:
        """Write text whose baseline starts at (x, y) pixels; ``how`` goes to matplotlib's ``Figure.text``."""
        self.figure.text(x / WIDTH, 1 - y / self.height, text, fontsize=points, color=colour,
                         parse_math=False, **how)

    def image(self, x: int, y: int, side: int, image: Tensor) -> None:
        """Place a picture, H x W x 3 or x 1 display values, into the square with top left corner (x, y)."""
        pixels = color.clip(image.detach().cpu().float()).numpy()
        # without axes, each of which takes 20 ms
        square = Bbox.from_bounds(x, self.height - y - side, side, side)
        self.figure.add_artist(BboxImage(square, interpolation="antialiased",
                                         data=np.broadcast_to(pixels, (*pixels.shape[:2], 3))))

    def png(self) -> bytes:
        """The page as a PNG file."""
        data = io.BytesIO()
        FigureCanvasAgg(self.figure).print_png(data)
        return data.getvalue()


def write_sheet(path: str | Path, svbrdf: SVBRDF, photos: Tensor, rerendered: Tensor, *, rmse: float,
                per_photo: Sequence[float], names: Sequence[str], title: str, guess: Tensor | None = None,
                remarks: Mapping[str, str] | None = None) -> None:
    """Write one PNG, 1680 pixels wide: the maps, and below them photos, re-renderings and differences.

    Colour maps are shown in sRGB, roughness and metallic as they are, normals as (n + 1) / 2. At most nine
    photos are shown. Photos and re-renderings are display values N x R x R x 3 in [0, 1]. ``rmse`` and
    ``per_photo`` are in display values too. ``guess`` is linear. ``remarks``: map name to words beside it.
    """
    count = len(photos)
    shown = min(count, SHOWN)
    behind = {name: f"  ·  {remark}" for name, remark in (remarks or {}).items()}
    tiles = [(TITLES[name] + behind.get(name, ""), shown_map(name, svbrdf[name]))
             for name in CHANNELS[svbrdf.bsdf]]
    tiles += [] if guess is None else [("Guessed diffuse", shown_map("diffuse", guess))]
    large, small = _side(len(tiles), LARGEST_MAP), _side(shown, LARGEST_PHOTO)
    photo_top = HEADER + LABEL + large
    sheet = Canvas(photo_top + 3 * (LABEL + small) + LABEL + 20)

    sheet.text(MARGIN, 52, title, 22, TEXT, weight="bold")
    sheet.text(WIDTH - MARGIN, 52, f"{rmse:.4f}", 24, ACCENT, weight="bold", ha="right")
    which = ("1 photo" if count == 1
             else f"{count} photos" + (f", {shown} of them shown" if shown < count else ""))
    sheet.text(WIDTH - MARGIN, 80, f"re-rendering RMSE, {which}", 11, QUIET, ha="right")

    for i, (label, image) in enumerate(tiles):
        x = MARGIN + i * (large + GAP)
        sheet.text(x, HEADER + LABEL - 9, label, 11, TEXT)
        sheet.image(x, HEADER + LABEL, large, image)
    first, second = (images[:shown].detach().cpu().float() for images in (photos, rerendered))
    for row, (label, images) in enumerate((("Photos", first), ("Re-rendered", second),
                                           ("Difference × 4", 4 * (first - second).abs()))):
        y = photo_top + row * (LABEL + small) + LABEL
        sheet.text(MARGIN, y - 9, label, 11, TEXT)
        for i, image in enumerate(images):
            sheet.image(MARGIN + i * (small + GAP), y, small, image)
    for i in range(shown):
        x, y = MARGIN + i * (small + GAP), photo_top + 3 * (LABEL + small) + 20
        sheet.text(x, y, names[i], 10, QUIET)
        sheet.text(x + small, y, f"{per_photo[i]:.4f}", 10, TEXT, ha="right")
    files.write_bytes(Path(path), sheet.png())


def _side(count: int, largest: int) -> int:
    return min((WIDTH - 2 * MARGIN - (count - 1) * GAP) // count, largest)
