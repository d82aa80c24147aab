"""Photos rectified by their poses, aligned to what they look like together, by their detail instead of single features."""

from __future__ import annotations

import warnings
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from .features import mapped
from .lens import Lens, Pose, project
from .photo import Photo
from .planar import Match
from .rig import rectified

SIDE = 512  # pixels of the patch
CLIPPED = 0.97  # display values from which on a pixel says nothing
DETAIL = 6.0  # pixels: what changes more slowly is light, not material
GRID = 8  # points along a side that are carried to the bundle adjustment
SIGMA = 0.25  # of where they are, in pixels of the patch
ROUNDS = 2
GAIN = 1e-3  # by how much the correlation must rise
FARTHEST = 16.0  # pixels: what features have aligned is not off by more


def detail(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """A photo without its light: log values, less their surroundings' mean, over their deviation; and where it is known.

    Args:
        image: R x R x 3 display values, NaN outside the photo.

    Returns:
        R x R float32 in [-3, 3], and R x R, 255 where not clipped or outside.
    """
    import cv2

    known = np.isfinite(image).all(axis=-1)
    known &= np.nan_to_num(image).max(axis=-1) < CLIPPED
    known = cv2.erode(known.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=1)
    weight = known.astype(np.float32)
    value = np.log(np.nan_to_num(image).mean(axis=-1) + 0.02) * weight

    def mean(x):
        return cv2.GaussianBlur(x, (0, 0), DETAIL) / np.maximum(cv2.GaussianBlur(weight, (0, 0), DETAIL), 1e-3)

    value = (value - mean(value)) * weight
    value = value / np.sqrt(mean(value**2) + 1e-4)
    return np.clip(value, -3, 3), known * np.uint8(255)


def refine(photos: dict[str, Photo], lens: Lens, poses: dict[str, Pose], size: float = 1.0) -> list[Match]:
    """Where the same points of the patch are in each pair of photos, by enhanced correlation (Evangelidis and Psarakis 2008).

    Each photo is aligned to the median of all by a homography, which is taken only where the two then correlate better.

    Args:
        photos: by name.
        poses: of those that are looked at.
        size: side of the patch.

    Returns:
        The points of a grid over the patch, for each pair of photos; none where no photo could be aligned better.
    """
    import cv2

    details = {name: detail(rectified(photos[name].pixels(4 * SIDE), lens, pose, size, SIDE)) for name, pose in poses.items()}
    warps = {name: np.eye(3, dtype=np.float32) for name in poses}
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-5)
    for _ in range(ROUNDS):
        together = _median([_warped(*details[name], warps[name]) for name in poses])
        for name, (image, known) in details.items():
            before = _correlation(together, _warped(image, known, warps[name]))
            try:
                _, warp = cv2.findTransformECC(together, image, warps[name].copy(), cv2.MOTION_HOMOGRAPHY, criteria, known, 3)
            except cv2.error:  # does not converge
                continue
            corners = np.array([[0.0, 0], [SIDE, 0], [SIDE, SIDE], [0, SIDE]])
            far = np.abs(mapped(warp.astype(np.float64), corners) - corners).max()
            if far < FARTHEST and _correlation(together, _warped(image, known, warp)) > before + GAIN:
                warps[name] = warp
    if all((warp == np.eye(3)).all() for warp in warps.values()):
        return []
    steps = (np.arange(GRID) + 0.5) / GRID * SIDE - 0.5
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    at, pixel = {}, {}
    for name, pose in poses.items():
        x, y = ((mapped(warps[name].astype(np.float64), grid) + 0.5) / SIDE - 0.5).T * size
        at[name] = project(lens, pose, np.stack((x, -y, np.zeros_like(x)), axis=1))
        pixel[name] = lens.focal / pose.position[2] * size / SIDE
    return [Match(a, b, at[a], at[b], SIGMA * pixel[b]) for a, b in combinations(poses, 2)]


def _warped(image, known, warp):
    """What is known of an image under ``warp`` (from the result to the image), NaN elsewhere."""
    import cv2

    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    moved = cv2.warpPerspective(image, warp, (SIDE, SIDE), flags=how)
    moved[cv2.warpPerspective(known, warp, (SIDE, SIDE), flags=how) < 255] = np.nan
    return moved


def _median(images):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a pixel that is known nowhere
        return np.nan_to_num(np.nanmedian(np.stack(images), axis=0)).astype(np.float32)


def _correlation(a, b) -> float:
    inside = np.isfinite(b)
    return float(np.corrcoef(a[inside], b[inside])[0, 1]) if inside.sum() > 100 else -1.0
