"""How accurate float32 can be at a texel.

Float32 stores a direction to about one rounding, u = 2^-24 rad: a normal stored as (n + 1) / 2 is rounded by
up to 2^-25 a component, and this error doubles when it is read. A normal turned by u changes a rendered
value L by u |dL/dn| at most, with dL/dn in the tangent plane. The float64 twin gives both components: all
normals are turned by u about two perpendicular axes. u is large for float64 and small beside the width of any
lobe, so second-order terms do not matter. The limit of the relative error is

    u + u |dL/dn| / |L|

with the first u for the rounding of L itself. Near a mirror direction L behaves like GGX's D. The slope
|d log D / d angle| is at most 2 (1 - alpha^2) / alpha, at about alpha from the highlight. The limit is
u + 2 u / alpha there, 1.2e-5 at roughness 0.1, and 6e-8 on rough materials. The same changes of a gradient
give its limit. The limit is an order of magnitude, no bound: directions of view and light are rounded too
(measured on the made and corner materials in co-located views: 8 times the limit at most), and a renderer
that computes directions in float64, or their differences, stays below it.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from ..material.maps import SVBRDF
from ..measure.gradients import Measured, render_and_gradients
from ..measure.tolerances import UNIT_ROUNDOFF
from ..render import Renderer
from ..views import Views


class Limit(NamedTuple):
    """Size of the change of the float64 twin's results if every normal is rounded once."""

    image: Tensor  # N x R x R x 3
    gradients: dict[str, Tensor]  # map name to a tensor of the map's shape


def float32_limit(twin: Renderer, svbrdf: SVBRDF, views: Views, exact: Measured,
                  cotangent: Tensor | None = None) -> Limit:
    """The changes that one float32 rounding of every normal makes; see the module's text.

    ``exact``: results of ``analytic64`` with the original normals and this cotangent.
    """
    turned = [render_and_gradients(twin, m, views, cotangent) for m in turned_normals(svbrdf, UNIT_ROUNDOFF)]
    return Limit(_length([t.image - exact.image for t in turned]),
                 {name: _length([t.gradients[name] - value for t in turned])
                  for name, value in exact.gradients.items()})


def turned_normals(svbrdf: SVBRDF, angle: float) -> tuple[SVBRDF, SVBRDF]:
    """Two float64 copies of the material; normals are turned by ``angle`` (rad) about perpendicular axes."""
    maps = svbrdf.to(torch.float64).maps
    normal = maps["normal"]  # its length is kept: a gradient depends on the length, too
    x = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand_as(normal)
    first = F.normalize(torch.linalg.cross(normal, x), dim=-1)  # z > 0, so a normal is never along x
    second = F.normalize(torch.linalg.cross(normal, first), dim=-1)
    one, two = (SVBRDF(svbrdf.bsdf, {**maps, "normal": normal + angle * axis}) for axis in (first, second))
    return one, two


def _length(parts: list[Tensor]) -> Tensor:
    return torch.stack(parts).square().sum(dim=0).sqrt()
