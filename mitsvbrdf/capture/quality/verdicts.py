"""Which photos are rejected, and why: verdicts on their quality.

A photo is rejected where it would do harm: highlights, falloff, shadows of a relief and the softness of a
slanted view are no reasons. A new reason is a function like those below and a line of :data:`REASONS`; a
number that it needs is a field of :class:`~.photo_quality.PhotoQuality`.

Limits were measured on 108 photos of twelve materials, none of which may be called bad; behind each stands
the worst of these.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from ... import color
from ...material.resample import resized
from ...views import Views
from ..photo import Photo
from ..rectify import LONG_SIDE
from .photo_quality import PhotoQuality, detail_of, photo_qualities

LEAST_OVERLAP = 0.95  # of the patch; texels beyond a photo's edge are filled in from the others
MOST_CLIPPED = 0.4  # of the patch; 0.22
# of the median photo's; 0.57. Simulated photos of four materials by a hand that moved: 0.33 to 0.47
LEAST_SHARPNESS = 0.52
# pixels of the patch; with fewer the limit falls in proportion: of 128, where it is 0.26, real ones have 0.37
ENOUGH = 256
MOST_STOPS = 1.6  # brighter or darker than the others; 1.2
# of the patch, in one piece; 0.18 and 0.14, with a highlight on metal 0.21. A finger over half of it: 0.28 to
# 0.52, and where its colour is that of the material 0.35 to 0.39
UNLIKE, UNLIKE_DETAIL = 0.25, 0.28
# of evenness (0: falls off as a flash's light does, 1: even); 0.65. Simulated photos without flash: 0.99
MOST_EVENNESS = 0.8
# detail of a whole photo, beside others; simulated blurred ones have 0.29 to 0.35, unrelated ones 0.63
LEAST_DETAIL = 0.45
SAME_PLACE, SAME_PICTURE = 0.05, 0.02  # patch sides, mean difference of display values; 0.135 and 0.035


@dataclass(frozen=True)
class Beside:
    """What a photo is judged beside: all photos, pixels a side of the patch, flash "fired" or "off"."""

    qualities: Sequence[PhotoQuality]
    side: int
    fired: Mapping[str, str]


def _flash_off(photo: PhotoQuality, beside: Beside) -> str | None:
    some_fired = any(beside.fired.get(each.name) == "fired" for each in beside.qualities)
    off = some_fired and beside.fired.get(photo.name) == "off"
    return "taken without flash (says its EXIF)" if off else None


def _outside(photo: PhotoQuality, beside: Beside) -> str | None:
    outside = photo.overlap < LEAST_OVERLAP
    return f"partly outside: it shows only {photo.overlap:.0%} of the patch" if outside else None


def _overexposed(photo: PhotoQuality, beside: Beside) -> str | None:
    clipped = photo.clipped > MOST_CLIPPED
    return f"overexposed: {photo.clipped:.0%} of the patch is clipped" if clipped else None


def _covered(photo: PhotoQuality, beside: Beside) -> str | None:
    piece = max(photo.unlike, photo.unlike_detail)
    covered = photo.unlike > UNLIKE or photo.unlike_detail > UNLIKE_DETAIL
    return (f"covered: {piece:.0%} of the patch is nothing like in the other photos, as if a finger or a "
            "shadow were on it") if covered else None


def _exposure(photo: PhotoQuality, beside: Beside) -> str | None:
    way = "brighter" if photo.stops > 0 else "darker"
    other = abs(photo.stops) > MOST_STOPS
    return f"{abs(photo.stops):.1f} stops {way} than the other photos" if other else None


def _blurred(photo: PhotoQuality, beside: Beside) -> str | None:
    soft = photo.sharpness < LEAST_SHARPNESS * min(1, beside.side / ENOUGH)
    return f"blurred: {photo.sharpness:.2f} times as sharp as the others" if soft else None


def _even_light(photo: PhotoQuality, beside: Beside) -> str | None:
    even = [each.name for each in beside.qualities if (each.evenness or 0) > MOST_EVENNESS]
    # of most photos, it says that the model is wrong
    alone = photo.name in even and len(even) < len(beside.qualities) / 2
    return "taken without flash: its light does not fall off as that of the others does" if alone else None


# In the order in which they are asked: the first that holds is named. True: a photo like that may mislead the
# search for where all cameras stood.
REASONS: tuple[tuple[Callable[[PhotoQuality, Beside], str | None], bool], ...] = (
    (_flash_off, False), (_outside, True), (_overexposed, False), (_covered, True), (_exposure, False),
    (_blurred, True), (_even_light, False))


@dataclass(frozen=True)
class Verdicts:
    """What is said of photos.

    Args:
        qualities: how good each photo is, by name.
        rejected: reason, by name of each photo that is rejected.
        misled: whether poses found with a rejected photo are not to be trusted.
    """

    qualities: dict[str, PhotoQuality]
    rejected: dict[str, str]
    misled: bool


def judge(photos: Tensor, views: Views, transfer: color.Transfer, overlap: Mapping[str, float],
          evenness: Mapping[str, float] | None = None, fired: Mapping[str, str] | None = None) -> Verdicts:
    """Verdicts on photos, each beside the others.

    Args:
        photos: N x R x R x 3 display values in [0, 1], rectified.
        views: theirs.
        transfer: of the photos.
        overlap: share of the patch that each shows, by name, in the order of the photos.
        evenness: see :class:`~.photo_quality.PhotoQuality`.
        fired: "fired" or "off" by name, as EXIF says of the flash.
    """
    found = photo_qualities(photos, views, transfer, overlap, evenness)
    beside, rejected, misled = Beside(found, photos.shape[1], fired or {}), dict[str, str](), False
    for photo in found:
        said = ((reason(photo, beside), misleads) for reason, misleads in REASONS)
        what, misleads = next((each for each in said if each[0]), (None, False))
        if what:
            rejected[photo.name], misled = what, misled or misleads
    rejected |= _twice(found, photos, views, rejected)
    return Verdicts({photo.name: photo for photo in found}, rejected, misled)


def _twice(found: Sequence[PhotoQuality], photos: Tensor, views: Views,
           rejected: Collection[str]) -> dict[str, str]:
    """The reason of each photo that shows what an earlier one shows, of those that are not rejected."""
    small, camera = resized(photos, min(64, photos.shape[1])), views.in_patch_sides().camera
    again = dict[str, str]()
    for i, photo in enumerate(found):
        for j, first in enumerate(found[:i]):
            near = ((camera[i] - camera[j]).norm() < SAME_PLACE
                    and (small[i] - small[j]).abs().mean() < SAME_PICTURE)
            if near and not {photo.name, first.name} & {*rejected, *again}:
                again[photo.name] = f"the same photo as {first.name}, from the same place"
    return again


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
