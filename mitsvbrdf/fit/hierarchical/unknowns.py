"""The unknowns of a texel, by the map that they belong to."""

from __future__ import annotations

import torch
from torch import Tensor

from ...io.layout import Layout


class Unknowns(Layout):
    """Which of a texel's U numbers belong to which map; values of all texels are tensors U x R x R."""

    @property
    def names(self) -> list[str]:
        """The map of each of the U numbers."""
        return [name for name, (count,) in self.shapes.items() for _ in range(count)]

    def of(self, *maps: str) -> Tensor:
        """Positions of the numbers of these maps; of maps that are no unknowns, none."""
        return torch.tensor([i for i, name in enumerate(self.names) if name in maps], dtype=torch.long)
