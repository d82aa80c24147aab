"""How materials, captures and results show themselves in a notebook: small pictures, at most 14 of 128 px,
below 1 MB.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from .page import page_text
from .pictures import at_most, png_uri

SHOWN = 9  # photos of a capture
PICTURE_SIDE = 128  # pixels along a side of a picture
NOTES_SHOWN = 10  # notes and warnings

Picture = tuple[str, str]  # caption and address


def html_of(title: str, groups: Sequence[tuple[str, list[Picture]]], facts: Sequence[str] = (),
            notes: Sequence[str] = ()) -> str:
    """The HTML of a value in a notebook.

    Args:
        title: the heading.
        groups: rows of pictures, each a heading and its pictures.
        facts: one line each, below the heading.
        notes: notes and warnings; the first :data:`NOTES_SHOWN` are shown.
    """
    return page_text("pages/notebook.html", title=title, groups=groups, facts=facts,
                     notes=notes[:NOTES_SHOWN], side=PICTURE_SIDE)


def uri_of(display: Tensor) -> str:
    """A picture for ``<img src>``; magenta where it is not a number."""
    small = at_most(display.detach().cpu().float(), PICTURE_SIDE)
    return png_uri(torch.where(small.isnan().any(dim=-1, keepdim=True), torch.tensor([1.0, 0.0, 1.0]), small))


def point_words(position: tuple[float, float, float]) -> str:
    """A place as text, patch sides to two digits."""
    return "(" + ", ".join(f"{x:.2f}" for x in position) + ")"


def count_words(photos: int) -> str:
    """How many photos there are, and how many of them are shown."""
    return "1 photo" if photos == 1 else f"{photos} photos" + (f", {SHOWN} shown" if photos > SHOWN else "")
