"""The light power that the maps tell: with it, highlights are those of usual materials.

Light of twice the power on a material of half the diffuse and specular albedo makes the same photos (except
for the Fresnel curve beside the lens). Nearly all materials but metals have an F0 near 0.04
(:data:`~mitsvbrdf.material.maps.DIELECTRIC_F0`). A fit knows F0 at every texel that showed its highlight; one
lobe for all texels could only guess it.
"""

from collections.abc import Mapping

import numpy as np
from torch import Tensor

from ..material.maps import DIELECTRIC_F0, SVBRDF, WHITEST
from .confidence import DETERMINED, of_texels

METAL = 0.2  # F0 from which on a texel is no dielectric
TELLING = 0.5  # least share of the texels that must tell the power


def light_power_told(svbrdf: SVBRDF, deviations: Mapping[str, Tensor], shown: Tensor) -> float | None:
    """The factor by which to multiply the light power and divide the maps; None where too few texels tell.

    ``shown``: the texels that some photo shows, r x r. ``principled`` fixes F0, so it tells nothing.
    """
    if svbrdf.bsdf != "roughconductor" or not {"diffuse", "specular"} <= set(deviations):
        return None
    sure = of_texels(deviations["specular"])
    level = svbrdf.resized(sure.shape[0])["specular"].mean(dim=-1)
    told = shown & (sure < DETERMINED) & (level > 0) & (level < METAL)  # a texel without a lobe tells nothing
    if float(told[shown].float().mean()) < TELLING:
        return None
    factor = float(level[told].median()) / DIELECTRIC_F0
    white = float(np.quantile(svbrdf["diffuse"].amax(dim=-1).numpy(), 0.99)) / WHITEST
    return max(factor, min(white, 1.0))  # weaker light does not make the diffuse map whiter than WHITEST


def with_light_power(svbrdf: SVBRDF, factor: float) -> SVBRDF:
    """Maps that reflect as much under a light that is ``factor`` times as strong."""
    return SVBRDF(svbrdf.bsdf, {name: (value / factor).clamp(0, 1) if name in ("diffuse", "specular")
                                else value for name, value in svbrdf.maps.items()})
