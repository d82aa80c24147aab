"""Tags of the sheet in one photo: found by OpenCV's detector, then measured where black turns into white.

The detector's corners are off by half a pixel, and a lens bends the edges between them. So points along the
outer edges of the tags are measured, each only in the direction across its edge: where linear light crosses
the middle between black and white.

If the rim of the photo or scissors cut off outer edges of a tag, its cell edges, between black and white
cells, are measured instead. The tag counts as found if most of its cell edges in the picture agree with its
code.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from ...color import decode
from ..lens import Array
from ..photo import Photo
from .features import mapped
from .sheet import CODES, TAG, Sheet, tag_cells
from .tag_search import LEAST_TAGS, at_rim, detected, expected, fault_of, sought, sought_by_features

# A measured tag: edge points in cells from its top left corner; in pixels; directions across; corners.
Measured: TypeAlias = tuple[Array, Array, Array, Array]
PROFILE = 33  # samples across an edge
CONTRAST = 0.03  # least difference of white and black, linear, to measure an edge
WIDTH = 4  # number of profiles that are averaged, in the middle part of a cell's edge
REACH_INSIDE = 0.45  # reach of a profile to each side, in cells: the next edge may be a cell away
PASSES = 5
AGREE, LEAST_EDGES = 0.6, 16  # least share and number of visible cell edges that must agree with the code
OUTLIER = 4.0  # edges with an error of more than this many medians are ignored
CORNERS = np.array([[0, 0], [TAG, 0], [TAG, TAG], [0, TAG]], dtype=np.float64)


def profile_values(grey: NDArray, linear: NDArray[np.float32], corners: Array, at: Array) -> Array:
    """Radiance at pixels ``at`` (... x 2) around a tag with these corners (4 x 2); NaN beyond the photo.
    ``linear`` has the radiance for each value of ``grey``, which is H x W of 8 or 16 bits.
    """
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
    """Where profiles (... x PROFILE, black to white) cross the mean of their ends; NaN unless just once."""
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
    """Middles of all edges between black and white cells (K x 2, in cells), and the directions to white."""
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
    """Measure a tag at its cell edges (:data:`Measured`); None: too few agree with its code. The given
    ``corners`` (4 x 2 pixels) must be right to half a cell.
    """
    middle, out = EDGES[number]
    along, steps = out[:, ::-1], np.linspace(-REACH_INSIDE, REACH_INSIDE, PROFILE)
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
    return middle[good], mapped(warp, edge)[good], _across(warp, edge, along)[good], corners


def _across(warp: Array, edge: Array, along: Array) -> Array:
    """Unit vectors (... x 2, pixels) across edges. ``warp`` maps ``edge`` and ``along`` from cells."""
    tangent = mapped(warp, edge + 0.1 * along) - mapped(warp, edge - 0.1 * along)
    return (np.stack((tangent[..., 1], -tangent[..., 0]), axis=-1)
            / np.linalg.norm(tangent, axis=-1, keepdims=True))


def _basis(points: Array) -> Array:
    """K x 2 x 8: derivatives of points (K x 2) by the eight parameters of a small homography."""
    x, y = (points / (TAG / 2) - 1).T
    one, none = np.ones_like(x), np.zeros_like(x)
    return np.stack((np.stack((one, x, y, none, none, none, x * x, x * y), axis=-1),
                     np.stack((none, none, none, one, x, y, x * y, y * y), axis=-1)), axis=1)


def _moves(at: Array, way: Array, offset: Array, good: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Parameters (:func:`_basis`) that move points (K x 2) by ``offset`` along ``way``; points that agree."""
    slopes = (_basis(at) * way[..., None]).sum(axis=1)
    for _ in range(3):
        moves = np.linalg.lstsq(slopes[good], offset[good], rcond=None)[0]
        off = np.abs(slopes @ moves - offset)
        good = off <= max(OUTLIER * float(np.median(off[good])), 0.02)  # a fiftieth of a cell always agrees
    return moves, good


MOST_PIXELS = 4100  # of the long side; larger photos are reduced to measure tags. 12 megapixels have 4032
POINTS = 8  # measured along each edge, from WIDTH profiles each
# reach of a profile to each side: in cells, and in the last pass at most this many pixels
REACH, REACH_PIXELS = 0.75, 8.0
# least points of each edge, or the tag does not count; glare, a finger or the rim may hide the others
LEAST_POINTS = 3


@dataclass(frozen=True)
class Edges:
    """Measured points of the outer edges of tags."""

    plane: Array  # on the sheet, K x 2 in cm
    pixels: Array  # in the stored photo, K x 2
    across: Array  # unit vectors across the edges in the photo, K x 2; points are exact only along these
    corners: dict[int, Array]  # id to corners in the photo (4 x 2), in the order of Sheet.corners
    trimmed: bool = False  # whether features found the tags, as they have no white around them
    fault: str | None = None  # why too few tags were found, if known


