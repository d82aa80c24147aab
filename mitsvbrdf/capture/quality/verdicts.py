"""Which photos are rejected, and why: verdicts on their quality.

A photo is rejected only if it would do harm. Highlights, falloff, shadows of a relief and the softness of a
slanted view are no reasons.

Limits were measured on 108 photos of twelve materials. None of these photos is bad; the comment of each
limit gives the worst value among them.
"""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from torch import Tensor

from ...material.resample import resized
from ...views import Views
from ..photo import Photo
from ..rectify import LONG_SIDE
from .photo_quality import PhotoQuality, detail_of

LEAST_OVERLAP = 0.95  # of the patch; texels beyond a photo's edge are filled in from the others
MOST_CLIPPED = 0.4  # of the patch; 0.22
# of the median photo's; 0.57. Simulated photos of four materials with a moving hand: 0.33 to 0.47
LEAST_SHARPNESS = 0.52
# pixels a side; with fewer, LEAST_SHARPNESS falls in proportion: to 0.26 at 128, where real photos have 0.37
ENOUGH = 256
MOST_STOPS = 1.6  # brighter or darker than the others; 1.2
# of the patch, in one piece; 0.18 and 0.14, with a highlight on metal 0.21. A finger over half of the
# patch: 0.28 to 0.52, and 0.35 to 0.39 if it has the colour of the material
UNLIKE, UNLIKE_DETAIL = 0.25, 0.28
# of evenness (0: falls off as a flash's light does, 1: even); 0.65. Simulated photos without flash: 0.99
MOST_EVENNESS = 0.8
# detail of a whole photo over that of others; simulated blurred photos: 0.29 to 0.35, unrelated ones: 0.63
LEAST_DETAIL = 0.45
SAME_PLACE, SAME_PICTURE = 0.05, 0.02  # patch sides, mean difference of display values; 0.135 and 0.035


def _reason(photo: PhotoQuality, qualities: Sequence[PhotoQuality], side: int,
            fired: Mapping[str, str]) -> tuple[str, bool] | None:
    """The first reason to reject a photo, and whether it may have made all poses wrong; None: no reason."""
    if fired.get(photo.name) == "off" and any(fired.get(each.name) == "fired" for each in qualities):
        return "taken without flash (says its EXIF)", False
    if photo.overlap < LEAST_OVERLAP:
        return f"partly outside: it shows only {photo.overlap:.0%} of the patch", True
    if photo.masked == 1:
        return "masked: its alpha hides all that it shows of the patch", False
    if photo.clipped > MOST_CLIPPED:
        return f"overexposed: {photo.clipped:.0%} of the patch is clipped", False
    if photo.unlike > UNLIKE or photo.unlike_detail > UNLIKE_DETAIL:
        return (f"covered: {max(photo.unlike, photo.unlike_detail):.0%} of the patch is nothing like in the "
                "other photos, as if a finger or a shadow were on it"), True
    if abs(photo.stops) > MOST_STOPS:
        way = "brighter" if photo.stops > 0 else "darker"
        return f"{abs(photo.stops):.1f} stops {way} than the other photos", False
    if photo.sharpness < LEAST_SHARPNESS * min(1, side / ENOUGH):
        return f"blurred: {photo.sharpness:.2f} times as sharp as the others", True
    even = [each.name for each in qualities if (each.evenness or 0) > MOST_EVENNESS]
    if photo.name in even and len(even) < len(qualities) / 2:  # else the model is wrong
        return "taken without flash: its light does not fall off as that of the others does", False
    return None


def judge(found: Sequence[PhotoQuality], photos: Tensor, views: Views, fired: Mapping[str, str]
          ) -> tuple[dict[str, str], bool]:
    """A dict: name of each rejected photo to the reason; and whether they may have made the poses wrong.

    ``found``: the quality of each of ``photos`` (N x R x R x 3 display values). ``fired``: name to "fired" or
    "off", the flash in EXIF.
    """
    rejected, misled = dict[str, str](), False
    for photo in found:
        if said := _reason(photo, found, photos.shape[1], fired):
            rejected[photo.name], misled = said[0], misled or said[1]
    return rejected | _twice(found, photos, views, rejected), misled


def _twice(found: Sequence[PhotoQuality], photos: Tensor, views: Views,
           rejected: Collection[str]) -> dict[str, str]:
    """A dict: name to reason, for each photo not rejected yet that shows the same as an earlier one."""
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
    """A dict: name to a better reason, for photos without a pose that are blurrier than ``others``."""
    usual = float(np.median([detail_of(pixels) for pixels in others]))
    sharpness = {photo.name: detail_of(photo.pixels(LONG_SIDE)) / usual for photo in photos}
    return {name: f"blurred: {sharp:.2f} times as sharp as the others ({reasons[name]})"
            for name, sharp in sharpness.items() if sharp < LEAST_DETAIL}
