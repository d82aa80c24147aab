"""How much of a map is where the highlights were: burn-in, measured without ground truth.

The coverage angle of a texel is the smallest angle, over the photos a fit used, between the flat normal (0, 0, 1) and the half
vector there. Where it is small a photo showed the texel's highlight, where it is large none did. A material knows nothing of
where the camera stood, so its maps should not follow that angle; a fit that hides highlights in its maps, or falls back to its
start where it has no evidence, makes maps that do. Burn-in is the share R^2 of a map's variance that a cubic in the coverage
angle explains: 0 for maps that do not follow it (3 / (n - 1) on average for n texels of pure noise), 1 for maps that are
nothing else. A material whose own pattern lies like the highlights has some, too.

Measured at 128 px on the roughness that MaterialGAN published: `wood-bamboo` 0.67, `cards-blue` and `bathroomtile1` 0.01. Fine
texture counts as variance, so the share falls a little with the resolution (`wood-bamboo` 0.69 at 64 px, 0.63 at 256 px).
"""

from __future__ import annotations

import torch
from torch import Tensor

from .. import color
from ..material.maps import SVBRDF
from ..views import Views, coverage_angle, cubic

CONSTANT_BELOW = 1e-6  # a map whose deviation is below this share of its size is constant: float32 and the encoding leave 1e-7


def burn_in(svbrdf: SVBRDF, views: Views) -> dict[str, float]:
    """Share of the variance of the ``specular`` and ``roughness`` maps that the coverage angle explains, each 0 to 1.

    Args:
        svbrdf: the material, at the resolution at which it is looked at; a principled one by its specular map.
        views: those of the photos that the fit used.
    """
    angle = coverage_angle(views, svbrdf.resolution)
    maps = svbrdf.detach().to(torch.float64).as_roughconductor()
    looks = {"specular": color.encode(maps["specular"]).mean(dim=-1), "roughness": maps["roughness"][..., 0]}
    return {name: explained_share(value, angle) for name, value in looks.items()}


def explained_share(values: Tensor, angle: Tensor) -> float:
    """R^2 of the least-squares cubic in ``angle`` through ``values``, tensors of one shape; 0 where the values are constant."""
    y, x = values.double().flatten(), angle.double().flatten()
    y, x, size = y - y.mean(), x - x.mean(), y.square().mean().sqrt()
    if y.square().mean().sqrt() <= CONSTANT_BELOW * size:
        return 0.0
    return float((1 - (y - cubic(x, y[None])[0]).square().sum() / y.square().sum()).clamp(0, 1))
