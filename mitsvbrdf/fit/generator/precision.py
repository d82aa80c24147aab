"""Whether networks are faster in bfloat16 here."""

from __future__ import annotations

import functools

import torch
from torch import nn

from ...io.timing import side_by_side
from .networks import seeded

WORTH = 1.2  # times as fast, at least, for what the numbers lose


@functools.cache
def is_faster_in_bfloat16() -> bool:
    """Whether a convolution like the generator's is faster in bfloat16, measured once, in about a second.

    The instruction set does not tell: with AMX bfloat16 takes half the time, and one processor that
    multiplies in it without AMX took 1.4 to 1.6 times as long as in float32.
    """
    with seeded(0):
        layer, features = nn.Conv2d(64, 128, 4, stride=2, padding=1), torch.randn(1, 64, 64, 64)

    def pass_through(bfloat16: bool) -> None:
        with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
            torch.autograd.grad(layer(features).float().sum(), layer.weight)

    seconds = side_by_side({"float32": lambda: pass_through(False), "bfloat16": lambda: pass_through(True)})
    return seconds["float32"]["median"] > WORTH * seconds["bfloat16"]["median"]
