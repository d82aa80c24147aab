"""What is good and bad about photos of a patch: sharpness, exposure, fingers, and where nobody has stood yet.

A photo is compared with the others where they should agree. Each texel's radiance over its irradiance is its apparent albedo;
the median over the photos has neither highlight nor finger. Verdicts are for photos that would do harm: highlights, falloff,
shadows of a relief and the softness of a slanted view are no reasons. Limits were measured on 108 photos of twelve materials,
none of which may be called bad; behind each stands the worst of these.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..views import Views, coverage_angle, texel_positions
from .guess import CLIPPED

SIDE, FINE_SIDE = 32, 512  # texels a side at which radiance is compared, and at most at which detail is
LEAST_OVERLAP = 0.95  # of the patch; texels beyond a photo's edge are filled in from the others
MOST_CLIPPED = 0.4  # of the patch; 0.22
LEAST_SHARPNESS = 0.52  # of the median photo's; 0.57. Simulated photos of four materials by a hand that moved: 0.33 to 0.47
LEAST_DETAIL = 0.45  # of a whole photo, beside others; simulated ones that are blurred have 0.29 to 0.35, unrelated ones 0.63
ENOUGH = 256  # pixels of the patch; with fewer the limit falls in proportion: of 128, where it is 0.26, real ones have 0.37
MOST_STOPS = 1.6  # brighter or darker than the others; 1.2
UNLIKE, UNLIKE_DETAIL = 0.25, 0.28  # of the patch, in one piece; 0.18 and 0.14, with a highlight on metal 0.21. A finger over
# half of it: 0.28 to 0.52, and where its colour is that of the material 0.35 to 0.39
COLOUR, DARKER = 0.3, 1.4  # of a texel that is unlike the others: sum of differences of chromaticity, log of radiance
AGREE, DISAGREE = 0.5, 0.3  # correlation of a texel's detail with the median photo's: of the photos in the median; of this one
SLIGHT_COLOUR, SLIGHT = 0.1, 0.3  # and by how much the texel must be of another colour or brightness besides
EVEN = 0.8  # of evenness (0: falls off as a flash's light does, 1: even); 0.65. Simulated photos without flash: 0.99
SAME_PLACE, SAME_PICTURE = 0.05, 0.02  # patch sides, mean difference of display values; 0.135 and 0.035
SPOILS = ("covered", "blurred", "partly")  # reasons for which positions found with such a photo are not trusted

LOBE = math.radians(7)  # half vectors this close to the upright show a highlight (of roughness 0.35: alpha is tan 7 degrees)
STEP, REACH, SLANT = 0.05, 1.0, math.radians(35)  # where to stand: grid in patch sides, farthest, and most slanted
WORTH = 0.02  # of the patch: less is no reason to stand anywhere


@dataclass(frozen=True)
class Look:
    """Numbers of one photo.

    Args:
        name: of the file.
        overlap: share of the patch it shows.
        clipped: share of its texels with a channel at the limit.
        level: mean display value.
        sharpness: how much detail it has in the direction that has least, relative to the median photo.
        stops: how much brighter than the others it shows the same texels, as powers of two.
        residual: median of the difference of log radiance from the others'.
        unlike: share of the patch, in one piece, that is of a colour or a darkness that no other photo shows.
        unlike_detail: the same, of texels that lack the detail that the others agree on.
        evenness: 0 where light falls off as a flash's, 1 where it is even; None where that was not asked.
    """

    name: str
    overlap: float
    clipped: float
    level: float
    sharpness: float
    stops: float
    residual: float
    unlike: float
    unlike_detail: float
    evenness: float | None = None


def looks(photos: Tensor, views: Views, transfer: color.Transfer, names: Sequence[str],
          overlap: Mapping[str, float] | None = None, evenness: Mapping[str, float] | None = None) -> list[Look]:
    """Numbers of each photo beside the others.

    Args:
        photos: N x R x R x 3 display values in [0, 1], rectified; N >= 3 for the comparison to mean anything.
        views: theirs; a light's place and power need be no better than roughly right.
        transfer: of the photos.
        names: of the files.
        overlap: share of the patch that a photo shows; left out: all of it.
        evenness: see :class:`Look`.
    """
    clipped = (photos >= CLIPPED).any(dim=-1)
    linear = _averaged(color.decode(photos, transfer), SIDE)
    apparent = torch.log((linear.mean(dim=-1) / _irradiance(views, SIDE)).clamp_min(1e-4))
    beside = apparent - apparent.median(dim=0).values
    offset = beside.flatten(1).median(dim=1).values
    beside = beside - offset[:, None, None]
    hue = linear / linear.sum(dim=-1, keepdim=True).clamp_min(1e-3)
    colour = (hue - hue.median(dim=0).values).abs().sum(dim=-1)
    luminance = _averaged(photos, FINE_SIDE).mean(dim=-1).numpy()
    plain = F.interpolate(((beside.abs() < 0.35) & (_averaged(clipped[..., None].float(), SIDE)[..., 0] == 0)).float()[:, None],
                          luminance.shape[1:])[:, 0].bool().numpy()
    sharp, agreement = _sharpness(luminance, plain), _agreement(luminance)
    unlike = (colour > COLOUR) | (beside < -DARKER)
    lost = (agreement < DISAGREE) & (np.median(agreement, axis=0) > AGREE)
    lost &= ((colour > SLIGHT_COLOUR) | (beside.abs() > SLIGHT)).numpy()
    usual = float(offset.median())
    return [Look(name, float((overlap or {}).get(name, 1.0)), float(clipped[i].float().mean()), float(photos[i].mean()),
                 float(sharp[i]), (float(offset[i]) - usual) / math.log(2), float(beside[i].abs().median()),
                 _largest_piece(unlike[i].numpy()), _largest_piece(lost[i]), (evenness or {}).get(name))
            for i, name in enumerate(names)]


def verdicts(found: Sequence[Look], photos: Tensor, views: Views, fired: Mapping[str, str] | None = None) -> dict[str, str]:
    """The reason, by name, of each photo that is better left out.

    Args:
        found: what :func:`looks` gave for these photos and views.
        fired: "fired" or "off" by name, as EXIF says of the flash.
    """
    fired = fired or {}
    some_fired = any(fired.get(look.name) == "fired" for look in found)
    even = [look.name for look in found if (look.evenness or 0) > EVEN]
    reasons, sharp = {}, LEAST_SHARPNESS * min(1, photos.shape[1] / ENOUGH)
    for look in found:
        what = "taken without flash (says its EXIF)" if some_fired and fired.get(look.name) == "off" else _verdict(look, sharp)
        if not what and look.name in even and len(even) < len(found) / 2:  # of most photos, it says that the model is wrong
            what = "taken without flash: its light does not fall off as that of the others does"
        if what:
            reasons[look.name] = what
    small, camera = _averaged(photos, 64), views.in_patch_sides().camera
    for i, look in enumerate(found):
        for j, first in enumerate(found[:i]):
            near = (camera[i] - camera[j]).norm() < SAME_PLACE and (small[i] - small[j]).abs().mean() < SAME_PICTURE
            if near and not {look.name, first.name} & reasons.keys():
                reasons[look.name] = f"the same photo as {first.name}, from the same place"
    return reasons


def _verdict(look: Look, least_sharpness: float) -> str | None:
    if look.overlap < LEAST_OVERLAP:
        return f"partly outside: it shows only {look.overlap:.0%} of the patch"
    if look.clipped > MOST_CLIPPED:
        return f"overexposed: {look.clipped:.0%} of the patch is clipped"
    piece = max(look.unlike, look.unlike_detail)
    if look.unlike > UNLIKE or look.unlike_detail > UNLIKE_DETAIL:
        return f"covered: {piece:.0%} of the patch is nothing like in the other photos, as if a finger or a shadow were on it"
    if abs(look.stops) > MOST_STOPS:
        return f"{abs(look.stops):.1f} stops {'brighter' if look.stops > 0 else 'darker'} than the other photos"
    if look.sharpness < least_sharpness:
        return f"blurred: {look.sharpness:.2f} times as sharp as the others"
    return None


def detail_of(pixels: np.ndarray) -> float:
    """Finest detail of a whole photo (H x W x 3, 8 or 16 bits) over coarser detail, to compare with others of its kind."""
    luminance = pixels.mean(axis=2, dtype=np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    smooth = cv2.GaussianBlur(luminance, (0, 0), 1.5)
    return _rms(luminance - smooth) / max(_rms(smooth - cv2.GaussianBlur(luminance, (0, 0), 6)), 1e-9)


def spoils(reason: str) -> bool:
    """Whether a photo left out for this reason may have misled the search for where all cameras stood."""
    return reason.startswith(SPOILS)


def _irradiance(views: Views, side: int) -> Tensor:
    """Mean radiance of a white diffuse texel in each photo, N x S x S."""
    views, at = views.in_patch_sides(), texel_positions(side)
    ray = views.light.double()[:, None, None] - at
    return (views.intensity.double().mean(dim=1)[:, None, None] * ray[..., 2] / ray.norm(dim=-1) ** 3 / math.pi).float()


def _averaged(images: Tensor, side: int) -> Tensor:
    """N x H x W x C at no more than so many pixels a side, by area averages."""
    side = min(side, images.shape[1])
    return F.adaptive_avg_pool2d(images.permute(0, 3, 1, 2), side).permute(0, 2, 3, 1)


def _sharpness(luminance: np.ndarray, plain: np.ndarray) -> np.ndarray:
    """Detail of N x S x S display values in the direction that has least of it, relative to the median photo, N.

    A hand that moves takes detail away along its way only. Second differences over 4 texels are divided by those over 16 and by
    brightness (their geometric mean: either alone differs more between real photos of a relief), at the ``plain`` texels.
    """
    plain = plain.copy()
    plain[:, :16] = plain[:, -16:] = plain[:, :, :16] = plain[:, :, -16:] = False  # differences reach over the rim
    fine, coarse, level = (np.stack([cv2.GaussianBlur(image, (0, 0), width) for image in luminance]) for width in (1, 3, 24))

    def differences(values: np.ndarray, way: np.ndarray) -> np.ndarray:
        return values - (np.roll(values, way, (1, 2)) + np.roll(values, -way, (1, 2))) / 2

    ratios = np.array([[_rms(f[p]) / math.sqrt(_rms(c[p]) * _rms(b[p]) or math.nan) if p.any() else math.nan for f, c, b, p in
                        zip(differences(fine, 4 * way), differences(coarse, 16 * way), level, plain)]
                       for way in np.array([(0, 1), (1, 0), (1, 1), (1, -1)])])
    if not np.isfinite(ratios).any():
        return np.ones(len(luminance))
    return np.nan_to_num((ratios / np.nanmedian(ratios, axis=1, keepdims=True)).min(axis=0), nan=1.0)


def _agreement(luminance: np.ndarray) -> np.ndarray:
    """How the detail of the logarithm of N x S x S display values correlates with the median photo's, N x SIDE x SIDE."""
    logs = [np.log(np.maximum(image, 0.02)) for image in luminance]
    band = np.stack([cv2.GaussianBlur(image, (0, 0), 1.5) - cv2.GaussianBlur(image, (0, 0), 8) for image in logs])
    usual = np.median(band, axis=0)
    window = max(9, luminance.shape[1] // 10 | 1)

    def around(product: np.ndarray) -> np.ndarray:
        mean = cv2.blur(product, (window, window))
        return cv2.resize(mean, (min(SIDE, mean.shape[1]),) * 2, interpolation=cv2.INTER_AREA)

    return np.stack([around(b * usual) / np.sqrt(around(b * b) * around(usual * usual) + 1e-12) for b in band])


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.square(values).mean()))


