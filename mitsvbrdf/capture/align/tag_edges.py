"""Tags of the sheet in one photo: found by OpenCV's detector, then measured where black turns into white.

Corners that a detector reports are off by half a pixel, and a lens bends the edges between them. So points
along the outer edges of the tags are measured, each across its edge only: where linear light crosses the
middle between black and white.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...color import decode
from ..lens import Array
from ..photo import Photo
from .features import mapped
from .sheet import TAG, Sheet
from .tag_profiles import PROFILE, Measured, crossings, measured_inside, profile_values
from .tag_search import LEAST_TAGS, at_rim, detected, expected, fault_of, sought, sought_by_features

MOST_PIXELS = 4100  # of the long side that is measured; 12 megapixels are 4032 wide
POINTS, WIDTH = 8, 4  # measured along each edge, from as many profiles each
# of a profile to both sides: in cells, in the last pass no more than so many pixels
REACH, REACH_PIXELS = 0.75, 8.0
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
        trimmed: whether no white around the tags told where they are.
        fault: why there are hardly any, where that is known.
    """

    plane: Array
    pixels: Array
    across: Array
    corners: dict[int, Array]
    trimmed: bool = False
    fault: str | None = None


def find_edges(photo: Photo, sheet: Sheet, patient: bool = True) -> Edges:
    """The tags of a photo, which is read at no more than 4100 pixels a side.

    Args:
        patient: whether a photo that hardly shows any is searched by other means, for what may be wrong, too.
    """
    import cv2

    times = -(-max(photo.size) // MOST_PIXELS)
    image = photo.pixels(MOST_PIXELS)
    levels = np.arange(np.iinfo(image.dtype).max + 1) / np.iinfo(image.dtype).max
    linear = decode(torch.from_numpy(levels), "linear" if photo.linear else "srgb").numpy().astype(np.float32)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    del image
    shown = (np.sqrt(levels) if photo.linear else levels) * 255
    search = _Search(sheet, grey, grey if levels.size == 256 else shown.astype(np.uint8)[grey], linear)
    measured = search.measured(patient)
    if trimmed := patient and len(measured) < LEAST_TAGS:
        corners = sought_by_features(photo, sheet)
        measured |= search.inside({number: (at + 0.5) / times - 0.5 for number, at in corners.items()})
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
                 fault_of(search.shown) if none else None)


@dataclass(frozen=True)
class _Search:
    """A photo as it is searched for the tags of a sheet.

    Args:
        grey: H x W, 8 or 16 bits.
        shown: the same in 8 bits.
        linear: radiance by value of ``grey``.
    """

    sheet: Sheet
    grey: NDArray
    shown: NDArray[np.uint8]
    linear: NDArray[np.float32]

    def measured(self, patient: bool) -> dict[int, Measured]:
        """What is measured by id of the tag.

        Tags that touch the photo's edge are measured inside. Where all others are too few, tags are looked
        for again, and all measured inside.
        """
        found = {number: _measured(self.grey, self.linear, corners)
                 for number, corners in detected(self.shown).items()}
        measured = {number: m for number, m in found.items() if m}
        starts, few = {number: m[-1] for number, m in measured.items()}, len(measured) < LEAST_TAGS
        if few:
            starts = sought(self.shown, patient) | starts
        for _ in range(2):
            missing = {number: corners for number, corners in expected(starts, self.sheet).items()
                       if number not in measured and (few or at_rim(corners, self.grey.shape))}
            measured |= self.inside(missing) if few else {}
            measured |= self.inside({number: starts.get(number, corners) for number, corners in
                                     missing.items() if number not in measured})
            starts = {number: m[-1] for number, m in measured.items()}
        return measured

    def inside(self, corners: Mapping[int, Array]) -> dict[int, Measured]:
        """What is measured inside tags that should have these corners (4 x 2), by id."""
        found = {number: measured_inside(self.grey, self.linear, number, at)
                 for number, at in corners.items()}
        return {number: m for number, m in found.items() if m}


# Points in the middle of each edge's parts and the ways outward, in cells; edges top, right, bottom, left.
_ALONG = 1 + (TAG - 2) * (np.arange(POINTS * WIDTH) + 0.5) / (POINTS * WIDTH)
_FROM = np.array([[0, 0], [TAG, 0], [TAG, TAG], [0, TAG]])
_WAY = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
_OUT = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])


def _measured(grey: NDArray, linear: NDArray[np.float32], corners: Array) -> Measured | None:
    """Points of a tag's edges in cells from its top left corner, in pixels, the ways across; its corners."""
    import cv2

    found = corners
    on = _FROM[:, None] + _ALONG[:, None] * _WAY[:, None]  # 4 x (POINTS * WIDTH) x 2
    for last in (False, True):
        warp = cv2.getPerspectiveTransform(_FROM.astype(np.float32),
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
    tangent = mapped(warp, edge + 0.1 * _WAY[:, None]) - mapped(warp, edge - 0.1 * _WAY[:, None])
    normal = (np.stack((tangent[..., 1], -tangent[..., 0]), axis=-1)
              / np.linalg.norm(tangent, axis=-1, keepdims=True))
    return middle[good], pixels[good], normal[good], corners


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
