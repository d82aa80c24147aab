"""A phone's lens, flash and pose; projection from points of the plane to pixels, and back.

Frames: the plane of the material is z = 0 of the world (x right, y up, z toward the camera,
docs/conventions.md). A camera looks along its own +z, with x to the right and y down in the stored pixels
(OpenCV's axes). Pixels are (column, row) with whole numbers at pixel centres. Stored pixels are those of the
file before any EXIF orientation is applied: turning the phone changes its pose, never its lens or its flash.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..views import FIELD_OF_VIEW

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lens:
    """What all photos of a phone share: its lens, and where its flash is."""

    size: tuple[int, int]  # width and height of the photos in pixels
    focal: float  # focal length in pixels
    centre: tuple[float, float] | None = None  # principal point in pixels; None: the middle of the photo
    # k1, k2 of Brown and Conrady's radial model (OpenCV's first two); 0: no distortion
    distortion: tuple[float, float] = (0.0, 0.0)
    # v1, v2: the lens transmits 1 + v1 r^2 + v2 r^4 of the light; r is 0 in the middle, 1 in the corners
    vignetting: tuple[float, float] = (0.0, 0.0)
    # position of the flash in camera axes, in the world's unit of length; (0, 0, 0): at the lens
    flash: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def middle(self) -> tuple[float, float]:
        """The principal point in pixels."""
        return self.centre or ((self.size[0] - 1) / 2, (self.size[1] - 1) / 2)

    @property
    def angle(self) -> float:
        """Field of view across the long side, degrees."""
        return math.degrees(2 * math.atan(max(self.size) / 2 / self.focal))

    @property
    def matrix(self) -> Array:
        """OpenCV's camera matrix, 3 x 3."""
        x, y = self.middle
        return np.array([[self.focal, 0, x], [0, self.focal, y], [0, 0, 1.0]])

    def radius2(self, pixels: Array) -> Array:
        """Squared distances of pixels (... x 2) from the middle of the photo, 1 at half its diagonal."""
        middle = (np.array(self.size) - 1) / 2
        return np.square(np.asarray(pixels) - middle).sum(axis=-1) / np.square(middle + 0.5).sum()

    def transmission(self, pixels: Array) -> Array:
        """Share of the light that arrives at pixels (... x 2); it is 1 in the middle of the photo."""
        r2 = self.radius2(pixels)
        return 1 + self.vignetting[0] * r2 + self.vignetting[1] * r2**2


def field_of_view(focal_35mm: float, width: int, height: int) -> float:
    """Degrees across the long side. A photo beyond 4:3 to 3:2 is taken for a crop of 4:3, as phones do it."""
    short, long = sorted((width, height))
    cropped = not 1.3 < long / short < 1.53
    diagonal = max(short * 5 / 3, long * 5 / 4) if cropped else math.hypot(short, long)
    return math.degrees(2 * math.atan(long / 2 / (focal_35mm / math.hypot(36, 24) * diagonal)))


def expected_lens(size: tuple[int, int], focal_35mm: Sequence[float]) -> Lens:
    """A pinhole lens with the median of the photos' 35 mm equivalent focal lengths (EXIF).

    If no photo has one, the field of view is :data:`~mitsvbrdf.views.FIELD_OF_VIEW`.
    """
    angle = field_of_view(float(np.median(focal_35mm)), *size) if len(focal_35mm) else FIELD_OF_VIEW
    return Lens(size, max(size) / 2 / math.tan(math.radians(angle) / 2))


def unsure_note(share: float) -> str:
    """A note for the user: the focal length may be wrong by this share."""
    return (f"the focal length is uncertain by {share:.1%}, and so are the heights of the cameras: the "
            "photos are too few or too much alike; a few more, taken from the side, settle it")


@dataclass(frozen=True)
class Pose:
    """Where a camera stood and how it was turned; or N cameras at once."""

    position: Array  # of the lens in the world, 3 (or N x 3)
    rotation: Array  # 3 x 3 (or N x 3 x 3), from world to camera axes

    @classmethod
    def looking_at(cls, position: ArrayLike, target: ArrayLike, turn: float = 0.0) -> Pose:
        """A camera at ``position`` whose axis meets ``target``; at ``turn`` 0 (rad) the world's y is up."""
        position = np.asarray(position, dtype=np.float64)
        z = np.asarray(target, dtype=np.float64) - position
        z = z / np.linalg.norm(z)
        x = np.cross(z, [np.sin(turn), np.cos(turn), 0.0])
        x = x / np.linalg.norm(x)
        return cls(position, np.stack((x, np.cross(z, x), z)))

    def pick(self, index: Any) -> Pose:
        """One or some of the N cameras."""
        return Pose(self.position[index], self.rotation[index])

    def flash(self, lens: Lens) -> Array:
        """Position of the flash in the world, 3."""
        return self.position + self.rotation.T @ np.asarray(lens.flash)

    def upside_down(self) -> Pose:
        """The pose turned by 180 degrees about the camera's axis."""
        return Pose(self.position, np.diag((-1.0, -1.0, 1.0)) @ self.rotation)


def project(lens: Lens, pose: Pose, points: Array) -> Array:
    """Pixels (K x 2) of points of the world (K x 3); points behind the camera give NaN."""
    x, y, z = ((np.asarray(points, dtype=np.float64) - pose.position) @ pose.rotation.T).T
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.where(z > 0, np.stack((x, y)) / z, np.nan)
    r2 = np.square(at).sum(axis=0)
    bent = at * (1 + lens.distortion[0] * r2 + lens.distortion[1] * r2**2)
    return (lens.focal * bent).T + lens.middle


def rays(lens: Lens, pixels: Array) -> Array:
    """Directions (K x 3, camera axes, z = 1) of the rays through pixels (K x 2)."""
    bent = (np.asarray(pixels, dtype=np.float64) - lens.middle) / lens.focal
    at = bent.copy()
    k1, k2 = lens.distortion
    for _ in range(20):  # Newton along the radius; the model is radial
        r2 = np.square(at).sum(axis=-1, keepdims=True)
        slope = 1 + 3 * k1 * r2 + 5 * k2 * r2**2
        step = (at * (1 + k1 * r2 + k2 * r2**2) - bent) / slope
        at = at - step
        if not np.abs(step).max(initial=0.0) > 1e-15:
            break
    return np.concatenate((at, np.ones_like(at[:, :1])), axis=1)


def on_plane(lens: Lens, pose: Pose, pixels: Array, height: float = 0.0) -> Array:
    """Points (K x 2: x, y) where the rays through pixels (K x 2) meet the plane z = ``height``."""
    direction = rays(lens, pixels) @ pose.rotation
    reach = (height - pose.position[2]) / direction[:, 2]
    return (pose.position + direction * reach[:, None])[:, :2]
