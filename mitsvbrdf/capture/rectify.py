"""Photos rectified to the frontal view of the patch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ..errors import warn_of
from ..io.images import display
from .capture import LEAST_SIDE, check_held
from .lens import Lens, Pose, project
from .photo import Photo, reduced
from .rig import Rig

LONG_SIDE = 1024  # pixels of the small copy of a whole photo
CORNERS = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])  # of the patch


@dataclass(frozen=True)
class Rectified:
    """Rectified photos, not processed otherwise. The keys of each dict are names of photos."""

    # display values of the patch, R x R x 3 float32 in [0, 1], with vignetting; NaN: outside or masked
    pictures: dict[str, np.ndarray]
    overlap: dict[str, float]  # share of the patch within a photo, masked or not
    small: dict[str, np.ndarray]  # whole photos, at most 1024 pixels long, as stored
    outside: dict[str, float]  # share of a photo's pixels whose colours lay outside of sRGB
    notes: tuple[str, ...]  # what a user should know

    @classmethod
    def of(cls, rig: Rig, photos: Sequence[Photo], resolution: int,
           report: Callable[[str, float], object]) -> Rectified:
        """Rectify the photos of ``rig`` to ``resolution`` pixels a side; to fewer if they show fewer."""
        photos = [photo for photo in photos if photo.name in rig.poses]
        at = np.stack([project(rig.lens, pose, CORNERS * rig.size) for pose in rig.poses.values()])
        sides = np.nan_to_num(np.linalg.norm(np.roll(at, -1, axis=1) - at, axis=2))
        shown = int(np.median(sides.min(axis=1)))  # median: pixels along the patch's shortest side
        side = max(LEAST_SIDE, min(resolution, shown))
        check_held(len(photos), side, photos[0].path.parent)
        pictures, overlap, small, outside = {}, {}, {}, {}
        for n, photo in enumerate(photos):
            report(f"rectifying {photo.name}", n / len(photos))
            found = photo.read()
            seen = rectified(found.pixels, rig.lens, rig.poses[photo.name], rig.size, side)
            overlap[photo.name] = float(np.isfinite(seen).all(axis=-1).mean())
            if found.opaque is not None:
                seen = rectified(found.pixels, rig.lens, rig.poses[photo.name], rig.size, side, found.opaque)
            pictures[photo.name] = seen
            small[photo.name], outside[photo.name] = reduced(found.pixels, LONG_SIDE), found.outside
        few = (f"the photos show the patch in {shown} pixels a side, so it is not enlarged to {resolution}",)
        return cls(pictures, overlap, small, outside, few if side < resolution else ())


def rectified(pixels: np.ndarray, lens: Lens, pose: Pose, size: float, resolution: int,
              opaque: np.ndarray | None = None) -> np.ndarray:
    """A photo as seen from straight above: the patch in R x R pixels, row 0 at the top, undistorted.

    The result is R x R x 3 float32 in [0, 1], NaN outside the photo or where it is not ``opaque`` (H x W).
    Each pixel is the average of at least as many samples as the photo has pixels in its area. The photo is
    H x W x 3 as stored (8 or 16 bits, or float32), with the ``size`` of ``lens``.
    """
    import cv2

    height, width = pixels.shape[:2]
    at = project(lens, pose, CORNERS * size)
    longest = np.linalg.norm(np.roll(at, -1, axis=0) - at, axis=1).max()
    times = max(1, int(np.ceil(longest / resolution))) if np.isfinite(longest) else 1
    # Positions of texels as in views.texel_positions, but a band of rows at a time.
    steps = ((np.arange(resolution * times) + 0.5) / (resolution * times) - 0.5) * size
    out = np.empty((resolution, resolution, 3), dtype=np.float32)
    rows = max(1, 2**21 // (resolution * times * times))  # rows of the result at once: memory stays small
    for first in range(0, resolution, rows):
        y = -steps[first * times : (first + rows) * times, None]
        part = np.stack(np.broadcast_arrays(steps, y, 0.0), axis=-1)
        where = project(lens, pose, part.reshape(-1, 3)).reshape(*part.shape[:2], 2)
        where = np.nan_to_num(where, nan=-1e6).astype(np.float32)
        low = np.clip(np.floor(where.min(axis=(0, 1))).astype(int) - 2, 0, (width - 1, height - 1))
        high = np.clip(np.ceil(where.max(axis=(0, 1))).astype(int) + 3, low + 1, (width, height))
        window = display(pixels[low[1] : high[1], low[0] : high[0]])
        if opaque is not None:
            window[~opaque[low[1] : high[1], low[0] : high[0]]] = np.nan
        sampled = cv2.remap(window, where - low.astype(np.float32), None, cv2.INTER_LINEAR,
                            borderMode=cv2.BORDER_REPLICATE)
        outside = ((where < -0.5) | (where > np.array((width, height)) - 0.5)).any(axis=-1)
        sampled[outside] = np.nan
        count = part.shape[0] // times
        out[first : first + count] = sampled.reshape(count, times, resolution, times, 3).mean(axis=(1, 3))
    return out


def filled(pictures: Sequence[np.ndarray], warn: bool = True) -> tuple[torch.Tensor, torch.Tensor | None]:
    """Photos, N x R x R x 3. NaN becomes the mean of the other photos there, or else the nearest pixel.

    The second tensor is N x R x R, True where a photo is measured; None: everywhere.
    """
    stack = np.stack(pictures)
    known = np.isfinite(stack)
    measured = None if known.all() else torch.from_numpy(known.all(axis=-1))
    if measured is not None:
        mean = np.where(known, stack, 0).sum(axis=0) / known.sum(axis=0).clip(1)
        stack = np.where(known, stack, mean)
        unseen = ~known.any(axis=(0, 3))
        if warn and unseen.any():
            warn_of(f"{unseen.mean():.1%} of the patch is masked in all photos; maps are made up there")
        if unseen.any() and not unseen.all():
            from scipy.ndimage import distance_transform_edt

            nearest = distance_transform_edt(unseen, return_distances=False, return_indices=True)
            stack = stack[:, nearest[0], nearest[1]]
    return torch.from_numpy(stack).clamp(0, 1), measured
