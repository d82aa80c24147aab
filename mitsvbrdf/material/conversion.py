"""Convert ``roughconductor`` maps to ``principled`` maps, which hold less information.

Base colour b and metallic m are four numbers. Diffuse b (1 - m) and F0 = b m + 0.04 (1 - m) are six. The
inverse is :meth:`mitsvbrdf.material.maps.SVBRDF.as_roughconductor`.
"""

import torch
from torch import Tensor

from .maps import DIELECTRIC_F0, SVBRDF

# Between the highest F0 of a non-metal (diamond, 0.17) and the lowest of a metal (0.4 and more in the
# strongest channel).
METAL_F0 = 0.25
DIELECTRICS = 0.02, 0.17  # F0 of water and of diamond
FULL_LEVEL = 0.08  # F0 of specular level 1, in Blender, Unreal and Substance; level 0.5 has 0.04
METAL_DIFFUSE = 0.25  # largest ratio diffuse / F0 of a metal: bare metal has 0, fitted maps a little more


def is_metal(svbrdf: SVBRDF) -> Tensor:
    """Whether each texel is clearly a metal, R x R x 1. F0 alone does not show it: paper reaches 0.3."""
    maps = svbrdf.as_roughconductor()
    f0, diffuse = (maps[name].amax(dim=-1, keepdim=True) for name in ("specular", "diffuse"))
    return (f0 > METAL_F0) & (diffuse < METAL_DIFFUSE * f0)


def as_principled(svbrdf: SVBRDF) -> SVBRDF:
    """Convert to base colour (F0 of metals, else diffuse) and metallic (0 or 1); keep ``principled`` maps.

    If a metallic between 0 and 1 were fitted to both maps, a red card of F0 0.1 would become 75 % metal. The
    card's colour would then be in the highlight, and the card black under oblique light. The conversion loses
    the F0 of non-metals, which becomes 0.04, and the diffuse light of metals.
    """
    if svbrdf.bsdf == "principled":
        return svbrdf
    metal = is_metal(svbrdf)
    return SVBRDF("principled", {"base_color": torch.where(metal, svbrdf["specular"], svbrdf["diffuse"]),
                                 "metallic": metal.to(svbrdf["diffuse"].dtype),
                                 "roughness": svbrdf["roughness"], "normal": svbrdf["normal"]})


def layered(svbrdf: SVBRDF, f0: Tensor) -> SVBRDF:
    """Base colour and metallic for programs that scale the diffuse light by 1 - F0.

    The base colour of a non-metal is its diffuse colour over 1 - F0, so that the diffuse light seen from
    above stays the same. ``f0`` (broadcast to R x R x 1) is the program's F0 of non-metals. Base colours
    above 1 are clamped: these texels reflect more light than arrives.
    """
    material = as_principled(svbrdf)
    base = (svbrdf["diffuse"] / (1 - f0).clamp_min(1e-6)).clamp_max(1.0)
    return SVBRDF("principled", dict(material.maps) | {
        "base_color": torch.where(material["metallic"] > 0, material["base_color"], base)})


def usual_f0(svbrdf: SVBRDF) -> float:
    """One F0 for all non-metals, for formats without an F0 map: their median, within :data:`DIELECTRICS`."""
    others = svbrdf["specular"].mean(dim=-1)[~is_metal(svbrdf)[..., 0]]
    return float(others.median().clamp(*DIELECTRICS)) if len(others) else DIELECTRIC_F0


def relative_f0(svbrdf: SVBRDF, level: float) -> Tensor:
    """F0 divided by ``level``, the one F0 that a program uses for all texels, R x R x 3; 1 at metals."""
    return torch.where(is_metal(svbrdf), 1.0, svbrdf["specular"] / level)


def as_shown(material: SVBRDF, f0: Tensor, taken: Tensor) -> SVBRDF:
    """The inverse of :func:`layered`: what such a program shows of a ``principled`` material from above.

    ``f0`` is the F0 of non-metals, ``taken`` the share of diffuse light that is lost to the highlight.
    """
    base, metallic = material["base_color"], material["metallic"]
    return SVBRDF("roughconductor", {"diffuse": base * (1 - metallic) * (1 - taken),
                                     "specular": base * metallic + f0.clamp_max(1.0) * (1 - metallic),
                                     "roughness": material["roughness"], "normal": material["normal"]})
