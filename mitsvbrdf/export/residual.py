"""The error of a conversion: RMSE of the maps, and of pictures under three lights."""

import math

import torch
from torch import Tensor

from ..color import to_display
from ..material.conversion import as_shown
from ..material.maps import DIELECTRIC_F0, SVBRDF
from ..measure.metrics import map_rmse, photo_rmse
from ..render.analytic import AnalyticRenderer
from ..views import Views

HEIGHT = 2.0  # of the camera, above the centre, in patch sides
LIGHTS = {"at the camera": (0.0, 0.0, HEIGHT), "beside it": (0.8, 0.3, HEIGHT), "oblique": (1.5, 0.0, 0.6)}
TEXELS = 1024  # a side; of maps at least twice as large, only every k-th texel is compared
SIDE = 256  # pixels of the pictures, at most
GLASS = torch.tensor(DIELECTRIC_F0)
IRRADIANCE = math.pi / 2  # at the centre: white paper then has radiance 0.5; display value 1 is radiance 1


def three_lights() -> Views:
    """Three views: the camera above, one light each, the same irradiance at the patch's centre."""
    light = torch.tensor(list(LIGHTS.values()), dtype=torch.float64)
    distance2 = light.square().sum(dim=1)
    power = IRRADIANCE * distance2 * distance2.sqrt() / light[:, 2]
    return Views.of(torch.tensor([[0.0, 0.0, HEIGHT]] * len(LIGHTS)), light, power[:, None].expand(-1, 3))


def residual(svbrdf: SVBRDF, converted: SVBRDF) -> dict[str, float]:
    """A dict of RMSE: converted maps (linear^(1/2.2)), and pictures under each of :data:`LIGHTS` (sRGB)."""
    errors = map_rmse(converted, svbrdf)
    renderer, views, side = AnalyticRenderer(), three_lights(), min(SIDE, svbrdf.resolution)
    wanted, shown = (renderer.render(each.as_roughconductor().to(torch.float32).resized(side), views)
                     for each in (svbrdf, converted))
    _, pictures = photo_rmse(shown, to_display(wanted, "srgb"), "srgb")
    return {name: errors[name] for name in ("diffuse", "specular")} | dict(zip(LIGHTS, pictures))


def shown_residual(svbrdf: SVBRDF, material: SVBRDF, f0: Tensor = GLASS, taken: Tensor | None = None,
                   ) -> dict[str, float]:
    """:func:`residual` of what a program shows (:func:`mitsvbrdf.material.conversion.as_shown`). ``taken``
    is the share of diffuse light that the highlight takes; default: the largest channel of ``f0``.
    """
    taken = f0.amax(dim=-1, keepdim=True) if taken is None else taken
    step = max(1, svbrdf.resolution // TEXELS)

    def some(value: Tensor) -> Tensor:
        return value[::step, ::step] if value.dim() else value

    return residual(svbrdf.map(some), as_shown(material.map(some), some(f0), some(taken)))