def find_edges(photo: Photo, sheet: Sheet, patient: bool = True) -> Edges:
    """Measure the tags of a photo in at most 4100 pixels a side. With ``patient``, if too few are found,
    search again with wider thresholds and by features; if there are still too few, find the reason.
    """
    times = -(-max(photo.size) // MOST_PIXELS)
    image = photo.pixels(MOST_PIXELS)
    levels = np.arange(np.iinfo(image.dtype).max + 1) / np.iinfo(image.dtype).max
    linear = decode(torch.from_numpy(levels), "linear" if photo.linear else "srgb").numpy().astype(np.float32)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    del image
    shown = (np.sqrt(levels) if photo.linear else levels) * 255
    eight = grey if levels.size == 256 else shown.astype(np.uint8)[grey]
    measured = _tags(sheet, grey, eight, linear, patient)
    if trimmed := patient and len(measured) < LEAST_TAGS:
        whole = sought_by_features(photo, sheet)
        measured |= _inside(grey, linear, {number: (at + 0.5) / times - 0.5 for number, at in whole.items()})
    none = patient and len(measured) < LEAST_TAGS
    plane, pixels, across, corners = [], [], [], {}
    for number, (cells, at, normals, found) in sorted(measured.items()):
        top_left, top_right, _, bottom_left = sheet.corners[number][:, :2]
        plane.append(top_left + (cells @ np.stack((top_right - top_left, bottom_left - top_left))) / TAG)
        pixels.append((at + 0.5) * times - 0.5)
        across.append(normals)
        corners[number] = (found + 0.5) * times - 0.5
    on_sheet, in_photo, turned = (np.concatenate(part) if part else np.zeros((0, 2))
                                  for part in (plane, pixels, across))
    return Edges(on_sheet, in_photo, turned, corners, trimmed and not none,
                 fault_of(eight) if none else None)


def _tags(sheet: Sheet, grey: NDArray, shown: NDArray[np.uint8], linear: NDArray[np.float32],
          patient: bool) -> dict[int, Measured]:
    """A dict: id to measured tag. ``shown`` is ``grey`` in 8 bits.

    Tags that touch the photo's edge are measured at their cell edges. If the others are too few, all missing
    tags are searched again, and measured at their cell edges.
    """
    measured = {number: m for number, at in detected(shown).items() if (m := _measured(grey, linear, at))}
    starts, few = {number: m[-1] for number, m in measured.items()}, len(measured) < LEAST_TAGS
    if few:
        starts = sought(shown, patient) | starts
    for _ in range(2):
        missing = {number: corners for number, corners in expected(starts, sheet).items()
                   if number not in measured and (few or at_rim(corners, grey.shape))}
        measured |= _inside(grey, linear, missing) if few else {}
        measured |= _inside(grey, linear, {number: starts.get(number, corners)
                                           for number, corners in missing.items() if number not in measured})
        starts = {number: m[-1] for number, m in measured.items()}
    return measured


def _inside(grey: NDArray, linear: NDArray[np.float32], corners: Mapping[int, Array]) -> dict[int, Measured]:
    """A dict: id to tag, measured at its cell edges. ``corners``: id to expected corners (4 x 2)."""
    return {number: m for number, at in corners.items()
            if (m := measured_inside(grey, linear, number, at))}


# In cells: places of profiles along an edge; directions along, and out of, the top, right, bottom, left edge.
_ALONG = 1 + (TAG - 2) * (np.arange(POINTS * WIDTH) + 0.5) / (POINTS * WIDTH)
_WAY = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
_OUT = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])


def _measured(grey: NDArray, linear: NDArray[np.float32], corners: Array) -> Measured | None:
    """Measure a tag at its outer edges (:data:`Measured`); None: an edge has too few points."""
    found = corners
    on = CORNERS[:, None] + _ALONG[:, None] * _WAY[:, None]  # 4 x (POINTS * WIDTH) x 2
    for last in (False, True):
        warp = cv2.getPerspectiveTransform(CORNERS.astype(np.float32),
                                           corners.astype(np.float32)).astype(np.float64)
        cell = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean() / TAG
        reach = min(REACH, REACH_PIXELS / cell) if last else REACH
        steps = np.linspace(-reach, reach, PROFILE)
        at = mapped(warp, on[:, :, None] + steps[:, None] * _OUT[:, None, None])
        values = profile_values(grey, linear, found, at).reshape(4, POINTS, WIDTH, PROFILE)
        values = values.mean(axis=2, dtype=np.float64)
        offset = crossings(values, steps)
        good = np.isfinite(offset)
        if (good.sum(axis=1) < LEAST_POINTS).any():
            return None
        middle = on.reshape(4, POINTS, WIDTH, 2).mean(axis=2)
        edge = middle + np.nan_to_num(offset)[..., None] * _OUT[:, None]
        pixels = mapped(warp, edge)
        corners = _corners([pixels[side][good[side]] for side in range(4)])
    return middle[good], pixels[good], _across(warp, edge, _WAY[:, None])[good], corners


def _corners(sides: list[Array]) -> Array:
    """Where lines through the points of neighbouring sides (K x 2; top, right, bottom, left) meet: 4 x 2."""
    lines = []
    for points in sides:
        centre = np.median(points, axis=0)
        way = np.linalg.svd(points - points.mean(axis=0))[2][0]
        lines.append((centre, way))
    found = []
    for (p, v), (q, w) in zip(lines[-1:] + lines[:-1], lines):
        found.append(p + v * np.linalg.solve(np.stack((v, -w), axis=1), q - p)[0])
    return np.array(found)
