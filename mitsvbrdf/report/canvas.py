"""Sheets of labelled pictures: one large dark PNG or JPEG, its texts and pictures placed in pixels.

The contact sheet of a capture and the overview of a fit are made with it.
"""

from __future__ import annotations

import io
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
from .colours import SHEET_BACK

# In pixels of the sheet. Between the margins 9, 5 and 4 squares with their gaps fit without a remainder.
SHEET_WIDTH, SHEET_MARGIN, PICTURE_GAP, LABEL_HEIGHT, HEADER_HEIGHT = 1680, 34, 8, 34, 92


def square_side(count: int, largest: int) -> int:
    """Side of each of ``count`` squares in one row."""
    return min((SHEET_WIDTH - 2 * SHEET_MARGIN - (count - 1) * PICTURE_GAP) // count, largest)


class Canvas:
    """A dark page addressed in pixels from its top left."""

    def __init__(self, height: int) -> None:
        self.height = height
        self.figure = Figure(figsize=(SHEET_WIDTH / 100, height / 100), dpi=100, facecolor=SHEET_BACK)

    def text(self, x: int, y: int, text: str, points: float, colour: str, **how: Any) -> None:
        """Write text whose baseline starts at (x, y) pixels; ``how`` goes to matplotlib's ``Figure.text``."""
        self.figure.text(x / SHEET_WIDTH, 1 - y / self.height, text, fontsize=points, color=colour,
                         parse_math=False, **how)

    def image(self, x: int, y: int, side: int, image: Tensor) -> None:
        """Place a picture, H x W x 3 or x 1 display values, into the square with top left corner (x, y)."""
        pixels = color.clip(image.detach().cpu().float()).numpy()
        # without axes, each of which takes 20 ms
        square = Bbox.from_bounds(x, self.height - y - side, side, side)
        shown = BboxImage(square, interpolation="antialiased",
                          data=np.broadcast_to(pixels, (*pixels.shape[:2], 3)))
        self.figure.add_artist(shown)

    def write(self, path: Path) -> None:
        """Write the page as a PNG, or as a JPEG of quality 88 where the name ends in ``.jpg``."""
        data, drawn = io.BytesIO(), FigureCanvasAgg(self.figure)
        if path.suffix == ".jpg":
            drawn.print_jpg(data, pil_kwargs={"quality": 88})
        else:
            drawn.print_png(data)
        files.write_bytes(path, data.getvalue())
