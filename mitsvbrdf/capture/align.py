"""Plain photos to one frame: SIFT features and a homography to the first photo, and the default geometry.

Source: the paper, III.C; SIFT by Lowe 1999, 2004; MAGSAC++ by Barath 2020 where OpenCV has it, else RANSAC.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ..errors import CaptureError
from ..views import Views

FIELD_OF_VIEW = 60.0  # degrees across the long side where no EXIF says it: a phone's wide camera has 60 to 70
FEATURE_SIDE = 1600  # photos are searched for features at no more than this many pixels a side
CONTRAST = 0.01  # weakest feature; with OpenCV's 0.04, flash photos of wood were warped 50 pixels wrong or left out
RATIO = 0.8  # a match counts when its distance is below this share of the second best's (Lowe 2004)
REPROJECTION = 3.0  # pixels off at which a match is an outlier
LEAST_INLIERS = 15  # any four matches agree with a homography; chance agreements were seen to reach 10
LEAST_SHARE = 0.4  # of the short side: the centred square that a photo must cover
STILL = 0.25  # pixels: corners moved by less are left where they are, unsampled


def align_photos(photos: Sequence[Tensor], names: Sequence[str]) -> tuple[Tensor, list[int], list[str]]:
    """Warp overlapping photos to the first one's frame and cut the largest centred square that all cover.

    Args:
        photos: H x W x 3 float32 display values in [0, 1], all of one size, not necessarily square.
        names: what to call them in the notes.

    Returns:
        The squares, N x S x S x 3; which photos they are (always the first one); and notes, one for each photo that
        could not be aligned, with the reason.

    Raises:
        CaptureError: photos of different sizes.
    """
    for name, photo in zip(names, photos):
        if photo.shape != photos[0].shape:
            raise CaptureError("photos of one size", f"{names[0]} of {_size(photos[0])} and {name} of {_size(photo)}",
                               "take them all upright or all sideways, with one camera, uncropped")
    height, width = photos[0].shape[:2]
    kept, notes, warps = [0], [], [np.eye(3)]
    first = _features(photos[0]) if len(photos) > 1 else None
    for i in range(1, len(photos)):
        warp, reason = _homography(_features(photos[i]), first, width, height)
        if warp is None:
            notes.append(f"{names[i]} is left out: {reason}")
        else:
            kept.append(i)
            warps.append(warp)
    if len(photos) > 1 and len(kept) == 1:
        notes.append(f"only {names[0]} is left: no other photo could be aligned to it")
    side = min(_covered(warp, width, height) for warp in warps)
    top, left = (height - side) // 2, (width - side) // 2
    squares = [_warped(photos[i], warp)[top : top + side, left : left + side] for i, warp in zip(kept, warps)]
    return torch.stack(squares), kept, notes


def _features(photo: Tensor) -> tuple[np.ndarray, np.ndarray | None]:
    """SIFT key points (K x 2, pixels of the full photo) and descriptors (K x 128)."""
    import cv2

    image = np.rint(photo.mean(dim=2).clamp(0, 1).numpy() * 255).astype(np.uint8)
    scale = min(1.0, FEATURE_SIDE / max(image.shape))
    if scale < 1:
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    points, descriptors = cv2.SIFT_create(nfeatures=8000, contrastThreshold=CONTRAST).detectAndCompute(image, None)
    # Pixel centres are whole numbers in OpenCV, so that a shrunk image is shifted by half a pixel's difference.
    shift = np.array([photo.shape[1] / image.shape[1], photo.shape[0] / image.shape[0]])
    return (np.array([p.pt for p in points]).reshape(-1, 2) + 0.5) * shift - 0.5, descriptors


def _homography(features, target, width: int, height: int) -> tuple[np.ndarray | None, str]:
    """The 3 x 3 map from a photo's pixels to the first one's, or None and the reason."""
    import cv2

    (points, descriptors), (target_points, target_descriptors) = features, target
    if min(len(points), len(target_points)) < LEAST_INLIERS:
        return None, f"{min(len(points), len(target_points))} features, too few to align"
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(descriptors, target_descriptors, k=2)
    good = [p[0] for p in pairs if len(p) == 2 and p[0].distance < RATIO * p[1].distance]
    if len(good) < LEAST_INLIERS:
        return None, f"{len(good)} features in common with the first photo, {LEAST_INLIERS} needed"
    source = points[[m.queryIdx for m in good]].astype(np.float64)
    aim = target_points[[m.trainIdx for m in good]].astype(np.float64)
    warp, inliers = cv2.findHomography(source, aim, getattr(cv2, "USAC_MAGSAC", cv2.RANSAC), REPROJECTION)
    count = 0 if warp is None else int(inliers.sum())
    if count < LEAST_INLIERS:
        return None, f"{count} features agree with one homography, {LEAST_INLIERS} needed"
    corners = _mapped(np.linalg.inv(warp), _corners(0, 0, width - 1, height - 1))
    edges = np.roll(corners, -1, axis=0) - corners
    turns = edges[:, 0] * np.roll(edges, -1, axis=0)[:, 1] - edges[:, 1] * np.roll(edges, -1, axis=0)[:, 0]
    area = 0.5 * turns[[0, 2]].sum() / (width * height)
    if not (np.isfinite(corners).all() and (turns > 0).all() and 0.25 < area < 4):
        return None, "its homography is wild (folded, or scaled more than 2 times)"
    if _covered(warp, width, height) < LEAST_SHARE * min(width, height):
        return None, "it overlaps the middle of the first photo too little"
    return warp, ""


def _corners(left: float, top: float, right: float, bottom: float) -> np.ndarray:
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]], dtype=np.float64)


def _mapped(warp: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (K x 2) under a homography."""
    out = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ warp.T
    return out[:, :2] / out[:, 2:]


