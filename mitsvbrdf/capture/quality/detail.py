"""Detail of whole photos, which tells the blurred ones among those that no pose was found of."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import cv2
import numpy as np

from ..photo import Photo
from ..rectify import LONG_SIDE

# of a whole photo, beside others; simulated ones that are blurred have 0.29 to 0.35, unrelated ones 0.63
LEAST_DETAIL = 0.45


def blurred(photos: Sequence[Photo], reasons: Mapping[str, str],
            others: Collection[np.ndarray]) -> dict[str, str]:
    """A better reason for photos without a pose that are blurred, which is why they have none.

    Args:
        photos: without a pose.
        reasons: why they are rejected, by name.
        others: whole photos that have a pose, H x W x 3, 8 or 16 bits.
    """
    usual = float(np.median([detail_of(pixels) for pixels in others]))
    sharpness = {photo.name: detail_of(photo.pixels(LONG_SIDE)) / usual for photo in photos}
    return {name: f"blurred: {sharp:.2f} times as sharp as the others ({reasons[name]})"
            for name, sharp in sharpness.items() if sharp < LEAST_DETAIL}


def detail_of(pixels: np.ndarray) -> float:
    """Finest detail of a whole photo (H x W x 3, 8 or 16 bits) over coarser detail."""
    luminance = pixels.mean(axis=2, dtype=np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    smooth = cv2.GaussianBlur(luminance, (0, 0), 1.5)
    return rms(luminance - smooth) / max(rms(smooth - cv2.GaussianBlur(luminance, (0, 0), 6)), 1e-9)


def rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.square(values).mean()))
