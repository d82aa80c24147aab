"""A normal map guessed from shading (after Glencross et al. 2008; named in IV.C against normals that are too
flat).

Dark is deep. Each octave of the shading is read as pits and hills as wide as the octave: under light from all
sides a pit of depth D, in units of its radius, sees 1 / (1 + D^2) of it. The surface around stands at the rim
of a pit as deep as wide (D = 1, half of the light), so that hills are read off the same curve.

Shading is how light the guessed diffuse map is. Glencross et al. divide the photo without flash by an albedo
from that with it; here all photos have a flash, and what darkens a texel in all of them is in the guess.
Slopes found so have a cosine of 0.5 to 0.7 with the true ones on five of six known materials (-0.4 on a
metal); of the mean photo over the guess -0.6 to 0.07. How steep the octaves are, and whether dark is deep,
the photos say, in one number (ours).
"""

from __future__ import annotations

import math
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor

from ...capture import Capture
from ...capture.guess import over
from ...color import NEARLY_CLIPPED
from ...views import geometry

FLOOR = 0.02  # of albedos, below which a quotient says nothing
RATIO = (0.05, 1.95)  # of shading to that around it; the curve ends at 0 and 2
BRIGHTEST = 1.1  # times a texel's median: what is brighter may be a highlight
# A gloss brightens texels that face the light as well. Normal RMSE of flat normals, with the factor found,
# and with half of it, on six known materials at 64 px: brick-uneven-stones .119 .081 .090, fake-022 .034 .088
# .046, fake-030 .045 .044 .039, metal-plating .043 .048 .040, rotten-wood-boards .103 .083 .088,
# synthetic-foam .062 .066 .048.
TRUST = 0.5


def guess_normal(capture: Capture, guess: Tensor) -> Tensor:
    """Unit normals R x R x 3 guessed from the photos.

    Args:
        capture: photos and views.
        guess: guessed diffuse map, R x R x 3 linear.
    """
    slopes = -gradient(height_of(guess.mean(dim=2).clamp_min(FLOOR)))
    return from_slopes(TRUST * strength(capture, slopes) * slopes)


def height_of(shade: Tensor) -> Tensor:
    """Height R x R in texels, of shading R x R; octaves from two texels to a quarter of the map."""
    count = max(1, int(math.log2(shade.shape[0] / 4)))
    layers = [shade, *(blurred(shade, 2.0 ** k) for k in range(count))]
    height = torch.zeros_like(shade)
    for number, (fine, coarse) in enumerate(pairwise(layers)):
        ratio = (fine / coarse.clamp_min(1e-6)).clamp(*RATIO)
        height = height - 2.0 ** number * ((2 / ratio - 1).sqrt() - 1)
    return height


def blurred(image: Tensor, sigma: float) -> Tensor:
    """R x R under a Gaussian of ``sigma`` texels that repeats the border."""
    reach = math.ceil(3 * sigma)
    kernel = torch.exp(-0.5 * (torch.arange(-reach, reach + 1, dtype=image.dtype) / sigma) ** 2)
    kernel = (kernel / kernel.sum())[None, None, None]
    grown = F.pad(image[None, None], (reach,) * 4, mode="replicate")
    return F.conv2d(F.conv2d(grown, kernel), kernel.mT)[0, 0]


def gradient(height: Tensor) -> Tensor:
    """Slopes of a height map in texels towards +x and +y (up), R x R x 2, by central differences."""
    down, right = torch.gradient(height)
    return torch.stack((right, -down), dim=-1)


def from_slopes(slopes: Tensor) -> Tensor:
    """Unit normals R x R x 3 from n_x / n_z and n_y / n_z."""
    return F.normalize(torch.cat((slopes, torch.ones_like(slopes[..., :1])), dim=-1), dim=-1)


def strength(capture: Capture, slopes: Tensor) -> float:
    """The factor that lets slopes n_x / n_z, n_y / n_z explain how each texel differs between photos.

    A Lambertian of small slopes s differs from a flat one by the factor 1 + s . l_xy / l_z. The albedo, one a
    texel, is eliminated; pixels that may be in a highlight are left out.
    """
    light, _, irradiance = geometry(capture.views, capture.resolution)
    seen = over(math.pi * capture.linear, irradiance).mean(dim=3)
    middle = seen.median(dim=0).values.clamp_min(FLOOR)
    ratio = seen / middle
    usable = ((ratio < BRIGHTEST) & (capture.photos < NEARLY_CLIPPED).all(dim=3)).float()
    expected = (slopes * light[..., :2] / light[..., 2:]).sum(dim=-1)
    count = usable.sum(dim=0).clamp_min(1)
    own, told = (x - (usable * x).sum(dim=0) / count for x in (ratio, expected))
    return float((usable * own * told).sum() / (usable * told.square()).sum().clamp_min(1e-12))
