"""Standard deviation of each texel's numbers, from the curvature of the photometric error.

What the photos say about one texel alone, in the model of the fit (Gauss-Newton, as in any nonlinear least
squares): with J the derivative of its display values in all photos by its unknowns, s the noise, and a weak
prior of standard deviation p, the covariance is (J^T J / s^2 + 1 / p^2)^-1. Neighbours, priors and networks,
which share evidence between texels, do not count; nor does what is wrong for all photos alike, such as the
light power.

A curvature knows one lobe and those close to it. A lobe so broad that it looks like the diffuse colour, and
one so narrow that no photo met its highlight, make almost the same photos, with nothing between them that
does. So each texel is also given other roughnesses, with the colours that come nearest to its rendering then.
Those that the noise hides count as what the texel might be as well, each as much as it is likely.

Nor does a curvature know a colour near 0: what is shown follows the colour, which its number, the colour to 1
/ 2.2, hardly changes there. A slope by such a number is therefore that of the chord over the deviation that
comes out, as far as 0 below it. Where nothing else lights a texel, display values do follow the number, and
the deviation stated is larger than it is.

All numbers are those in which map errors are counted (docs/conventions.md): diffuse and specular as
linear^(1/2.2), roughness and metallic as they are, normals as (n + 1) / 2. Each has a range of 1, and the
prior is that range: p = 1 / sqrt(12), the standard deviation of a number of which nothing else is known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..color import QUANTIZATION_NOISE
from ..material.maps import COLOURS, SVBRDF
from ..render.analytic import AnalyticRenderer
from ..render.needs import Needs
from ..views import Views
from .task import FitTask

GRID = 64  # texels a side that are looked at; of larger maps, area averages
UNKNOWN = 1 / math.sqrt(12)
DETERMINED = 0.1  # a texel counts as determined when its standard deviation is below this
STEP = 1e-5  # of the differences
LOBES = 6  # other roughnesses that a texel is given: middles of as many equal parts of the range
RANGE = 0.01, 0.99  # of the numbers that go with them
# slopes of what is shown by a colour are taken no lower than at this number: below it they are the same
LIFTED = 0.05
CHORDS = 8  # times that deviations and the chords over them are found from each other


def deviations(svbrdf: SVBRDF, views: Views, images: Tensor, task: FitTask) -> dict[str, Tensor]:
    """Standard deviations of the fitted maps by name: r x r x C (normal: x and y), r <= 64, float32.

    Args:
        svbrdf: the fitted material.
        views: as fitted.
        images: its re-rendered photos, linear, N x R x R x 3; their distance to the photos is the noise
            level.
        task: the photos, whose clipped pixels say nothing here, and the fixed maps.
    """
    capture = task.capture
    side = min(GRID, svbrdf.resolution)
    seen = capture.usable.double()
    miss = seen * (color.to_display(images, capture.transfer) - capture.photos).double().square()
    weights, missed = (
        F.adaptive_avg_pool2d(x.permute(0, 3, 1, 2), side).permute(2, 3, 0, 1).reshape(side * side, -1, 1)
        for x in (seen, miss))
    known = svbrdf.to(torch.float64).resized(side)
    numbers = {name: numbers_of(name, value) for name, value in known.maps.items() if name not in task.fixed}
    if task.config.grey_specular:
        numbers["specular"] = numbers["specular"][..., :1]
    lifted = {name: value.clamp_min(LIFTED) if name in COLOURS else value for name, value in numbers.items()}
    slopes = jacobian(known, lifted, views, capture.transfer)

    # The noise of a texel: what its own photos are missed by. The fit took out of that as many values as it
    # has unknowns; for these the average over all texels stands in.
    unknowns, typical = slopes.shape[-1], max(float(miss.sum() / seen.sum().clamp_min(1)),
                                              QUANTIZATION_NOISE**2)
    noise2 = ((missed.sum(dim=1, keepdim=True) + unknowns * typical)
              / weights.sum(dim=1, keepdim=True).clamp_min(unknowns))
    curve = slopes.mT @ (weights * slopes) / noise2
    reach = torch.full_like(slopes[:, 0], UNKNOWN)
    for _ in range(CHORDS):
        chord = _chords(numbers, reach) / _chords(lifted, torch.full_like(reach, STEP))
        whole = chord[:, :, None] * curve * chord[:, None]
        whole.diagonal(dim1=1, dim2=2).add_(1 / UNKNOWN**2)
        variance = torch.linalg.inv(whole).diagonal(dim1=1, dim2=2).clamp(0, UNKNOWN**2)
        reach = (reach * variance.sqrt()).sqrt()  # half way, or it swings: near 0 they outrun each other
    if "roughness" in numbers:
        variance = _with_other_lobes(variance, known, numbers, views, capture.transfer, weights / noise2)
    spread = variance.clamp_max(UNKNOWN**2).sqrt().float()
    parts = spread.reshape(side, side, -1).split([value.shape[-1] for value in numbers.values()], dim=-1)
    return dict(zip(numbers, parts))


def _with_other_lobes(variance: Tensor, known: SVBRDF, numbers: Mapping[str, Tensor], views: Views,
                      transfer: color.Transfer, precision: Tensor) -> Tensor:
    """Mean squared deviations of each texel's unknowns, r^2 x unknowns, with other roughnesses counted.

    Args:
        variance: around what was found, r^2 x unknowns.
        known: the material, r x r, float64.
        numbers: the unknown maps, roughness among them, r x r x C.
        views: N views.
        transfer: how display values encode light.
        precision: of display values, r^2 x 3 N x 1; 0 where clipped.
    """
    goal = shown(known, views, transfer)
    rest = {name: value for name, value in numbers.items() if name not in ("roughness", "normal")}
    found = _columns(numbers)
    at = torch.tensor([name == "roughness" for name, value in numbers.items()
                       for _ in range(value.shape[-1])])

    def missed(maps: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        error = (goal - shown(material_of(known, maps), views, transfer))[..., None]
        off = (_columns(maps) - found)[:, ~at].square().sum(dim=1, keepdim=True)
        return error, (precision * error.square()).sum(dim=1) + off / UNKNOWN**2

    mass = math.sqrt(2 * math.pi) * variance[:, at].sqrt()
    square = mass * variance
    for lobe in range(LOBES):
        other = {**numbers, "roughness": torch.full_like(numbers["roughness"], (lobe + 0.5) / LOBES)}
        error, cost = missed(other)
        x = _columns(other)
        if rest:  # a Gauss-Newton step towards the rendering of what was found, where it comes nearer
            slopes = jacobian(material_of(known, other), rest, views, transfer)
            curve = (slopes.mT @ (precision * slopes)
                     + torch.eye(slopes.shape[-1], dtype=slopes.dtype) / UNKNOWN**2)
            step = torch.linalg.solve(curve, slopes.mT @ (precision * error))[..., 0]
            parts = step.split([value.shape[-1] for value in rest.values()], dim=1)
            nearer = other | {name: (value + part.reshape(value.shape)).clamp(*RANGE)
                              for (name, value), part in zip(rest.items(), parts)}
            _, less = missed(nearer)
            x, cost = torch.where(less < cost, _columns(nearer), x), less.minimum(cost)
        likely = torch.exp(-cost / 2) / LOBES
        mass, square = mass + likely, square + likely * (x - found).square()
    return variance.maximum(square / mass)


def _chords(numbers: Mapping[str, Tensor], spread: Tensor) -> Tensor:
    """Mean slopes of colours by their numbers within ``spread`` and above 0, r^2 x unknowns; else 1."""
    coloured = torch.tensor([name in COLOURS for name, value in numbers.items()
                             for _ in range(value.shape[-1])])
    x = _columns(numbers)
    high, low = x + spread, (x - spread).clamp_min(0)
    return torch.where(coloured, (color.decode(high) - color.decode(low)) / (high - low), 1.0)


def _columns(numbers: Mapping[str, Tensor]) -> Tensor:
    """Maps r x r x C side by side, a row for each texel."""
    return torch.cat(list(numbers.values()), dim=-1).flatten(0, 1)


def confidence(spreads: Mapping[str, Tensor]) -> dict[str, dict[str, float]]:
    """For each map the median deviation, and the share of texels whose deviation is below 0.1.

    Args:
        spreads: of :func:`deviations`; a texel's deviation is the root mean square over its channels.
    """
    found = {}
    for name, value in spreads.items():
        texels = value.square().mean(dim=-1).sqrt()
        found[name] = {"median_sd": float(texels.median()),
                       "determined_share": float((texels < DETERMINED).float().mean())}
    return found


def jacobian(known: SVBRDF, numbers: Mapping[str, Tensor], views: Views, transfer: color.Transfer) -> Tensor:
    """Slopes of each texel's display values by its unknowns: r^2 x 3 N x unknowns, float64.

    Args:
        known: the material, r x r, float64.
        numbers: the unknown maps in the numbers of :func:`numbers_of`, r x r x C; the columns come in this
            order.
        views: N views.
        transfer: how display values encode light.
    """
    def moved(name: str, channel: slice, step: float) -> Tensor:
        value = numbers[name].clone()
        value[..., channel] += step
        return shown(material_of(known, {name: value}), views, transfer)

    columns = []
    for name, value in numbers.items():
        count = value.shape[-1]
        # a channel shows its own channel of a colour alone: one pair serves all
        coloured = name in COLOURS and count == 3
        for channel in [slice(None)] if coloured else [slice(k, k + 1) for k in range(count)]:
            slope = (moved(name, channel, STEP) - moved(name, channel, -STEP)) / (2 * STEP)
            columns.append(slope.unflatten(1, (-1, 3)).diag_embed().flatten(1, 2) if coloured
                           else slope[..., None])
    return torch.cat(columns, dim=-1)


def shown(svbrdf: SVBRDF, views: Views, transfer: color.Transfer) -> Tensor:
    """Display values of each texel in all photos, not clipped: r^2 x 3 N, float64."""
    renderer = AnalyticRenderer(torch.float64, Needs())  # everything: a flat normal map has slopes too
    values = color.encode(renderer.render(svbrdf, views), transfer)
    return values.permute(1, 2, 0, 3).flatten(2, 3).flatten(0, 1)


def material_of(known: SVBRDF, numbers: Mapping[str, Tensor]) -> SVBRDF:
    """A material with some maps replaced by those of the numbers of :func:`numbers_of`."""
    maps = {name: map_of(name, value).expand_as(known[name]) for name, value in numbers.items()}
    return SVBRDF(known.bsdf, {**known.maps, **maps})


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
