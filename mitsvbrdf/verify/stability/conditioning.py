"""What a texel's photos say about its maps, and how far a step may go.

The Jacobian is that of one texel's display values in all views (3 N rows: what a fit compares, and where
noise is about even) with respect to its maps in units of their range: colours, metallic and roughness 1, the
normal 1 rad in its tangent plane (9 columns for ``roughconductor``, 7 for ``principled``). Texels do not see
each other, so one backward pass for each row, of the sum over the texels, gives that row for all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import color
from ...fit.losses import photometric
from ...material.maps import SVBRDF
from ...render import Renderer
from ...views import Views

# singular values below this share of the largest are none: float64 rounding is far below, any information
# above
RANK = 1e-9
FIRST = 0.01
DOUBLINGS = 24


def jacobian(twin: Renderer, svbrdf: SVBRDF, views: Views,
             display: Callable[[Tensor], Tensor] = color.encode) -> Tensor:
    """A Jacobian a texel, T x 3 N x P, float64; rows by view, then channel; columns by map.

    ``twin`` is ``analytic64``; ``display`` makes what a fit sees of linear radiance.
    """
    leaves = _leaves(svbrdf.to(torch.float64))
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
    """Condition numbers over texels of Jacobians T x M x P: largest by smallest singular value.

    Returns:
        ``median`` and ``worst``, None for infinite (fewer equations than unknowns, or nothing seen of one of
        them), and the median ``rank`` and the number of ``unknowns``.
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


def largest_step(renderer: Renderer, svbrdf: SVBRDF, views: Views, transfer: color.Transfer = "gamma2.2",
                 first: float | None = None) -> float:
    """The largest step of plain gradient descent that still lowers the photometric loss.

    The loss is summed over texels: a step means the same at every resolution. Steps double, or halve if the
    first one was too long, until lowering changes. Each step starts from the same material a little off, and
    ends in valid maps. ``first``: the step tried first; default: it takes :data:`FIRST` of a linear loss.

    Returns:
        The step as a factor of the gradient, to a factor of two; infinite where :data:`DOUBLINGS` doublings
        were not too far; 0 where the gradient is 0 or not finite, or no step of as many halvings helps.
    """
    dtype = torch.float64 if renderer.name == "analytic64" else torch.float32
    photos = color.to_display(renderer.render(_leaves(svbrdf.to(dtype)), views).detach(), transfer)

    def loss(maps: SVBRDF) -> Tensor:
        return photometric(renderer.render(maps, views), photos, transfer) * svbrdf.resolution**2

    start = _leaves(disturbed(svbrdf).to(dtype))
    here = loss(start)
    slopes = dict(zip(start.maps, torch.autograd.grad(here, list(start.maps.values()))))
    square = float(sum(g.double().square().sum() for g in slopes.values()))
    if not square > 0 or not math.isfinite(square):
        return 0.0

    def lower(step: float) -> bool:
        moved = SVBRDF(svbrdf.bsdf, {name: value - step * slopes[name] for name, value in start.maps.items()})
        return bool(loss(_leaves(valid(moved))) < here)

    step = first or FIRST * float(here.detach()) / square
    longer = lower(step)
    for _ in range(DOUBLINGS):
        following = step * 2 if longer else step / 2
        if lower(following) != longer:
            return step if longer else following
        step = following
    return math.inf if longer else 0.0


def _leaves(svbrdf: SVBRDF) -> SVBRDF:
    """Maps that want a gradient: renderers omit nothing and share one kernel."""
    return svbrdf.map(lambda t: t.detach().clone().requires_grad_())


def disturbed(svbrdf: SVBRDF) -> SVBRDF:
    """A material a little off: colours and metallic by up to 0.05, roughness by 10 %, normals by 1 degree."""
    rng = torch.Generator().manual_seed(5)
    maps = {}
    for name, value in svbrdf.maps.items():
        size = 0.1 * value if name == "roughness" else 0.0175 if name == "normal" else 0.05
        maps[name] = value + size * (2 * torch.rand(value.shape, generator=rng) - 1)
    return valid(SVBRDF(svbrdf.bsdf, maps))


def valid(svbrdf: SVBRDF) -> SVBRDF:
    """Maps cut to their ranges, unit normals."""
    maps = {name: value.clamp(1e-4 if name == "roughness" else 0.0, 1.0)
            for name, value in svbrdf.maps.items()}
    x, z = svbrdf["normal"][..., :2], svbrdf["normal"][..., 2:].clamp_min(1e-3)
    return SVBRDF(svbrdf.bsdf, {**maps, "normal": F.normalize(torch.cat((x, z), dim=-1), dim=-1)})
