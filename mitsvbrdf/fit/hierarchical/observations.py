"""The photos as a round sees them: noise, weights of pixels, and maps freed of burnt-in highlights."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...capture import Capture
from ...material.maps import SVBRDF
from ...measure.burn_in import cubic
from ...render import Renderer
from ...views import Views, coverage_angle, geometry, strips
from ..config import HierarchicalConfig
from .scales import Scale
from .sensor_noise import sensor_noise
from .solver import Observations, Solved
from .stages import Stages
from .starts import stepped
from .texel_prior import TexelEstimate, TexelPrior
from .time_budget import TimeBudget
from .view_corrections import ViewCorrections

ROBUST = 3.0  # errors beyond so many times the noise count by their size alone
ROBUST_END = 10.0  # the same at full size of real photos, where every start is near its highlight
CHANCE = 0.08  # of a map's variance: what a pattern of its own may have in common with the coverage angle
TAIL_FLOOR = 0.03  # least that a pixel counts


@dataclass(frozen=True, eq=False)
class ObservationModel:
    """The photos in the present round.

    Args:
        stages: where the fit stands.
        corrections: where camera and flash stood.
        config: settings.
        budget: learns what steps take.
    """

    stages: Stages
    corrections: ViewCorrections
    config: HierarchicalConfig
    budget: TimeBudget

    def observations(self, scale: Scale, estimate: TexelEstimate) -> Observations:
        """The photos; while texels are tied to look-alikes, pixels near highlights count most."""
        noise, capture = float(self.stages.noise), scale.capture
        weighted = self.stages.tied and not scale.free and self.config.highlight_reach
        weights = self._trust(scale, estimate, self.config.highlight_reach) if weighted else None
        if capture.measured is not None:
            weights = capture.measured * (1 if weights is None else weights)
        return Observations(capture.stored, self.corrections.applied(capture.views), capture.transfer, noise,
                            (ROBUST_END if scale.free else ROBUST) * noise, weights,
                            self.stages.by_brightness if self.stages.told_by_brightness else None)

    def stepped(self, scale: Scale, answer: TexelEstimate, prior: TexelPrior, steps: int) -> Solved:
        """The texels after some steps."""
        with self.budget.timed("solver", steps * answer.x[0].numel()):
            return stepped(scale.solver, self.observations(scale, answer), answer, prior, steps)

    def measure_noise(self, svbrdf: SVBRDF, capture: Capture, unknowns: int, renderer: Renderer) -> None:
        """Learn the noise of exact photos from a material of their size, of so many unknowns a texel."""
        views = self.corrections.applied(capture.views)
        self.stages.measure(sensor_noise(svbrdf, views, capture, renderer, unknowns))

    def without_burn_in(self, planes: Tensor, scale: Scale, estimate: TexelEstimate) -> Tensor:
        """Shared unknowns that do not follow the highlights of real photos."""
        if not (len(planes) and self.stages.tied and self.config.remove_burn_in):
            return planes
        return without_burn_in(planes, self.corrections.applied(scale.capture.views),
                               self._trust(scale, estimate, self.config.highlight_reach or 1.0))

    def _trust(self, scale: Scale, estimate: TexelEstimate, reach: float) -> Tensor:
        roughness = scale.solver.svbrdf(estimate.mean)["roughness"][..., 0]
        return trust(self.corrections.applied(scale.capture.views), roughness, reach)


def trust(views: Views, roughness: Tensor, reach: float) -> Tensor:
    """How much a photo's pixels count, N x R x R: less where the flash is seen far from its mirror direction.

    There GGX is least like real materials (their highlights have longer tails), and a small glow, which all
    texels without a highlight show, would be taken for roughness. 1 / (1 + tan^2 / (reach alpha)^2) of the
    angle between half vector and the flat normal.

    Args:
        views: N views.
        roughness: R x R.
        reach: in lobe widths.
    """
    side, parts = roughness.shape[-1], []
    for rows in strips(side):
        sine2 = geometry(views, side, rows)[1][..., :2].square().sum(-1)
        parts.append(1 / (1 + sine2 / (1 - sine2) / (reach * roughness[rows]**2) ** 2))
    return torch.cat(parts, dim=1).clamp_min(TAIL_FLOOR)


def without_burn_in(planes: Tensor, views: Views, trusted: Tensor) -> Tensor:
    """Maps S x R x R with a weaker cubic trend along the coverage angle, at the highlights' level.

    A material knows nothing of where the camera stood; a map that follows it was taught by what the model
    lacks. As much of the trend stays as explains a share :data:`CHANCE` of a map's variance: that may be the
    material's own.

    Args:
        planes: S x R x R.
        views: N views.
        trusted: of :func:`trust`, N x R x R.
    """
    angle = coverage_angle(views, planes.shape[-1]).flatten()
    trend, weight = cubic(angle, planes.flatten(1)), trusted.amax(dim=0).flatten()
    along = (trend - trend.mean(dim=1, keepdim=True)).square().mean(dim=1).clamp_min(1e-12)
    across = (planes.flatten(1).double().var(dim=1, correction=0) - along).clamp_min(0)
    kept = (CHANCE / (1 - CHANCE) * across / along).sqrt().clamp_max(1)
    trend = (1 - kept)[:, None] * trend
    level = (weight * trend).sum(dim=1, keepdim=True) / weight.sum()
    return planes - (trend - level).reshape(planes.shape).float()
