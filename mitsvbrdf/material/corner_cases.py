"""The materials of a cross-check (made by code, corner cases, random), and the text on their conversion."""

import torch
import torch.nn.functional as F
from torch import Tensor

from ..io.entry import entry
from ..views import texel_positions
from .made import MATERIALS, make_material
from .maps import CHANNELS, SVBRDF, Bsdf, flat

# How maps are converted to each BSDF: text for outputs.
CONVERSION: dict[str, str] = {
    "roughconductor": "diffuse = base_color (1 - metallic), specular = base_color metallic + 0.04 (1 - "
                      "metallic)",
    "principled": "metallic = 1 and base_color = specular at clear metals; elsewhere metallic = 0, "
                  "base_color = diffuse, and F0 becomes 0.04",
}


@entry()
def builtin_materials(resolution: int = 128) -> dict[str, SVBRDF]:
    """The made materials (:mod:`mitsvbrdf.material.made`) and :func:`corner_materials`: name to material."""
    return {name: make_material(name, resolution) for name in MATERIALS} | corner_materials(resolution)


@entry()
def corner_materials(resolution: int = 128) -> dict[str, SVBRDF]:
    """Materials with values at the ends of their ranges: name to ``roughconductor`` maps, float32.

    ``polished`` has roughness 0.02 to 0.1. There, no tolerance is stated; ``principled`` clamps below 0.032.
    """
    waves = _waves(resolution, 8.5)
    return {
        "flat": flat(resolution),
        "roughness 0.1": _material(waves, roughness=0.1),
        "polished": _material(waves, roughness=_ramp(resolution, 0.02, 0.1)),
        "black diffuse": _material(waves, diffuse=0.0, roughness=0.3),
        "white": _material(waves, diffuse=1.0, specular=1.0, roughness=1.0),
        "coloured F0": _material(waves, diffuse=0.02, specular=(1.0, 0.6, 0.0),
                                 roughness=_ramp(resolution, 0.2, 0.8)),
        "steep normals": _material(_waves(resolution, 65.0), roughness=0.4),
    }


def _material(normal: Tensor, **values: float | tuple[float, ...] | Tensor) -> SVBRDF:
    start = flat(normal.shape[0])
    maps = {name: torch.as_tensor(value, dtype=torch.float32).expand_as(start[name]).clone()
            for name, value in values.items()}
    return SVBRDF("roughconductor", {**start.maps, "normal": normal, **maps})


def _waves(resolution: int, degrees: float) -> Tensor:
    """Normals of crossed waves, 3 along x and 4 along y, tilted by up to ``degrees`` on either axis."""
    x, y, _ = texel_positions(resolution).unbind(-1)
    steep = torch.tan(torch.deg2rad(torch.tensor(degrees, dtype=torch.float64)))
    normal = torch.stack((steep * torch.sin(6 * torch.pi * x), steep * torch.sin(8 * torch.pi * y + 1),
                          torch.ones_like(x)), -1)
    return F.normalize(normal, dim=-1).float()


def _ramp(resolution: int, low: float, high: float) -> Tensor:
    """A ramp from ``low`` at the left edge to ``high`` at the right, R x R x 1."""
    return low + (high - low) * (texel_positions(resolution)[..., :1] + 0.5)


@entry()
def random_material(bsdf: Bsdf, resolution: int = 48, seed: int = 0, slope: float = 0.15) -> SVBRDF:
    """Random maps R x R x C, float32: roughness 0.15 to 0.95, slopes of standard deviation ``slope``."""
    g = torch.Generator().manual_seed(seed)
    maps = {name: torch.rand(resolution, resolution, channels, generator=g)
            for name, channels in CHANNELS[bsdf].items()}
    slopes = slope * torch.randn(resolution, resolution, 2, generator=g)
    maps["normal"] = F.normalize(torch.cat((slopes, torch.ones(resolution, resolution, 1)), -1), dim=-1)
    maps["roughness"] = 0.15 + 0.8 * maps["roughness"]
    return SVBRDF(bsdf, maps)
