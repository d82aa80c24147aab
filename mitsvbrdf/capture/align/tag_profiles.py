"""Profiles across edges from black to white, and where each crosses the middle between the two."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..lens import Array

# Of a tag: points of its edges in cells from its top left corner, in pixels, ways across; its corners.
Measured: TypeAlias = tuple[Array, Array, Array, Array]
PROFILE = 33  # samples across an edge
CONTRAST = 0.03  # linear, between white and black, below which nothing is measured


def profile_values(grey: NDArray, linear: NDArray[np.float32], corners: Array, at: Array) -> Array:
    """Radiance at pixels ``at`` (... x 2) around a tag with these corners (4 x 2); NaN beyond the photo.

    Args:
        grey: H x W, 8 or 16 bits.
        linear: radiance by value of ``grey``.
    """
    import cv2

    low = np.maximum(np.floor(corners.min(axis=0) - np.ptp(corners, axis=0) / 4).astype(int), 0)
    high = np.maximum(np.ceil(corners.max(axis=0) + np.ptp(corners, axis=0) / 4).astype(int) + 1, low + 1)
    window = linear[grey[low[1] : high[1], low[0] : high[0]]]
    if not window.size:
        return np.full(at.shape[:-1], np.nan)
    where = (at - low).astype(np.float32)
    values = cv2.remap(window, where.reshape(-1, at.shape[-2], 2), None, cv2.INTER_CUBIC,
                       borderMode=cv2.BORDER_CONSTANT, borderValue=(np.nan,))
    return values.reshape(at.shape[:-1])


def crossings(values: Array, steps: Array) -> Array:
    """Where profiles (... x PROFILE, black to white) cross the middle between their ends once, else NaN."""
    quarter = PROFILE // 4
    black, white = np.median(values[..., :quarter], axis=-1), np.median(values[..., -quarter:], axis=-1)
    above = values > ((black + white) / 2)[..., None]
    once = np.diff(above, axis=-1).sum(axis=-1) == 1
    with np.errstate(invalid="ignore"):
        clear = (white - black > CONTRAST) & once & np.isfinite(values).all(axis=-1)
    first = np.argmax(above, axis=-1)
    before = np.maximum(first - 1, 0)
    a, b = (np.take_along_axis(values, i[..., None], axis=-1)[..., 0] for i in (before, first))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = ((black + white) / 2 - a) / (b - a)
    return np.where(clear, steps[before] + share * (steps[1] - steps[0]), np.nan)
