"""The sheet of tags that is laid on the material: its layout, its white areas, and a file to print.

Sixteen AprilTags of the family 36h11 (Olson 2011; Wang and Olson 2016), ids 0 to 15, on the border of a 5 x 5
grid with a pitch of two tags: the layout of svbrdf-diff-renderer, whose sheets and ours are interchangeable.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ...io import files
from ...kinds import kinds_checked

Paper = Literal["a4", "letter"]

# The middle 6 x 6 cells of ids 0 to 15 of AprilTag's tag36h11, 1 is white, row by row from the top left.
CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822, 0xF31DAB3AC, 0x056A5D085,
         0x10652E1D4, 0x22B1DFEAD, 0x265AD0472, 0x34FE91B86, 0x3FF962CD5, 0x43A25329A, 0x474B4385F,
         0x4E9D243E9, 0x5246149AE)
# Lengths in cells of a tag. A tag includes its black border.
TAG, PITCH, FRAME = 8, 16, 72
HOLE = 52  # side of the square to cut out: two cells from the tags, three from the patch
OUTER = 76  # side of the sheet: two white cells around the tags
PATCH = 0.64  # of the frame: what svbrdf-diff-renderer crops, 1024 of 1600 pixels
SMALLEST = 5.0  # cm: cells of 0.7 mm, still 3 pixels in a photo from half a metre away
SHEETS: dict[Paper, tuple[float, float]] = {"a4": (21.0, 29.7), "letter": (21.59, 27.94)}  # cm
PAPER_THICKNESS = 0.01  # cm, of 80 g/m^2
PRINTER_MARGIN = 0.5  # cm that many printers leave white
ABOVE = 2.0  # cm between the upper edge of the paper and the sheet


@dataclass(frozen=True)
class Sheet:
    """The layout of the sheet: x right, y up, origin in the middle, z = 0.

    Args:
        size: of the frame of tags, outer edge to outer edge, in cm. ConfigError unless finite and above 0.
    """

    size: float = 18.0

    def __post_init__(self) -> None:
        if not 0 < self.size < math.inf:
            raise ConfigError("the size of the sheet in cm", str(self.size),
                              "measure the frame of tags from edge to edge")

    @property
    def cell(self) -> float:
        """Side of a cell of the tags, cm."""
        return self.size / FRAME

    @property
    def patch(self) -> float:
        """Side of the square of material that is recovered, cm."""
        return self.size * PATCH

    @property
    def hole(self) -> float:
        """Side of the square to cut out, cm."""
        return self.cell * HOLE

    @property
    def outer(self) -> float:
        """Side of the sheet, cm."""
        return self.cell * OUTER

    @cached_property
    def corners(self) -> dict[int, NDArray[np.float64]]:
        """A dict: id of a tag to its corners (4 x 3, cm): top left, top right, bottom right, bottom left."""
        square = np.array([[0, 0], [TAG, 0], [TAG, TAG], [0, TAG]])
        at = {number: square + place - OUTER / 2 for number, place in enumerate(_PLACES)}
        return {number: np.column_stack((xy * (1, -1), np.zeros(4))) * self.cell for number, xy in at.items()}

    def white(self, points: NDArray) -> NDArray[np.bool_]:
        """Whether points of the sheet (K x 2, cm) are on white paper, a cell or more from anything else."""
        column, row = np.floor(np.asarray(points).T * ((1,), (-1,)) / self.cell + OUTER / 2).astype(int)
        inside = (column >= 0) & (column < OUTER) & (row >= 0) & (row < OUTER)
        return inside & _WHITE[np.clip(row, 0, OUTER - 1), np.clip(column, 0, OUTER - 1)]

    def picture(self, pixels_per_cm: float) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """The sheet, ``outer`` wide, from above, row 0 at the top; each pixel is the average of its area.

        N x N values, paper 255 and black 0; and an N x N mask of the pixels whose centre is in the hole.
        """
        count = max(1, round(self.outer * pixels_per_cm))
        edges = np.linspace(0, OUTER, count + 1)
        low, high = edges[:-1, None], edges[1:, None]
        share = np.clip(np.minimum(high, np.arange(1, OUTER + 1)) - np.maximum(low, np.arange(OUTER)), 0,
                        None)
        share /= share.sum(axis=1, keepdims=True)
        middle = np.abs((edges[:-1] + edges[1:]) / 2 - OUTER / 2) < HOLE / 2
        return np.rint(share @ (255.0 * _CELLS) @ share.T).astype(np.uint8), middle[:, None] & middle


def tag_cells(number: int) -> NDArray[np.bool_]:
    """The 8 x 8 cells of a tag, True is white, row 0 at the top."""
    bits = [CODES[number] >> i & 1 for i in reversed(range(36))]
    return np.pad(np.array(bits, dtype=bool).reshape(6, 6), 1)


def _grids() -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """White cells of the sheet (hole included); cells of white paper with neighbours of white paper only."""
    cells, paper = np.ones((2, OUTER, OUTER), dtype=bool)
    for number, (column, row) in enumerate(_PLACES):
        tag = slice(row, row + TAG), slice(column, column + TAG)
        cells[tag], paper[tag] = tag_cells(number), False
    edge = (OUTER - HOLE) // 2
    paper[edge:-edge, edge:-edge] = False
    around = np.lib.stride_tricks.sliding_window_view(np.pad(paper, 1), (3, 3))
    return cells, np.all(around, axis=(2, 3))


# column and row of the top left cell of each tag: clockwise from the top left corner
_PLACES = [((OUTER - FRAME) // 2 + PITCH * column, (OUTER - FRAME) // 2 + PITCH * row) for column, row in (
    *((i, 0) for i in range(4)), *((4, i) for i in range(4)), *((4 - i, 4) for i in range(4)),
    *((0, 4 - i) for i in range(4)))]
_CELLS, _WHITE = _grids()


@kinds_checked
def write_sheet(path: str | Path, size_cm: float = 18.0, paper: Paper = "a4") -> None:
    """Write the sheet at its true size on a page of A4 or Letter, with instructions in small print.

    Args:
        path: .pdf or .svg (vector graphics), or .png (600 dots an inch).
        size_cm: size of the frame of tags, outer edge to outer edge.

    Raises:
        ConfigError: the size does not fit on the paper, or is too small to be seen; another kind of file.
    """
    if paper not in SHEETS:
        raise ConfigError(f"paper of {tuple(SHEETS)}", repr(paper), "choose one of these")
    path, (width, height) = Path(path), SHEETS[paper]
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("pdf", "svg", "png"):
        raise ConfigError("a file .pdf, .svg or .png", str(path), "end its name like that")
    largest = np.floor((width - 2 * PRINTER_MARGIN) * FRAME / OUTER * 10) / 10
    if not SMALLEST <= size_cm <= largest:
        raise ConfigError(f"a size of {SMALLEST:g} to {largest:g} cm on "
                          f"{paper.upper() if paper == 'a4' else 'Letter'}",
                          f"{size_cm:g} cm", "give another size, or print a larger one elsewhere")
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({"pdf.compression": 0, "svg.hashsalt": "sheet"}), files.atomic_write(path) as temporary:
        figure = Figure(figsize=(width / 2.54, height / 2.54))
        _draw(figure.add_axes((0, 0, 1, 1)), Sheet(size_cm), width, height)
        date = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}[kind]
        figure.savefig(temporary, format=kind, dpi=600, metadata={"Title": "Tags around a material"} | date)


def _draw(axes: Any, sheet: Sheet, width: float, height: float) -> None:
    """Draw the page; coordinates are cm from its lower left corner."""
    from matplotlib.patches import PathPatch, Rectangle
    from matplotlib.path import Path as Outline

    axes.set(xlim=(0, width), ylim=(0, height))
    axes.set_axis_off()
    left, top = (width - sheet.outer) / 2, height - ABOVE
    middle, bottom = width / 2, top - sheet.outer
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
    runs = []
    for row, line in enumerate(_CELLS):
        steps = np.flatnonzero(np.diff(np.concatenate(([True], line, [True]))))
        runs += [((left, top) + ((first, -row - 1) + square * (last - first, 1)) * sheet.cell)
                 for first, last in zip(steps[::2], steps[1::2])]
    codes = [Outline.MOVETO, *[Outline.LINETO] * 3, Outline.CLOSEPOLY] * len(runs)
    # all cells as one path: no seams
    axes.add_patch(PathPatch(Outline(np.concatenate(runs), codes), facecolor="black", linewidth=0))
    for side, dashes in ((sheet.outer, "-"), (sheet.hole, (0, (6, 4)))):
        corner = middle - side / 2, top - (sheet.outer + side) / 2
        axes.add_patch(Rectangle(corner, side, side, fill=False, edgecolor="0.6", linewidth=0.5,
                                 linestyle=dashes))

    def text(x: float, y: float, words: str, size: float = 8, **options: Any) -> None:
        axes.text(x, y, words, fontsize=size,
                  **{"ha": "center", "va": "center", "linespacing": 1.5} | options)

    def arrow(start: tuple[float, float], end: tuple[float, float], style: str) -> None:
        line = {"arrowstyle": style, "linewidth": 1, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
        axes.annotate("", end, start, arrowprops=line)

    arrow((middle - 0.6, top + 0.3), (middle - 0.6, top + 1.1), "-|>")
    text(middle - 0.3, top + 0.65, "this side up", 12, ha="left")
    text(middle, top - sheet.outer / 2 + 0.2, "cut out along the dashes", 6, color="0.5")
    arrow((middle - sheet.size / 2, bottom - 0.45), (middle + sheet.size / 2, bottom - 0.45), "<|-|>")
    for x in (middle - sheet.size / 2, middle + sheet.size / 2):
        axes.plot([x, x], [bottom - 0.6, bottom - 0.3], color="black", linewidth=0.5, solid_capstyle="butt")
    text(middle, bottom - 0.8, f"measure this arrow: {sheet.size:g} cm, outer edge to outer edge of the tags")
    ruler = bottom - 2.0
    axes.plot([middle - 5, middle + 5], [ruler, ruler], color="black", linewidth=0.5, solid_capstyle="butt")
    for i in range(101):
        x, tall = middle - 5 + i / 10, 0.4 if i % 10 == 0 else 0.3 if i % 5 == 0 else 0.2
        axes.plot([x, x], [ruler, ruler + tall], color="black", linewidth=0.5, solid_capstyle="butt")
        if i % 10 == 0:
            text(x, ruler + 0.55, f"{i // 10}", 6)
    text(middle, ruler - 0.25, "10 cm")
    text(middle, ruler - 0.6,
         "Print at 100 % (\"actual size\"), on matt paper, and hold a ruler to the scale above.\n"
         "Cut out the dashed square, keep the white rim around the tags, and lay the sheet flat on the "
         "material.\n"
         "Photograph with the flash, all tags in view:  mitsvbrdf capture PHOTOS -o CAPTURE --sheet "
         f"{sheet.size:g}\nWhere the arrow is longer or shorter on paper, give its length instead. "
         "A sheet that lies higher than the material: --depth CM.", va="top")
