"""What a failed comparison leaves: a message with the numbers, and a page with pictures."""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..errors import BackendError, OutputError
from ..io import files
from ..measure.metrics import flip, relative_error
from ..report.page import write_page
from ..report.pictures import at_most, error_picture, magma, png_uri, shrunk
from .running import current

PICTURE_SIDE = 256  # pixels along a side of the pictures in a page
VIEWS_SHOWN = 3  # views shown, the worst first


@dataclass(frozen=True)
class Figure:
    """One measured number and the largest value that passes; NaN misses every limit."""

    name: str
    value: float
    limit: float

    @property
    def missed(self) -> bool:
        """Whether the comparison fails by this figure."""
        return not self.value <= self.limit


@dataclass(frozen=True)
class Row:
    """Pictures that belong together: (caption, ``data:`` URI) each."""

    title: str
    pictures: list[tuple[str, str]]


def failure(title: str, figures: Sequence[Figure], rows: Callable[[], list[Row]], notes: Sequence[str] = (),
            suffix: str = ".html") -> AssertionError:
    """The error to raise, naming figures beyond their limits, with the page of all figures written."""
    lines = [title, *(f"  {f.name}: {f.value:.3g}, limit {f.limit:.3g}" for f in figures if f.missed),
             *(f"  {note}" for note in notes)]
    page = left_behind(suffix, lambda path: write_page(
        path, "report/comparison.html", title=title, test=current().id, figures=figures, rows=rows(),
        notes=notes))
    return AssertionError("\n".join([*lines, f"  page: {page}"]))


def left_behind(suffix: str, write: Callable[[Path], None]) -> str:
    """Write a file of the running test, ``DIR/TEST-HASH.SUFFIX``; its path, or why there is none."""
    caller = current()
    name = re.sub(r"[^\w.]+", "-", caller.id)[-100:].strip("-.")
    folder = caller.run.report.resolve()
    path = folder / f"{name}-{hashlib.sha256(caller.id.encode()).hexdigest()[:8]}{suffix}"
    try:
        if not folder.exists():  # nothing in it is to be committed, as in .pytest_cache
            files.write_bytes(folder / ".gitignore", b"*\n")
        write(path)
    except OutputError as reason:  # a full disk must not hide what the test found
        return f"none ({reason})"
    return str(path)


def view_rows(new: Tensor, reference: Tensor, whose: str) -> list[Row]:
    """The views N x H x W x 3 (linear) that differ most, the worst first; ``whose`` is in the title."""
    error = relative_difference(new, reference).flatten(1).mean(1)
    worst = error.nan_to_num(nan=torch.inf).argsort(descending=True)[:VIEWS_SHOWN].tolist()
    return [row(f"{whose}, view {k}" if len(new) > 1 else whose, new[k], reference[k], color.to_display)
            for k in worst]


def row(title: str, new: Tensor, reference: Tensor | None, show: Callable[[Tensor], Tensor]) -> Row:
    """New and reference (H x W x C, linear; None: new alone), where they differ, and how that looks.

    ``show`` makes display values H x W x 3.
    """
    if reference is None:
        return Row(title, [("new", png_uri(at_most(_marked(show(new), new), PICTURE_SIDE)))])
    first, second = (_marked(show(x.float()), x) for x in (new, reference))
    pictures = [("new", png_uri(at_most(first, PICTURE_SIDE))),
                ("reference", png_uri(at_most(second, PICTURE_SIDE))),
                heat("relative difference", relative_difference(new[None], reference[None])[0])]
    with contextlib.suppress(BackendError):  # without the extra there are three pictures
        look = flip(first, second, "linear")
        told = f"FLIP: mean {float(look.mean()):.2g}, worst {float(look.max()):.2g}, bright 1"
        pictures.append((told, png_uri(magma(_peaks(look)))))
    return Row(title, pictures)


def gradient_row(title: str, new: Tensor, reference: Tensor) -> Row:
    """Lengths of the gradients of a map (H x W x C) over its channels, and of their difference."""
    return Row(title, [heat(name, gradient.double().norm(dim=-1)) for name, gradient in (
        ("new", new), ("reference", reference), ("difference", new.double() - reference))])


def heat(name: str, size: Tensor) -> tuple[str, str]:
    """Caption and picture of sizes H x W, log scale over four decades; not finite is brightest."""
    high = float(size[torch.isfinite(size)].max()) if torch.isfinite(size).any() else 1.0
    return f"{name}, bright {high:.2g}, black {high / 1e4:.1g}", png_uri(
        error_picture(_peaks(size), high or 1.0))


def relative_difference(new: Tensor, reference: Tensor) -> Tensor:
    """Size of the relative error of the worst channel, N x H x W."""
    return relative_error(new, reference).abs().amax(dim=-1)


def _marked(display: Tensor, linear: Tensor) -> Tensor:
    """Display values with magenta where the linear ones are not finite."""
    return torch.where(torch.isfinite(linear).all(dim=-1, keepdim=True), display,
                       torch.tensor([1.0, 0.0, 1.0]))


def _peaks(size: Tensor) -> Tensor:
    """Shrunk so that a single bad pixel stays visible."""
    if max(size.shape) <= PICTURE_SIDE:
        return size
    return F.adaptive_max_pool2d(size[None], shrunk(size, PICTURE_SIDE))[0]
