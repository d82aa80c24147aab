"""How good each photo is: clipped, dark, blurred, or unlike the others.

Photos are compared in what they should agree on: the apparent albedo of a texel, its radiance over its
irradiance. The median of the photos shows neither a highlight nor a finger.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ... import color
from ...color import NEARLY_CLIPPED
from ...material.resample import resized
from ...views import Views, geometry

# most texels a side, to compare radiance and to compare detail
RADIANCE_SIDE, DETAIL_SIDE = 32, 512
# a texel is unlike the others if it exceeds one: summed difference of chromaticity, log of how much darker
COLOUR, DARKER = 0.3, 1.4
# correlation of detail with the median photo: above AGREE in most photos, below DISAGREE if detail is lost
AGREE, DISAGREE = 0.5, 0.3
SLIGHT_COLOUR, SLIGHT = 0.1, 0.3  # a texel with lost detail must also differ in colour or brightness


@dataclass(frozen=True)
class PhotoQuality:
    """Measures of one photo's quality."""

    name: str  # of the file
    overlap: float  # share of the patch within the photo, masked or not
    clipped: float  # share of its texels with a clipped channel
    sharpness: float  # detail over the median photo's, in the direction with the least
    stops: float  # how much brighter its texels are than in the other photos, in powers of two
    unlike: float  # largest piece (share of the patch) unlike the median photo in colour or darkness
    unlike_detail: float  # largest piece (share of the patch) without the detail of the others
    evenness: float | None = None  # 0: light falls off as a flash's, 1: it is even; None: not measured
    masked: float = 0.0  # share of the patch masked or outside; other shares, except overlap, are of the rest


def photo_qualities(photos: Tensor, views: Views, transfer: color.Transfer, overlap: Mapping[str, float],
                    evenness: Mapping[str, float] | None = None, measured: Tensor | None = None,
                    log_exposure: Mapping[str, float] | None = None) -> list[PhotoQuality]:
    """The quality of each photo, compared with the others.

    Args:
        photos: N x R x R x 3 display values in [0, 1], rectified; a comparison needs N >= 3.
        views: views of the photos; positions and powers of lights need only be roughly right.
        overlap: name to overlap (:class:`PhotoQuality`), in the order of photos. ``evenness``: likewise.
            ``log_exposure``: name to natural logarithm of the exposure, which the powers of lights include.
        measured: N x R x R, False where photos were filled in; None: nowhere.
    """
    shows = torch.ones_like(photos[..., 0], dtype=torch.bool) if measured is None else measured
    side = min(RADIANCE_SIDE, photos.shape[1])
    hidden = resized((~shows)[..., None].float(), side) > 0
    irradiance = geometry(views, side)[-1].mean(dim=-1) / math.pi  # of white
    linear, clipped = color.decode(photos, transfer), shows & (photos >= NEARLY_CLIPPED).any(dim=-1)
    linear = resized(linear, side).masked_fill(hidden, torch.nan)
    luminance = resized(photos, min(DETAIL_SIDE, photos.shape[1])).mean(dim=-1).numpy()
    unclipped = resized(clipped[..., None].float(), side)[..., 0] == 0
    apparent = torch.log((linear.mean(dim=-1) / irradiance).clamp_min(1e-4))
    beside = apparent - apparent.nanmedian(dim=0).values
    offset = beside.flatten(1).nanmedian(dim=1).values
    beside = beside - offset[:, None, None]
    hue = linear / linear.sum(dim=-1, keepdim=True).clamp_min(1e-3)
    colour = (hue - hue.nanmedian(dim=0).values).abs().sum(dim=-1)
    plain = F.interpolate(((beside.abs() < 0.35) & unclipped).float()[:, None],
                          luminance.shape[1:])[:, 0].bool().numpy()
    sharp, agreement = _sharpness(luminance, plain), _agreement(luminance)
    unlike = (colour > COLOUR) | (beside < -DARKER)
    lost = (agreement < DISAGREE) & (np.median(agreement, axis=0) > AGREE)
    lost &= ((colour > SLIGHT_COLOUR) | (beside.abs() > SLIGHT)).numpy()
    offset = offset + torch.tensor([(log_exposure or {}).get(name, 0.0) for name in overlap])
    usual = float(offset.nanmedian())
    share = shows.float().mean(dim=(1, 2)).tolist()
    within = [max(each, 1e-9) for each in share]  # pieces and clipped texels are shares of what a photo shows
    return [PhotoQuality(name, float(shown), clipped=float(clipped[i].float().mean()) / within[i],
                         sharpness=float(sharp[i]), stops=(float(offset[i]) - usual) / math.log(2),
                         unlike=_largest_piece(unlike[i].numpy()) / within[i],
                         unlike_detail=_largest_piece(lost[i]) / within[i], masked=1 - share[i],
                         evenness=(evenness or {}).get(name))
            for i, (name, shown) in enumerate(overlap.items())]


