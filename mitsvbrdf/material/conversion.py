"""The maps of one BSDF as those of the other: base colour and metallic cannot say all that diffuse and specular can.

A metal/rough material has diffuse b (1 - m) and F0 = b m + 0.04 (1 - m): four numbers for six. The way back is
:meth:`mitsvbrdf.material.maps.SVBRDF.as_roughconductor`.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from .maps import DIELECTRIC_F0, SVBRDF

COARSE, REFINEMENTS = 16, 24  # intervals of metallic looked at first; halvings of golden section: m to 1e-6
GOLDEN = (math.sqrt(5) - 1) / 2


def as_principled(svbrdf: SVBRDF) -> SVBRDF:
    """Base colour and metallic nearest to the diffuse and specular maps; a principled material as it is.

    Of each texel the m in [0, 1] is searched that leaves the least sum of squares |b (1 - m) - diffuse|^2 +
    |b m + 0.04 (1 - m) - specular|^2 (linear), b in [0, 1] being the least-squares answer for that m. Of equal answers
    the less metallic one is taken.

    Returns:
        A ``principled`` material of the same dtype and normals.
    """
    if svbrdf.bsdf == "principled":
        return svbrdf
    diffuse, specular = svbrdf["diffuse"].double(), svbrdf["specular"].double()
    metallic = _search(diffuse, specular)
    kind = svbrdf["diffuse"].dtype
    return SVBRDF("principled", {"base_color": _base_color(metallic, diffuse, specular).to(kind), "metallic": metallic.to(kind),
                                 "roughness": svbrdf["roughness"], "normal": svbrdf["normal"]})


def with_specular_color(svbrdf: SVBRDF, converted: SVBRDF) -> tuple[SVBRDF, Tensor]:
    """The converted material beside a factor on its dielectric F0 of 0.04, so that F0 is that of the original.

    The factor c = (specular - b m) / (0.04 (1 - m)) adds what metallic leaves out, and cannot take away: b is lowered to
    specular / m where it is higher. c is in [0, 25], so that 0.04 c reaches from 0 to 1; of a metal (m = 1) it is 1.

    Returns:
        The material, and c: R x R x 3, linear. F0 = b m + 0.04 (1 - m) c.
    """
    metallic, specular = converted["metallic"], svbrdf.as_roughconductor()["specular"]
    base = torch.where(metallic > 0, specular / metallic.clamp_min(1e-12), 1.0).minimum(converted["base_color"])
    glass = DIELECTRIC_F0 * (1 - metallic)
    factor = torch.where(glass > 0, (specular - base * metallic) / glass.clamp_min(1e-12), 1.0)
    return SVBRDF("principled", dict(converted.maps) | {"base_color": base}), factor.clamp(0.0, 1 / DIELECTRIC_F0)


def _base_color(metallic: Tensor, diffuse: Tensor, specular: Tensor) -> Tensor:
    glass = 1 - metallic
    fitted = (glass * diffuse + metallic * (specular - DIELECTRIC_F0 * glass)) / (glass**2 + metallic**2)
    return fitted.clamp(0.0, 1.0)


def _cost(metallic: Tensor, diffuse: Tensor, specular: Tensor) -> Tensor:
    base, glass = _base_color(metallic, diffuse, specular), 1 - metallic
    errors = (base * glass - diffuse).square() + (base * metallic + DIELECTRIC_F0 * glass - specular).square()
    return errors.sum(dim=-1, keepdim=True)


def _search(diffuse: Tensor, specular: Tensor) -> Tensor:
    """The metallic of least cost, R x R x 1: the best of 17 values, then golden section around it."""
    best = torch.zeros_like(diffuse[..., :1])
    least = _cost(best, diffuse, specular)

    def offer(metallic: Tensor) -> None:
        nonlocal best, least
        cost = _cost(metallic, diffuse, specular)
        best, least = torch.where(cost < least, metallic, best), torch.minimum(cost, least)

    for step in range(1, COARSE + 1):
        offer(torch.full_like(best, step / COARSE))
    low, high = (best - 1 / COARSE).clamp_min(0), (best + 1 / COARSE).clamp_max(1)
    for _ in range(REFINEMENTS):
        width = GOLDEN * (high - low)
        left, right = high - width, low + width
        lower = _cost(left, diffuse, specular) < _cost(right, diffuse, specular)
        low, high = torch.where(lower, low, left), torch.where(lower, right, high)
    offer((low + high) / 2)
    return best