def _largest_piece(mask: np.ndarray) -> float:
    """The largest connected part of a mask as a share of it all."""
    sizes = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)[2][1:, cv2.CC_STAT_AREA]
    return float(sizes.max() / mask.size) if len(sizes) else 0.0


@dataclass(frozen=True)
class Stand:
    """A place to take one more photo from.

    Args:
        camera: x, y, z in the unit of the views.
        gain: share of the patch that it would be the first to show a highlight of.
        near: number of the photo that was taken closest to it.
        words: what to do, for a person.
    """

    camera: tuple[float, float, float]
    gain: float
    near: int
    words: str


def where_to_stand(views: Views, names: Sequence[str], unit: str, lobe: float = LOBE) -> Stand | None:
    """The place at the usual height from which one more photo shows most highlights that no photo has; None: hardly any left.

    Args:
        views: of the photos there are.
        names: of their files.
        unit: ``cm`` or ``patch sides``.
        lobe: angle (rad) between half vector and upright up to which a highlight counts as seen.
    """
    side, size = 32, views.size
    sides = views.in_patch_sides().to(torch.float64)
    unseen = coverage_angle(sides, side) > lobe
    height, beside = float(sides.camera[:, 2].median()), (sides.light - sides.camera).mean(dim=0)
    far = min(REACH, height * math.tan(SLANT))
    steps = torch.arange(-round(far / STEP), round(far / STEP) + 1, dtype=torch.float64) * STEP
    places = torch.cartesian_prod(steps, steps)
    places = torch.cat((places, torch.full((len(places), 1), height, dtype=torch.float64)), dim=1)[places.norm(dim=1) <= far]
    tried = replace(sides, camera=places, light=places + beside, intensity=sides.intensity[:1].expand(len(places), 3))
    new = [unseen & (coverage_angle(tried.pick([i]), side) <= lobe) for i in range(len(places))]
    gains = torch.stack([shown.double().mean() for shown in new])
    # Of places that show as much, the one closest to the middle: the least slanted view.
    best = int((gains - 1e-3 * places[:, :2].norm(dim=1)).argmax())
    if gains[best] < WORTH:
        return None
    near = int((sides.camera - places[best]).norm(dim=1).argmin())
    way = (places[best] - sides.camera[near]).tolist()
    at = places[best] * size
    return Stand(tuple(at.tolist()), float(gains[best]), near, _words(way, height, names[near], unit, size))


def _words(way: Sequence[float], height: float, name: str, unit: str, size: float) -> str:
    def length(x: float) -> str:
        return f"{abs(x) * size:.0f} cm" if unit == "cm" else f"{abs(x):.0%} of the patch's side"

    least = (*[0.5 / size if unit == "cm" else 0.03] * 2, 0.1 * height)
    ways = ("further left", "further right"), ("nearer to you", "further away from you"), ("lower", "higher")
    moves = [f"{length(x)} {a if x < 0 else b}" for x, (a, b), enough in zip(way, ways, least) if abs(x) >= enough]
    above = length(height) if unit == "cm" else f"{height:.1f} patch sides"
    if abs(way[2]) < least[2]:
        moves.append(f"at the same height ({above})")
    upright = "; the sheet's arrow points away from you" if unit == "cm" else ""  # else the photos say what is up
    return f"from where {name} was taken, hold the phone {', '.join(moves)}{upright}"
