"""The light power estimated from the maps: with it, the median F0 is that of usual materials.

Light of twice the power on a material of half the diffuse and specular albedo makes the same photos (except
for the Fresnel effect of a flash beside the lens). Nearly all materials but metals have an F0 near 0.04
(:data:`~mitsvbrdf.material.maps.DIELECTRIC_F0`). A fit determines F0, up to the light power, at each texel
whose highlight a photo shows; one lobe for all texels could only guess it.
"""

from collections.abc import Mapping

import numpy as np
from torch import Tensor

from ..material.maps import DIELECTRIC_F0, SVBRDF, WHITEST
from .confidence import DETERMINED, of_texels

METAL = 0.2  # F0 from which a texel counts as metal
TELLING = 0.5  # least share of the shown texels that must be determined dielectrics


def light_power_told(svbrdf: SVBRDF, deviations: Mapping[str, Tensor], shown: Tensor) -> float | None:
    """The factor that multiplies the light power and divides the maps; None if too few texels determine it.

    ``shown``: mask of the texels that some photo shows, r x r. ``principled`` has a fixed F0: None.
    """
    if svbrdf.bsdf != "roughconductor" or not {"diffuse", "specular"} <= set(deviations):
        return None
    sure = of_texels(deviations["specular"])
    level = svbrdf.resized(sure.shape[0])["specular"].mean(dim=-1)
    told = shown & (sure < DETERMINED) & (level > 0) & (level < METAL)  # level 0: no lobe
    if float(told[shown].float().mean()) < TELLING:
        return None
    factor = float(level[told].median()) / DIELECTRIC_F0
    white = float(np.quantile(svbrdf["diffuse"].amax(dim=-1).numpy(), 0.99)) / WHITEST
    return max(factor, min(white, 1.0))  # weaker light must not make the diffuse map whiter than WHITEST


def with_light_power(svbrdf: SVBRDF, factor: float) -> SVBRDF:
    """The maps that give the same photos under a light ``factor`` times as strong."""
    return SVBRDF(svbrdf.bsdf, {name: (value / factor).clamp(0, 1) if name in ("diffuse", "specular")
                                else value for name, value in svbrdf.maps.items()})
