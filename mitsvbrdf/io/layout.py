"""Named parts of a vector: a least-squares solver takes one vector, code is clearer with names."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Layout:
    """The layout of a vector that consists of named arrays, one after the other.

        lens = Layout(log_focal=(), centre=(2,), distortion=(2,))
        lens.size                    # 5
        lens["centre"]               # slice(1, 3)
        lens.unpack(x).distortion    # the last two numbers of x
        lens.pack(centre=0.5)        # (0, 0.5, 0.5, 0, 0)

    Args:
        shapes: name and shape of each part, in the order of the vector; () is one number.
    """

    def __init__(self, **shapes: tuple[int, ...]) -> None:
        self.shapes, self.size = shapes, 0
        self.slices: dict[str, slice] = {}  # of each part in the vector
        for name, shape in shapes.items():
            self.slices[name] = slice(self.size, self.size + math.prod(shape))
            self.size += math.prod(shape)

    def __getitem__(self, name: str) -> slice:
        return self.slices[name]

    def unpack(self, vector: Any) -> SimpleNamespace:
        """Split an array or tensor (... x size) into attributes, one per part: ... x shape of the part."""
        return SimpleNamespace(**{name: vector[..., self[name]].reshape((*vector.shape[:-1], *shape))
                                  for name, shape in self.shapes.items()})

    def pack(self, **parts: ArrayLike) -> NDArray[np.float64]:
        """The float64 vector of these parts. Smaller arrays are broadcast, missing parts are 0."""
        each = ((np.asarray(parts.get(name, 0.0), np.float64), shape) for name, shape in self.shapes.items())
        return np.concatenate([np.broadcast_to(part, shape).ravel() for part, shape in each])

    @property
    def numbers(self) -> SimpleNamespace:
        """The indices of each part in the vector. Each attribute has the name and the shape of a part."""
        return self.unpack(np.arange(self.size))
