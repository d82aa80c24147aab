"""Find rectified photos that are turned or mirrored relative to the others, by their pattern.

The fine pattern of each photo is correlated with those of the others, in all eight orientations of a square.
Correlations are squared, because a relief lit from the opposite side looks like its negative.
"""

from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor

from ..io.images import averaged
from .capture import Capture
from .photo import Photo
from .rig import LEAST_PHOTOS, OnePlace

SIDE = 128  # pixels a side that are compared; with 64, three of 6,384 photos were turned wrongly
FINE = 3.0  # pixels; coarser differences come from the light
DIM = 0.02  # display value, added before the logarithm
# Least ratio of the mean squared correlation to that of any other way, and to that by chance. No photo of
# eighteen real captures and twenty known materials was turned wrongly. As stored, photos of these captures
# have a ratio to chance of 8 to 3,268, most raw photos of a simulated phone of up to 1.7.
CLEARLY = 4.0
SHIFTS = (1 / 2, 1 / 2), (1 / 3, 1 / 4), (1 / 4, 2 / 3)  # of the side; patterns shifted so agree by chance
WAYS = tuple(product((False, True), range(4)))  # mirrored or not, quarter turns


def in_place(photos: Sequence[Photo]) -> bool:
    """Whether most photos show the pattern in the same place: they are rectified, or from a tripod."""
    small = [cv2.resize(each, (SIDE, SIDE), interpolation=cv2.INTER_AREA) / np.iinfo(each.dtype).max
             for each in (photo.pixels(4 * SIDE) for photo in photos)]
    own, chance = _squares(_fine(np.stack(small)))
    others = ~np.eye(len(small), dtype=bool)
    told, by_chance = own[..., 0].mean(axis=0, where=others), chance.mean(axis=-1).mean(axis=0, where=others)
    return 2 * int((told > CLEARLY * by_chance).sum()) > len(small)


def one_place(count: int) -> OnePlace:
    """The error to raise for ``count`` photos that are from one place."""
    return OnePlace("photos from different places",
                    f"{count} photos that show all in the same place: from a tripod, or rectified already",
                    "move the phone between photos; `mitsvbrdf fit` takes rectified ones of the patch alone")


def laid(photos: Tensor, way: int) -> Tensor:
    """Photos, N x R x R x C or N x R x R, mirrored and turned in one of :data:`WAYS`."""
    mirrored, turns = WAYS[way]
    photos = photos.rot90(turns, (1, 2))
    return photos.flip(2) if mirrored else photos


def ways(capture: Capture) -> list[int]:
    """For each photo, the index in WAYS at which its pattern agrees with most photos; 0 if unclear."""
    if len(capture) < LEAST_PHOTOS or capture.resolution < SIDE:
        return [0] * len(capture)
    own, chance = _squares(_pattern(capture))
    best = own.argmax(axis=-1)
    alike = max((best[root] == way for root in range(len(best)) for way in range(len(WAYS))),
                key=lambda group: group.sum())
    found = [0] * len(capture)
    if 2 * alike.sum() <= len(capture):
        return found
    for photo in np.flatnonzero(~alike):
        told = own[alike, photo].mean(axis=0)
        way = int(told.argmax())
        others = max(np.delete(told, way).max(), chance[alike, photo].mean(axis=0).max())
        if told[way] > CLEARLY * others:
            found[photo] = way
    return found


def laid_alike(capture: Capture, larger: Capture | None = None) -> Capture:
    """Turn photos to the orientation of most, if their patterns clearly show it; a note names each of them.

    ``larger``: the same photos in more pixels, which are compared instead.
    """
    found = ways(larger or capture)
    if not any(found):
        return capture
    kept = {"photos": capture.stored, "measured": capture.measured, "single": capture.single}
    turned = {name: torch.cat([laid(photo, way) for photo, way in zip(pixels.split(1), found)])
              for name, pixels in kept.items() if pixels is not None}
    notes = []
    for way in sorted(set(found) - {0}):
        mirrored, turns = WAYS[way]
        names = ", ".join(name for name, own in zip(capture.names, found) if own == way)
        how = " and ".join(["mirrored"] * mirrored + [f"turned by {180 if turns == 2 else 90} degrees"]
                           * (turns > 0))
        notes.append(f"{how} beside the others, as the pattern shows: {names}; laid as the others lie")
    return capture.but(**turned, notes=(*capture.notes, *notes))


def _pattern(capture: Capture) -> Tensor:
    """The fine pattern of each photo, equally strong everywhere, N x R x R; 0 where not measured."""
    fine = _fine(np.stack([averaged(photo.numpy(), SIDE) for photo in capture.stored]))
    measured = capture.measured_at(SIDE)
    return fine if measured is None else fine * measured


def _fine(photos: np.ndarray) -> Tensor:
    """The fine pattern of photos N x R x R x 3, without regard to masks."""
    grey = np.log(photos.mean(axis=-1) + DIM)
    fine = grey - gaussian_filter(grey, (0, FINE, FINE), mode="nearest")
    strength = np.sqrt(gaussian_filter(fine**2, (0, 3 * FINE, 3 * FINE), mode="nearest")) + 1e-3
    return torch.from_numpy(np.tanh(fine / strength / 1.5))


def _squares(pattern: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Squared correlations of photo i with photo j in each way, N x N x 8; and with j also shifted, x 24."""
    pattern = pattern / pattern.flatten(1).norm(dim=1).clamp_min(1e-9)[:, None, None]
    flat, own, chance = pattern.flatten(1), [], []
    for way in range(len(WAYS)):
        other = laid(pattern, way)
        own.append(flat @ other.flatten(1).T)
        chance += [flat @ other.roll((round(y * SIDE), round(x * SIDE)), (1, 2)).flatten(1).T
                   for y, x in SHIFTS]
    return torch.stack(own, -1).square().numpy(), torch.stack(chance, -1).square().numpy()