def _sharpness(luminance: np.ndarray, plain: np.ndarray) -> np.ndarray:
    """Detail of N photos (N x S x S display values) over the median photo's, in the direction with the least.

    A moving hand removes detail only along its path. At the ``plain`` texels, second differences over 4
    texels are divided by the geometric mean of those over 16 and of brightness (either alone differs more
    between real photos of a relief).
    """
    plain = plain.copy()
    # at the rim, differences would wrap around
    plain[:, :16] = plain[:, -16:] = plain[:, :, :16] = plain[:, :, -16:] = False
    fine, coarse, level = (np.stack([cv2.GaussianBlur(image, (0, 0), width) for image in luminance])
                           for width in (1, 3, 24))

    def differences(values: np.ndarray, way: np.ndarray) -> np.ndarray:
        return values - (np.roll(values, way, (1, 2)) + np.roll(values, -way, (1, 2))) / 2

    ratios = np.array([[_rms(f[p]) / math.sqrt(_rms(c[p]) * _rms(b[p]) or math.nan) if p.any() else math.nan
                        for f, c, b, p in zip(differences(fine, 4 * way), differences(coarse, 16 * way),
                                              level, plain)]
                       for way in np.array([(0, 1), (1, 0), (1, 1), (1, -1)])])
    if not np.isfinite(ratios).any():
        return np.ones(len(luminance))
    return np.nan_to_num((ratios / np.nanmedian(ratios, axis=1, keepdims=True)).min(axis=0), nan=1.0)


def detail_of(pixels: np.ndarray) -> float:
    """Ratio of the finest to the coarser detail of a whole photo (H x W x 3, 8 or 16 bits)."""
    luminance = pixels.mean(axis=2, dtype=np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    smooth = cv2.GaussianBlur(luminance, (0, 0), 1.5)
    return _rms(luminance - smooth) / max(_rms(smooth - cv2.GaussianBlur(luminance, (0, 0), 6)), 1e-9)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.square(values).mean()))


def _agreement(luminance: np.ndarray) -> np.ndarray:
    """Correlation of the detail of N x S x S display values with the median photo's, N x T x T (T <= 32)."""
    logs = [np.log(np.maximum(image, 0.02)) for image in luminance]
    band = np.stack([cv2.GaussianBlur(image, (0, 0), 1.5) - cv2.GaussianBlur(image, (0, 0), 8)
                     for image in logs])
    usual = np.median(band, axis=0)
    window = max(9, luminance.shape[1] // 10 | 1)

    def around(product: np.ndarray) -> np.ndarray:
        mean = cv2.blur(product, (window, window))
        return cv2.resize(mean, (min(RADIANCE_SIDE, mean.shape[1]),) * 2, interpolation=cv2.INTER_AREA)

    return np.stack([around(b * usual) / np.sqrt(around(b * b) * around(usual * usual) + 1e-12)
                     for b in band])


def _largest_piece(mask: np.ndarray) -> float:
    """The largest connected part of a mask as a share of all its texels."""
    sizes = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)[2][1:, cv2.CC_STAT_AREA]
    return float(sizes.max() / mask.size) if len(sizes) else 0.0
