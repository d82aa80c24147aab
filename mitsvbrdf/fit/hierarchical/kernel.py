"""What the texel solver traces: derivatives, colour transfer and the places of the normal equations."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from ... import color

EASED, STIFFENED = 0.3, 4.0  # what an accepted and a refused step make of the damping
DAMPING = 1e-6, 1e6  # its range
ROUNDING = 1e-5  # a cost that grows by less than this share has not grown: errors are differences of float32
STILL = 1e-4  # a refused step no longer than this is one of a texel that has arrived: it leaves the damping alone


class Functions(NamedTuple):
    """What stands behind three methods of :class:`TexelSolver`, on Dr.Jit arrays."""

    steps: Callable
    posterior: Callable
    equations: Callable


def pair_of(i: int, j: int) -> tuple[int, int]:
    return max(i, j), min(i, j)


def pairs_of(columns: list) -> list[tuple[int, int]]:
    """The places in the lower triangle of J^T J that are not always 0."""
    return sorted({pair_of(first[2][c], second[2][c]) for first in columns for second in columns for c in range(3)})


def opaque(mi, value):
    """A number that may change without a new kernel."""
    import drjit as dr

    return dr.opaque(mi.UInt32 if isinstance(value, int) else mi.Float, value if isinstance(value, int) else float(value))


def turned(direction, towards_s, towards_t):
    """The slope of a direction in a shading frame whose normal turns towards its tangents.

    The frame's turn about the normal itself is left out: no lobe sees it.
    """
    return type(direction)(-towards_s * direction.z, -towards_t * direction.z,
                           towards_s * direction.x + towards_t * direction.y)


def traced_decode(value):
    """:func:`mitsvbrdf.color.decode` of gamma 2.2, and its slope."""
    import drjit as dr

    toe = color.TOE ** (1 / 2.2)
    power = dr.maximum(value, toe) ** 1.2
    return (dr.select(value <= toe, value * (color.TOE / toe), value * power),
            dr.select(value <= toe, color.TOE / toe, 2.2 * power))


def traced_encode(linear, transfer: str):
    """:func:`mitsvbrdf.color.encode`."""
    import drjit as dr

    if transfer == "linear":
        return linear
    if transfer == "srgb":
        return dr.select(linear <= 0.0031308, 12.92 * linear, 1.055 * dr.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)
    toe = color.TOE ** (1 / 2.2)
    return dr.select(linear <= color.TOE, linear * (toe / color.TOE), dr.maximum(linear, color.TOE) ** (1 / 2.2))
