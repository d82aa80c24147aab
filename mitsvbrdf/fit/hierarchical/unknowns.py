"""The unknowns of a texel, grouped by map, and the derivatives that a solver computes."""

from typing import NamedTuple

import torch
from torch import Tensor

from ...io.layout import Layout


class Unknowns(Layout):
    """The maps that a texel's U numbers belong to; values of all texels are tensors U x R x R."""

    @property
    def names(self) -> list[str]:
        """The map of each of the U numbers."""
        return [name for name, (count,) in self.shapes.items() for _ in range(count)]

    def of(self, *maps: str) -> Tensor:
        """Positions of the numbers of these maps; of maps that are no unknowns, none."""
        return torch.tensor([i for i, name in enumerate(self.names) if name in maps], dtype=torch.long)


class Column(NamedTuple):
    """A derivative by a map (normal: by one of its slopes); ``places``: its unknown for each colour channel.

    Radiance in a channel depends only on the same channel of a colour: one forward pass serves all three.
    """

    name: str
    axis: int
    places: tuple[int, ...]


def columns_of(unknowns: Unknowns) -> list[Column]:
    """The derivatives that are computed."""
    columns = []
    for name, of in unknowns.slices.items():
        places = tuple(range(of.start, of.stop))
        if name == "normal":
            columns += [Column(name, axis, (at,) * 3) for axis, at in enumerate(places)]
        else:
            columns.append(Column(name, 0, places if len(places) == 3 else places * 3))
    return columns


def pair_of(i: int, j: int) -> tuple[int, int]:
    """The place of an entry in the lower triangle of a symmetric matrix."""
    return max(i, j), min(i, j)


def pairs_of(columns: list[Column]) -> list[tuple[int, int]]:
    """The places in the lower triangle of J^T J that are not always 0."""
    return sorted({pair_of(first.places[c], second.places[c]) for first in columns for second in columns
                   for c in range(3)})
