"""The photos as a round uses them (noise, weights of pixels), and maps without burnt-in highlights."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ...capture import Capture
from ...material.maps import SVBRDF
from ...measure.burn_in import cubic
from ...render import Renderer
from ...views import ALL, Views, coverage_angle, geometry, strips
from ..config import HierarchicalConfig
from .scales import Scale
from .sensor_noise import sensor_noise
from .solver import Observations, Solved
from .stages import Stages
from .starts import stepped
from .texel_prior import TexelEstimate, TexelPrior
from .time_budget import TimeBudget
from .view_corrections import ViewCorrections

ROBUST = 3.0  # errors beyond this many times the noise count by their absolute value, not by their square
ROBUST_END = 10.0  # the same for real photos at full size, where every start is near its highlight
CHANCE = 0.08  # share of a map's variance that may follow the coverage angle without burn-in
TAIL_FLOOR = 0.03  # least weight of a pixel


@dataclass(frozen=True, eq=False)
class ObservationModel:
    """The photos as the present round uses them."""

    stages: Stages
    corrections: ViewCorrections
    config: HierarchicalConfig
    budget: TimeBudget

    def observations(self, scale: Scale, estimate: TexelEstimate) -> Observations:
        """The photos; while texels are tied to look-alikes, pixels near highlights count most."""
        noise, capture = float(self.stages.noise), scale.capture
        weighted = self.stages.tied and not scale.free and self.config.highlight_reach
        views = self.corrections.applied(capture.views)
        weights = trust(views, scale.solver.roughness(estimate.mean), weighted) if weighted else None
        if capture.measured is not None:
            weights = capture.measured * (1 if weights is None else weights)
        return Observations(capture.stored, views, capture.transfer, noise,
                            (ROBUST_END if scale.free else ROBUST) * noise, weights,
                            self.stages.by_brightness if self.stages.told_by_brightness else None)

    def stepped(self, scale: Scale, answer: TexelEstimate, prior: TexelPrior, steps: int) -> Solved:
        """The texels after some steps."""
        with self.budget.timed("solver", steps * answer.x[0].numel()):
            return stepped(scale.solver, self.observations(scale, answer), answer, prior, steps)

    def measure_noise(self, svbrdf: SVBRDF, capture: Capture, unknowns: int, renderer: Renderer) -> None:
        """Measure the noise of exact photos against a material of their size, ``unknowns`` per texel."""
        views = self.corrections.applied(capture.views)
        self.stages.measure(sensor_noise(svbrdf, views, capture, renderer, unknowns))

    def without_burn_in(self, planes: Tensor, scale: Scale, estimate: TexelEstimate) -> Tensor:
        """The shared unknowns ``planes``, corrected so that they do not follow highlights of real photos."""
        if not (len(planes) and self.stages.tied and self.config.remove_burn_in):
            return planes
        views, reach = self.corrections.applied(scale.capture.views), self.config.highlight_reach or 1.0
        roughness, rows = scale.solver.roughness(estimate.mean), strips(scale.capture.resolution)
        return without_burn_in(planes, views, torch.cat([trust(views, roughness, reach, each).amax(dim=0)
                                                         for each in rows]))


def trust(views: Views, roughness: Tensor, reach: float, rows: slice = ALL) -> Tensor:
    """Weights of the photos' pixels, N x ? x R: lower far from the mirror direction of the flash.

    There GGX differs most from real materials, whose highlights have longer tails: texels far from a
    highlight have a faint glow, which the fit would explain by roughness. The weight is 1 / (1 + tan^2(a) /
    (reach alpha)^2), where a is the angle between half vector and flat normal, and alpha is roughness^2.

    Args:
        roughness: R x R.
        reach: in lobe widths.
    """
    sine2 = geometry(views, len(roughness), rows)[1][..., :2].square().sum(-1)
    return (1 / (1 + sine2 / (1 - sine2) / (reach * roughness[rows]**2) ** 2)).clamp_min(TAIL_FLOOR)


def without_burn_in(planes: Tensor, views: Views, trusted: Tensor) -> Tensor:
    """Maps S x R x R with less of their cubic trend in the coverage angle (:mod:`mitsvbrdf.measure.burn_in`).

    A material does not depend on where the camera stood. A map that does so contains errors of the model. The
    level at highlights is kept. The part of the trend that explains a share :data:`CHANCE` of a map's
    variance is kept, too: it may belong to the material.

    Args:
        planes: S x R x R.
        trusted: the largest :func:`trust` over the photos, R x R.
    """
    angle, weight, found = coverage_angle(views, planes.shape[-1]).flatten(), trusted.flatten(), []
    for plane in planes:
        trend = torch.cat([*cubic(angle, plane.reshape(1, -1))], dim=1)[0]
        along = (trend - trend.mean()).square().mean().clamp_min(1e-12)
        across = (plane.double().var(correction=0) - along).clamp_min(0)
        trend *= 1 - (CHANCE / (1 - CHANCE) * across / along).sqrt().clamp_max(1)
        trend -= (weight * trend).sum() / weight.sum()
        found.append(plane - trend.reshape(plane.shape).float())
    return torch.stack(found)
