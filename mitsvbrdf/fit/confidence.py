"""How sure a fit is: the standard deviation of each texel's numbers, from the curvature of the photometric error.

What the photos say about one texel alone, in the model of the fit (Gauss-Newton, as in any nonlinear least squares): with
J the derivative of its display values in all photos by its unknowns, s the noise, and a weak prior of standard deviation
p, the covariance is (J^T J / s^2 + 1 / p^2)^-1. Neighbours, priors and networks, which share evidence between texels, do not
count; nor does what is wrong for all photos alike, such as the light power.

All numbers are those in which map errors are counted (docs/conventions.md): diffuse and specular as linear^(1/2.2), roughness
and metallic as they are, normals as (n + 1) / 2. Each has a range of 1, and the prior is that range: p = 1 / sqrt(12), the
standard deviation of a number of which nothing else is known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..color import CLIPPED, QUANTIZATION_NOISE
from ..material.maps import COLOURS, SVBRDF
from ..render.analytic import AnalyticRenderer
from ..render.needs import Needs
from ..views import Views
from .task import FitTask

GRID = 64  # texels a side that are looked at; of larger maps, area averages
UNKNOWN = 1 / math.sqrt(12)
DETERMINED = 0.1  # a texel counts as determined when its standard deviation is below this
STEP = 1e-5  # of the differences


def deviations(svbrdf: SVBRDF, views: Views, images: Tensor, task: FitTask) -> dict[str, Tensor]:
    """Standard deviations of the maps that were fitted, by name: r x r x C (normal: x and y), r <= 64, float32.

    Args:
        svbrdf: the fitted material.
        views: as fitted.
        images: its re-rendered photos, linear, N x R x R x 3; their distance to the photos is the noise level.
        task: the photos, whose clipped pixels say nothing here, and the fixed maps.
    """
    capture = task.capture
    side = min(GRID, svbrdf.resolution)
    seen = (capture.photos < CLIPPED).double()
    miss = seen * (color.to_display(images, capture.transfer) - capture.photos).double().square()
    weights, missed = (F.adaptive_avg_pool2d(x.permute(0, 3, 1, 2), side).permute(2, 3, 0, 1).reshape(side * side, -1, 1)
                       for x in (seen, miss))
    known = svbrdf.to(torch.float64).resized(side)
    numbers = {name: numbers_of(name, value) for name, value in known.maps.items() if name not in task.fixed}
    if task.config.grey_specular:
        numbers["specular"] = numbers["specular"][..., :1]
    slopes = jacobian(known, numbers, views, capture.transfer)

    # The noise of a texel: what its own photos are missed by. The fit took out of that as many values as it has unknowns;
    # for these the average over all texels stands in.
    unknowns, typical = slopes.shape[-1], max(float(miss.sum() / seen.sum().clamp_min(1)), QUANTIZATION_NOISE**2)
    noise2 = (missed.sum(dim=1, keepdim=True) + unknowns * typical) / weights.sum(dim=1, keepdim=True).clamp_min(unknowns)
    curve = slopes.mT @ (weights * slopes) / noise2
    curve.diagonal(dim1=1, dim2=2).add_(1 / UNKNOWN**2)
    spread = torch.linalg.inv(curve).diagonal(dim1=1, dim2=2).clamp(0, UNKNOWN**2).sqrt().float()
    parts = spread.reshape(side, side, -1).split([value.shape[-1] for value in numbers.values()], dim=-1)
    return dict(zip(numbers, parts))


def confidence(spreads: Mapping[str, Tensor]) -> dict[str, dict[str, float]]:
    """For each map ``median_sd``, over texels, and ``determined_share``: of texels whose deviation is below 0.1.

    Args:
        spreads: of :func:`deviations`; a texel's deviation is the root mean square over its channels.
    """
    found = {}
    for name, value in spreads.items():
        texels = value.square().mean(dim=-1).sqrt()
        found[name] = {"median_sd": float(texels.median()), "determined_share": float((texels < DETERMINED).float().mean())}
    return found


def jacobian(known: SVBRDF, numbers: Mapping[str, Tensor], views: Views, transfer: color.Transfer) -> Tensor:
    """Slopes of each texel's display values by its own unknowns: r^2 x 3 N x unknowns, float64, central differences.

    Args:
        known: the material, r x r, float64.
        numbers: the unknown maps in the numbers of :func:`numbers_of`, r x r x C; the columns come in this order.
        views: N views.
        transfer: how display values encode light.
    """
    renderer = AnalyticRenderer(torch.float64, Needs())  # everything: a flat normal map has slopes too

    def shown(name: str, channel: int, step: float) -> Tensor:
        moved = numbers[name].clone()
        moved[..., channel] += step
        maps = {**known.maps, name: map_of(name, moved).expand_as(known[name])}
        return color.encode(renderer.render(SVBRDF(known.bsdf, maps), views), transfer)

    columns = [(shown(name, channel, STEP) - shown(name, channel, -STEP)) / (2 * STEP)
               for name, value in numbers.items() for channel in range(value.shape[-1])]
    return torch.stack(columns, dim=-1).permute(1, 2, 0, 3, 4).flatten(2, 3).flatten(0, 1)


def numbers_of(name: str, value: Tensor) -> Tensor:
    """A map in the numbers errors are counted in; of a normal, x and y."""
    if name == "normal":
        return (value[..., :2] + 1) / 2
    return color.encode(value) if name in COLOURS else value


def map_of(name: str, numbers: Tensor) -> Tensor:
    """The inverse of :func:`numbers_of`."""
    if name == "normal":
        flat = numbers * 2 - 1
        return torch.cat((flat, (1 - flat.square().sum(dim=-1, keepdim=True)).clamp_min(1e-4).sqrt()), dim=-1)
    return color.decode(numbers) if name in COLOURS else numbers
