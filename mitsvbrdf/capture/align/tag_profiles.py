"""Profiles across edges from black to white; and tags whose outer edges are not all there.

These are cut off by the rim of the photo, or by scissors. Edges between their black and white cells are
measured instead. Where most of those in the picture are as the code has them, the tag is there.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..lens import Array
from .features import mapped
from .sheet import CODES, TAG, tag_cells

# Of a tag: points of its edges in cells from its top left corner, in pixels, ways across; its corners.
Measured: TypeAlias = tuple[Array, Array, Array, Array]
PROFILE = 33  # samples across an edge
CONTRAST = 0.03  # linear, between white and black, below which nothing is measured
WIDTH = 4  # profiles along the edge of a cell, in its middle part
REACH = 0.45  # of a profile to both sides, in cells: the next edge may be a cell away
PASSES = 5
AGREE, LEAST_EDGES = 0.6, 16  # of the edges in the picture, that share and so many are as the code has them
OUTLIER = 4.0  # median deviations
CORNERS = np.array([[0, 0], [TAG, 0], [TAG, TAG], [0, TAG]], dtype=np.float64)


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


def _edges(number: int) -> tuple[Array, Array]:
    """Middles of all edges of black cells beside white ones (K x 2, in cells), and the ways to white."""
    cells = np.pad(tag_cells(number), 1, constant_values=True).astype(int)
    found = []
    for axis in (0, 1):
        step = np.diff(cells, axis=axis)
        row, column = np.nonzero(step)
        at = np.stack((column - 0.5, row - 0.5), axis=1)
        at[:, 1 - axis] += 0.5
        way = np.zeros_like(at)
        way[:, 1 - axis] = step[row, column]
        found.append((at, way))
    at, way = (np.concatenate(part) for part in zip(*found))
    return at, way


EDGES = [_edges(number) for number in range(len(CODES))]


def measured_inside(grey: NDArray, linear: NDArray[np.float32], number: int,
                    corners: Array) -> Measured | None:
    """Points of a tag's edges in cells from its top left corner, in pixels, the ways across; its corners.

    Args:
        corners: where they should be, within half a cell, 4 x 2 pixels.
    """
    import cv2

    middle, out = EDGES[number]
    along, steps = out[:, ::-1], np.linspace(-REACH, REACH, PROFILE)
    on = middle[:, None] + along[:, None] * 0.8 * ((np.arange(WIDTH) + 0.5) / WIDTH - 0.5)[:, None]
    for _ in range(PASSES):
        warp = cv2.getPerspectiveTransform(CORNERS.astype(np.float32),
                                           corners.astype(np.float32)).astype(np.float64)
        at = mapped(warp, on[:, :, None] + steps[:, None] * out[:, None, None])
        values = profile_values(grey, linear, corners, at).mean(axis=1, dtype=np.float64)
        offset = crossings(values, steps)
        shown, good = np.isfinite(values).all(axis=1).sum(), np.isfinite(offset)
        if good.sum() < max(LEAST_EDGES, AGREE * shown):
            return None
        moves, good = _moves(middle, out, offset, good)
        corners = mapped(warp, CORNERS + _basis(CORNERS) @ moves)
    edge = middle + np.nan_to_num(offset)[:, None] * out
    tangent = mapped(warp, edge + 0.1 * along) - mapped(warp, edge - 0.1 * along)
    normal = (np.stack((tangent[:, 1], -tangent[:, 0]), axis=-1)
              / np.linalg.norm(tangent, axis=-1, keepdims=True))
    return middle[good], mapped(warp, edge)[good], normal[good], corners


def _basis(points: Array) -> Array:
    """How points (K x 2) move in the eight ways of a small homography: K x 2 x 8."""
    x, y = (points / (TAG / 2) - 1).T
    one, none = np.ones_like(x), np.zeros_like(x)
    return np.stack((np.stack((one, x, y, none, none, none, x * x, x * y), axis=-1),
                     np.stack((none, none, none, one, x, y, x * y, y * y), axis=-1)), axis=1)


def _moves(at: Array, way: Array, offset: Array, good: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """The homography that moves points (K x 2) along their ways by these offsets, and which ones agree."""
    slopes = (_basis(at) * way[..., None]).sum(axis=1)
    for _ in range(3):
        moves = np.linalg.lstsq(slopes[good], offset[good], rcond=None)[0]
        off = np.abs(slopes @ moves - offset)
        good = off <= max(OUTLIER * float(np.median(off[good])), 0.02)  # a fiftieth of a cell is always well
    return moves, good