def _still(warp: np.ndarray, width: int, height: int) -> bool:
    corners = _corners(0, 0, width - 1, height - 1)
    return bool(np.abs(_mapped(warp, corners) - corners).max() < STILL)


def _covered(warp: np.ndarray, width: int, height: int) -> int:
    """Side of the largest centred square of the first frame whose corners all lie in the warped photo."""
    if _still(warp, width, height):
        return min(width, height)
    back, low, high = np.linalg.inv(warp), 0, min(width, height)
    while low < high:
        side = (low + high + 1) // 2
        top, left = (height - side) // 2, (width - side) // 2
        x, y = _mapped(back, _corners(left, top, left + side - 1, top + side - 1)).T
        inside = x.min() >= 0 and y.min() >= 0 and x.max() <= width - 1 and y.max() <= height - 1
        low, high = (side, high) if inside else (low, side - 1)
    return low


def _warped(photo: Tensor, warp: np.ndarray) -> Tensor:
    import cv2

    height, width = photo.shape[:2]
    if _still(warp, width, height):
        return photo
    out = cv2.warpPerspective(photo.numpy(), warp, (width, height), flags=cv2.INTER_CUBIC)
    return torch.from_numpy(out).clamp(0, 1)


def _size(photo: Tensor) -> str:
    return f"{photo.shape[1]} x {photo.shape[0]}"


def default_views(count: int, field_of_view: float = FIELD_OF_VIEW, share: float = 1.0) -> Views:
    """The geometry assumed for photos without calibration: all alike, camera and light together above the centre.

    Args:
        count: number of photos.
        field_of_view: degrees across the photo's long side.
        share: the patch side as a share of that long side.

    Returns:
        Views with the patch side as unit; the intensity is such that a white diffuse texel at the patch centre has
        radiance 1, so that display values read as albedo.
    """
    distance = 0.5 / (share * math.tan(math.radians(field_of_view) / 2))
    return Views.of([[0.0, 0.0, distance]] * count, intensity=math.pi * distance**2)


def field_of_view(focal_35mm: float, width: int, height: int) -> float:
    """Degrees across the long side of a photo, from its 35 mm equivalent focal length (equal diagonals, 43.27 mm)."""
    focal = focal_35mm / math.hypot(36, 24) * math.hypot(width, height)
    return math.degrees(2 * math.atan(max(width, height) / 2 / focal))
