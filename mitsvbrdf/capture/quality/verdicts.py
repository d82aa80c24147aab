"""Which photos are better left out, and why: verdicts on their quality.

Verdicts are for photos that would do harm: highlights, falloff, shadows of a relief and the softness of a
slanted view are no reasons. Limits were measured on 108 photos of twelve materials, none of which may be
called bad; behind each stands the worst of these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torch import Tensor

from ...material.resample import resized
from ...views import Views
from .photo_quality import PhotoQuality

LEAST_OVERLAP = 0.95  # of the patch; texels beyond a photo's edge are filled in from the others
MOST_CLIPPED = 0.4  # of the patch; 0.22
# of the median photo's; 0.57. Simulated photos of four materials by a hand that moved: 0.33 to 0.47
LEAST_SHARPNESS = 0.52
# of a whole photo, beside others; simulated ones that are blurred have 0.29 to 0.35, unrelated ones 0.63
LEAST_DETAIL = 0.45
# pixels of the patch; with fewer the limit falls in proportion: of 128, where it is 0.26, real ones have 0.37
ENOUGH = 256
MOST_STOPS = 1.6  # brighter or darker than the others; 1.2
# of the patch, in one piece; 0.18 and 0.14, with a highlight on metal 0.21. A finger over
UNLIKE, UNLIKE_DETAIL = 0.25, 0.28
# half of it: 0.28 to 0.52, and where its colour is that of the material 0.35 to 0.39
# of evenness (0: falls off as a flash's light does, 1: even); 0.65. Simulated photos without flash: 0.99
MOST_EVENNESS = 0.8
SAME_PLACE, SAME_PICTURE = 0.05, 0.02  # patch sides, mean difference of display values; 0.135 and 0.035
# reasons for which positions found with such a photo are not trusted
SPOILS = ("covered", "blurred", "partly")


def verdicts(found: Sequence[PhotoQuality], photos: Tensor, views: Views,
             fired: Mapping[str, str] | None = None) -> dict[str, str]:
    """The reason, by name, of each photo that is better left out.

    Args:
        found: what :func:`~.photo_quality.photo_qualities` gave for these photos and views.
        fired: "fired" or "off" by name, as EXIF says of the flash.
    """
    fired = fired or {}
    some_fired = any(fired.get(quality.name) == "fired" for quality in found)
    even = [quality.name for quality in found if (quality.evenness or 0) > MOST_EVENNESS]
    reasons, sharp = {}, LEAST_SHARPNESS * min(1, photos.shape[1] / ENOUGH)
    for quality in found:
        off = some_fired and fired.get(quality.name) == "off"
        what = "taken without flash (says its EXIF)" if off else _verdict(quality, sharp)
        # of most photos, it says that the model is wrong
        if not what and quality.name in even and len(even) < len(found) / 2:
            what = "taken without flash: its light does not fall off as that of the others does"
        if what:
            reasons[quality.name] = what
    small, camera = resized(photos, min(64, photos.shape[1])), views.in_patch_sides().camera
    for i, quality in enumerate(found):
        for j, first in enumerate(found[:i]):
            near = ((camera[i] - camera[j]).norm() < SAME_PLACE
                    and (small[i] - small[j]).abs().mean() < SAME_PICTURE)
            if near and not {quality.name, first.name} & reasons.keys():
                reasons[quality.name] = f"the same photo as {first.name}, from the same place"
    return reasons


def _verdict(quality: PhotoQuality, least_sharpness: float) -> str | None:
    if quality.overlap < LEAST_OVERLAP:
        return f"partly outside: it shows only {quality.overlap:.0%} of the patch"
    if quality.clipped > MOST_CLIPPED:
        return f"overexposed: {quality.clipped:.0%} of the patch is clipped"
    piece = max(quality.unlike, quality.unlike_detail)
    if quality.unlike > UNLIKE or quality.unlike_detail > UNLIKE_DETAIL:
        return f"covered: {piece:.0%} of the patch is nothing like in the other photos, as if a finger or a shadow were on it"
    if abs(quality.stops) > MOST_STOPS:
        return f"{abs(quality.stops):.1f} stops {'brighter' if quality.stops > 0 else 'darker'} than the other photos"
    if quality.sharpness < least_sharpness:
        return f"blurred: {quality.sharpness:.2f} times as sharp as the others"
    return None


def spoils(reason: str) -> bool:
    """Whether a photo left out for this reason may have misled the search for where all cameras stood."""
    return reason.startswith(SPOILS)
