"""How the photos are seen in a round: with which noise, and which of their pixels count most."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ..config import HierarchicalConfig
from .highlights import independent, trust
from .moved_views import MovedViews
from .scales import Scale
from .solver import Observations
from .stages import Stages
from .ties import Answer

ROBUST = 3.0  # errors beyond so many times the noise count by their size alone
# the same at full size of photos of a phone, where no start is that far from its highlight any more
ROBUST_END = 10.0


@dataclass(frozen=True, eq=False)
class Seen:
    """The photos in the present round.

    Args:
        stages: where the fit stands.
        moved: where camera and flash stood.
        config: settings.
    """

    stages: Stages
    moved: MovedViews
    config: HierarchicalConfig

    def observations(self, scale: Scale, answer: Answer) -> Observations:
        """The photos; while texels are tied to look-alikes, pixels near highlights count most."""
        noise, capture = float(self.stages.noise), scale.capture
        weighted = self.stages.tied and not scale.free and self.config.tails
        return Observations(capture.photos, self.moved.moved(capture.views), capture.transfer, noise,
                            (ROBUST_END if scale.free else ROBUST) * noise,
                            self._trust(scale, answer, self.config.tails) if weighted else None)

    def independent(self, planes: Tensor, scale: Scale, answer: Answer) -> Tensor:
        """Shared unknowns kept from following where the photos of a phone showed highlights."""
        if not (len(planes) and self.stages.tied and self.config.independent):
            return planes
        return independent(planes, self.moved.moved(scale.capture.views),
                           self._trust(scale, answer, self.config.tails or 1.0))

    def _trust(self, scale: Scale, answer: Answer, reach: float) -> Tensor:
        roughness = scale.solver.svbrdf(answer.mean)["roughness"][..., 0]
        return trust(self.moved.moved(scale.capture.views), roughness, reach)
