"""The unknowns of a texel, by the map that they belong to."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor


class Unknowns(dict[str, int]):
    """How many numbers a texel has of each map that is to be found, in the order in which they lie.

    U is their sum; values of all texels are tensors U x R x R, of which ``values[unknowns.of("normal")]`` belong to a map.
    """

    @property
    def names(self) -> list[str]:
        """The map of each of the U numbers."""
        return [name for name, count in self.items() for _ in range(count)]

    @property
    def slices(self) -> dict[str, slice]:
        """Where the numbers of each map lie."""
        ends = torch.tensor(list(self.values())).cumsum(0).tolist()
        return {name: slice(end - count, end) for (name, count), end in zip(self.items(), ends, strict=True)}

    def of(self, *maps: str) -> Tensor:
        """Positions of the numbers of these maps; of maps that are no unknowns, none."""
        return torch.tensor([i for i, name in enumerate(self.names) if name in maps], dtype=torch.long)

    def each(self, by_map: Mapping[str, float]) -> list[float]:
        """A number for each of the U unknowns, from one for each map."""
        return [by_map[name] for name in self.names]
