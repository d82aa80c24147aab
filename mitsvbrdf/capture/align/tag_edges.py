"""Tags of the sheet in one photo: found by OpenCV's detector, then measured where black turns into white.

Corners that a detector reports are off by half a pixel, and a lens bends the edges between them. So points
along the outer edges of the tags are measured, each across its edge only: where linear light crosses the
middle between black and white.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...color import decode
from ..lens import Array
from ..photo import Photo
from .features import mapped
from .sheet import CODES, TAG, Sheet, tag_cells

MOST_PIXELS = 4100  # of the long side that is measured; 12 megapixels are 4032 wide
SEARCHED = 2050  # of the long side where tags are looked for at first
POINTS, WIDTH = 8, 4  # measured along each edge, from as many profiles each
PROFILE = 33  # samples across an edge
# of a profile to both sides: in cells, in the last pass no more than so many pixels
REACH, REACH_PIXELS = 0.75, 8.0
CONTRAST = 0.03  # linear, between white and black, below which nothing is measured
# of each edge, or the tag does not count; glare, a finger or the rim of the photo took the others
LEAST_POINTS = 3


@dataclass(frozen=True)
class Edges:
    """Measured points of the outer edges of tags.

    Args:
        plane: on the sheet, K x 2 in cm.
        pixels: in the stored photo, K x 2.
        across: unit vectors across the edges in the photo, K x 2; along them alone a point is known.
        corners: of each tag in the photo (4 x 2) by id, in the order of :attr:`Sheet.corners`.
    """

    plane: Array
    pixels: Array
    across: Array
    corners: dict[int, Array]


def find_edges(photo: Photo, sheet: Sheet) -> Edges:
    """The tags of a photo, which is read at no more than 4100 pixels a side."""
    import cv2

    times = -(-max(photo.size) // MOST_PIXELS)
    image = photo.pixels(MOST_PIXELS)
    levels = np.arange(np.iinfo(image.dtype).max + 1) / np.iinfo(image.dtype).max
    linear = decode(torch.from_numpy(levels), "linear" if photo.linear else "srgb").numpy().astype(np.float32)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    del image
    plane, pixels, across, corners = [], [], [], {}
    shown = (np.sqrt(levels) if photo.linear else levels) * 255
    for number, found in _detected(grey if levels.size == 256 else shown.astype(np.uint8)[grey]).items():
        measured = _measured(grey, linear, found)
        if measured is None:
            continue
        cells, at, normals, found = measured
        top_left, top_right, _, bottom_left = sheet.corners[number][:, :2]
        plane.append(top_left + (cells @ np.stack((top_right - top_left, bottom_left - top_left))) / TAG)
        pixels.append((at + 0.5) * times - 0.5)
        across.append(normals)
        corners[number] = (found + 0.5) * times - 0.5
    on_sheet, in_photo, turned = (np.concatenate(part) if part else np.zeros((0, 2))
                                  for part in (plane, pixels, across))
    return Edges(on_sheet, in_photo, turned, corners)


def _detected(grey: NDArray[np.uint8]) -> dict[int, Array]:
    """Corners of the tags (4 x 2) by id; a tag that is seen twice is none."""
    import cv2

    cells = [np.ascontiguousarray(tag_cells(number)[1:-1, 1:-1]).astype(np.uint8)
             for number in range(len(CODES))]
    rows = [cv2.aruco.Dictionary.getByteListFromBits(middle) for middle in cells]
    # A dictionary of our own cells: OpenCV's has this family upside down.
    detector = cv2.aruco.ArucoDetector(cv2.aruco.Dictionary(np.concatenate(rows), 6, 5))
    times = -(-max(grey.shape) // SEARCHED)
    found: dict[int, Array] = {}
    for step in dict.fromkeys((times, 1)):
        small = (cv2.resize(grey, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA) if step > 1
                 else grey)
        corners, numbers, _ = detector.detectMarkers(small)
        numbers = [] if numbers is None else np.ravel(numbers).tolist()
        for number, four in zip(numbers, corners):
            if numbers.count(number) == 1 and number not in found:
                found[number] = (four.reshape(4, 2).astype(np.float64) + 0.5) * step - 0.5
        if len(found) == len(CODES):
            break
    return dict(sorted(found.items()))


# Points in the middle of each edge's parts and the ways outward, in cells; edges top, right, bottom, left.
_ALONG = 1 + (TAG - 2) * (np.arange(POINTS * WIDTH) + 0.5) / (POINTS * WIDTH)
_FROM = np.array([[0, 0], [TAG, 0], [TAG, TAG], [0, TAG]])
_WAY = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
_OUT = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])


def _measured(grey: NDArray, linear: NDArray[np.float32],
              corners: Array) -> tuple[Array, Array, Array, Array] | None:
    """Points of a tag's edges in cells from its top left corner, in pixels, the ways across; its corners."""
    import cv2

    low = np.maximum(np.floor(corners.min(axis=0) - np.ptp(corners, axis=0) / 4).astype(int), 0)
    high = np.ceil(corners.max(axis=0) + np.ptp(corners, axis=0) / 4).astype(int) + 1
    window = linear[grey[low[1] : high[1], low[0] : high[0]]]
    on = _FROM[:, None] + _ALONG[:, None] * _WAY[:, None]  # 4 x (POINTS * WIDTH) x 2
    for last in (False, True):
        warp = cv2.getPerspectiveTransform(_FROM.astype(np.float32),
                                           corners.astype(np.float32)).astype(np.float64)
        cell = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean() / TAG
        reach = min(REACH, REACH_PIXELS / cell) if last else REACH
        steps = np.linspace(-reach, reach, PROFILE)
        at = mapped(warp, on[:, :, None] + steps[:, None] * _OUT[:, None, None])
        where = (at - low).astype(np.float32).reshape(4 * POINTS * WIDTH, PROFILE, 2)
        values = cv2.remap(window, where, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT,
                           borderValue=(np.nan,))
        values = values.reshape(4, POINTS, WIDTH, PROFILE).mean(axis=2, dtype=np.float64)
        offset = _crossings(values, steps)
        good = np.isfinite(offset)
        if (good.sum(axis=1) < LEAST_POINTS).any():
            return None
        middle = on.reshape(4, POINTS, WIDTH, 2).mean(axis=2)
        edge = middle + np.nan_to_num(offset)[..., None] * _OUT[:, None]
        pixels = mapped(warp, edge)
        corners = _corners([pixels[side][good[side]] for side in range(4)])
    tangent = mapped(warp, edge + 0.1 * _WAY[:, None]) - mapped(warp, edge - 0.1 * _WAY[:, None])
    normal = (np.stack((tangent[..., 1], -tangent[..., 0]), axis=-1)
              / np.linalg.norm(tangent, axis=-1, keepdims=True))
    return middle[good], pixels[good], normal[good], corners


def _crossings(values: Array, steps: Array) -> Array:
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
