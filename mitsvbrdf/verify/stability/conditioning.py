"""How well photos determine the maps of a texel: condition numbers of Jacobians.

The rows of the Jacobian are one texel's display values in all views (3 N; a fit compares them, and their
noise is about uniform). The columns are its map values in units of their range: 1 for colours, metallic and
roughness, 1 rad in the tangent plane for the normal (9 for ``roughconductor``, 7 for ``principled``). Texels
are independent, so one backward pass of the sum over the texels gives one row for all of them.
"""

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import color
from ...material.maps import SVBRDF
from ...render import Renderer
from ...views import Views

# singular values below this share of the largest count as 0: float64 rounding is far below it, and any
# information is above it
RANK = 1e-9


def jacobian(twin: Renderer, svbrdf: SVBRDF, views: Views,
             display: Callable[[Tensor], Tensor] = color.encode) -> Tensor:
    """Derivatives of the 3N display values of T texels by their P map values, T x 3N x P, float64.

    Rows are by view, then channel. ``twin`` is ``analytic64``. ``display`` encodes radiance as a fit sees it.
    """
    leaves = svbrdf.to(torch.float64).map(lambda t: t.detach().clone().requires_grad_())
    seen = display(twin.render(leaves, views))
    normal = F.normalize(svbrdf["normal"].double(), dim=-1)
    rows = []
    for row in seen.movedim(-1, 1).flatten(0, 1):
        gradients = torch.autograd.grad(row.sum(), list(leaves.maps.values()), retain_graph=True)
        columns = dict(zip(leaves.maps, gradients))
        columns["normal"] = torch.einsum("hwac,hwc->hwa", tangents(normal), columns["normal"])
        rows.append(torch.cat(list(columns.values()), dim=-1).flatten(0, 1))
    return torch.stack(rows, dim=1)


def tangents(normal: Tensor) -> Tensor:
    """Two unit vectors at right angles to each unit normal and to each other: R x R x 2 x 3."""
    axis = torch.eye(3, dtype=normal.dtype)[normal.abs().argmin(dim=-1)]
    first = F.normalize(torch.linalg.cross(normal, axis), dim=-1)
    return torch.stack((first, torch.linalg.cross(normal, first)), dim=-2)


def condition(jacobians: Tensor) -> dict[str, float | None]:
    """``median`` and ``worst`` of the condition numbers of Jacobians T x M x P, None for infinite.

    Also the median ``rank`` and the number of ``unknowns``.
    """
    unknowns = jacobians.shape[2]
    values = torch.zeros(len(jacobians), unknowns, dtype=jacobians.dtype)
    found = torch.linalg.svdvals(jacobians)
    values[:, :found.shape[1]] = found
    known = values > RANK * values[:, :1].clamp_min(torch.finfo(values.dtype).tiny)
    numbers = torch.where(known.all(dim=1), values[:, 0] / values[:, -1], torch.inf)
    median, worst = float(numbers.quantile(0.5, interpolation="lower")), float(numbers.max())
    return {"median": median if math.isfinite(median) else None, "worst": worst if math.isfinite(worst)
            else None, "rank": int(known.sum(dim=1).median()), "unknowns": unknowns}


def disturbed(svbrdf: SVBRDF) -> SVBRDF:
    """The material changed at random: colours, metallic by up to 0.05, roughness 10 %, normals 1 degree."""
    rng = torch.Generator().manual_seed(5)
    maps = {}
    for name, value in svbrdf.maps.items():
        size = 0.1 * value if name == "roughness" else 0.0175 if name == "normal" else 0.05
        off = value + size * (2 * torch.rand(value.shape, generator=rng) - 1)
        maps[name] = (F.normalize(torch.cat((off[..., :2], off[..., 2:].clamp_min(1e-3)), dim=-1), dim=-1)
                      if name == "normal" else off.clamp(1e-4 if name == "roughness" else 0.0, 1.0))
    return SVBRDF(svbrdf.bsdf, maps)
