"""The output of a failed comparison: a message with the numbers, and a page with pictures."""

import hashlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..errors import OutputError
from ..io import files
from ..measure.metrics import relative_error
from ..report.page import write_page
from ..report.pictures import at_most, error_picture, png_uri, shrunk
from . import running

PICTURE_SIDE = 256  # pixels along a side of the pictures in a page
VIEWS_SHOWN = 3  # views shown, the worst first


class Figure(NamedTuple):
    """One measured number and the largest value that passes; NaN misses every limit."""

    name: str
    value: float
    limit: float

    @property
    def missed(self) -> bool:
        """Whether the value is beyond its limit."""
        return not self.value <= self.limit


class Row(NamedTuple):
    """A row of pictures on the page, each a pair of caption and ``data:`` URI."""

    title: str
    pictures: list[tuple[str, str]]


def failure(title: str, figures: Sequence[Figure], rows: Sequence[Row], notes: Sequence[str] = (),
            suffix: str = ".html") -> AssertionError:
    """Write the page of all figures. Return the error to raise: it names the figures beyond their limits."""
    lines = [title, *(f"  {f.name}: {f.value:.3g}, limit {f.limit:.3g}" for f in figures if f.missed),
             *(f"  {note}" for note in notes)]
    page = left_behind(suffix, lambda path: write_page(
        path, "report/comparison.html", title=title, test=running.now.test, figures=figures, rows=rows,
        notes=notes))
    return AssertionError("\n".join([*lines, f"  page: {page}"]))


def left_behind(suffix: str, write: Callable[[Path], None]) -> str:
    """Write ``DIR/TEST-HASH`` + ``suffix`` for the running test. Return its path, or why it is missing."""
    test, folder = running.now.test, running.now.report.resolve()
    name = re.sub(r"[^\w.]+", "-", test)[-100:].strip("-.")
    path = folder / f"{name}-{hashlib.sha256(test.encode()).hexdigest()[:8]}{suffix}"
    try:
        if not folder.exists():  # nothing in it is to be committed, as in .pytest_cache
            files.write_bytes(folder / ".gitignore", b"*\n")
        write(path)
    except OutputError as reason:  # a full disk must not hide what the test found
        return f"none ({reason})"
    return str(path)


def view_rows(new: Tensor, reference: Tensor, whose: str) -> list[Row]:
    """Rows of the views (N x H x W x 3, linear) that differ most, the worst first; ``whose``: their title."""
    error = relative_error(new, reference).abs().amax(dim=-1).flatten(1).mean(1)
    worst = error.nan_to_num(nan=torch.inf).argsort(descending=True)[:VIEWS_SHOWN].tolist()
    return [row(f"{whose}, view {k}" if len(new) > 1 else whose, new[k], reference[k], color.to_display)
            for k in worst]


def row(title: str, new: Tensor, reference: Tensor | None, show: Callable[[Tensor], Tensor]) -> Row:
    """A row: new, reference (H x W x C, linear; None: only new), and difference. ``show`` displays them."""
    given = {"new": new} if reference is None else {"new": new, "reference": reference}
    pictures = [(name, png_uri(at_most(_marked(show(x.float()), x), PICTURE_SIDE)))
                for name, x in given.items()]
    if reference is not None:
        pictures.append(heat("relative difference", relative_error(new, reference).abs().amax(dim=-1)))
    return Row(title, pictures)


def gradient_row(title: str, new: Tensor, reference: Tensor) -> Row:
    """A row: both gradients of a map (H x W x C) and their difference, as norms over the channels."""
    return Row(title, [heat(name, gradient.double().norm(dim=-1)) for name, gradient in (
        ("new", new), ("reference", reference), ("difference", new.double() - reference))])


def heat(name: str, size: Tensor) -> tuple[str, str]:
    """Caption and picture of sizes H x W, log scale of four decades; non-finite values are brightest."""
    high = float(size[torch.isfinite(size)].max()) if torch.isfinite(size).any() else 1.0
    if max(size.shape) > PICTURE_SIDE:  # shrunk so that a single bad pixel stays visible
        size = F.adaptive_max_pool2d(size[None], shrunk(size, PICTURE_SIDE))[0]
    return f"{name}, bright {high:.2g}, black {high / 1e4:.1g}", png_uri(error_picture(size, high or 1.0))


def _marked(display: Tensor, linear: Tensor) -> Tensor:
    """Display values with magenta where the linear ones are not finite."""
    finite = torch.isfinite(linear).all(dim=-1, keepdim=True)
    return torch.where(finite, display, torch.tensor([1.0, 0.0, 1.0]))
