"""Stages of exact photos: no lobe if none is needed, else lobes that texels share (multi-start)."""

from functools import cached_property

from torch import Tensor

from ...render import make_renderer
from ..checkpoint import part
from ..config import HierarchicalConfig
from ..task import FitTask
from .lobes import Lobes
from .observations import ObservationModel
from .relief import Relief
from .scales import Scale
from .shared_lobes import SharedLobes
from .solver import Observations
from .specular_test import Search, decision_work, explained_without, may_be_omitted, without_lobe
from .stages import Stage
from .starts import variances
from .texel_prior import TexelEstimate, TexelPrior


class ExactPhotos:
    """The steps that only exact photos need, and photos whose kind is not known yet."""

    def __init__(self, task: FitTask[HierarchicalConfig], search: Search, seen: ObservationModel) -> None:
        self.task, self.search, self.seen = task, search, seen
        self.lobes: SharedLobes | None = None

    @property
    def present(self) -> Search:
        """The present search: without a lobe, once the photos are found to need none."""
        return self.lobeless if self.seen.stages.matte else self.search

    @property
    def prior(self) -> TexelPrior:
        """The present prior of the texels."""
        return self.lobes.prior if self.lobes else self.present.prior

    @cached_property
    def lobeless(self) -> Search:
        """The search without a lobe."""
        return without_lobe(self.search)

    def omit_lobe(self, answer: TexelEstimate) -> tuple[Scale, TexelEstimate] | None:
        """Full-size scale and answer without a lobe; None if photos may need one, or cannot be tested."""
        stages, found = self.seen.stages, None
        asked = stages.exact and stages.finished and may_be_omitted(self.task)
        if asked and self.seen.budget.in_time(decision_work(self.search.scales)):
            found = explained_without(answer, self.search, self.lobeless, stages.unexplained[1],
                                      self.seen.observations)
        stages.matte = found is not None
        return found

    def at_full_size(self, answer: TexelEstimate, scale: Scale) -> tuple[Scale, TexelEstimate]:
        """The full-size scale, and a coarse answer enlarged to it."""
        fine = self.present.scales.of(Stage.FINE)
        if not (lobes := self.lobes):
            return fine, self.prior.enlarge(answer, scale, fine, tied=False)
        self.lobes = SharedLobes.at(lobes.lobes, lobes.prior, lobes.relief, fine, lobes.prior.lobes[2])
        return fine, self.lobes.enlarged(answer, fine)

    def next_prior(self, scale: Scale, photos: Observations, answer: TexelEstimate) -> TexelEstimate:
        """The answer with the prior of the next round, which is learned from the present texels."""
        if not self.lobes:
            variance = variances(scale.solver, photos, answer)
            return self.prior.share(answer, variance, scale, len(photos.views), tied=False)
        self._measure_noise(answer.x)
        if self.seen.stages.stage != Stage.FINE:
            self.lobes = self.lobes.moved(scale, photos, answer)
        self.lobes = self.lobes.with_relief(answer, photos)
        return answer

    def _measure_noise(self, x: Tensor) -> None:
        """Measure the noise again: an early answer explains photos only in part, so noise seemed too high.

        If noise is overestimated, texels take a lobe that the prior prefers, not one that fits the highlight.
        """
        some = self.search.scales.of(Stage.MULTI_START)
        svbrdf = some.solver.svbrdf(self.search.scales.sampled(x))
        self.seen.measure_noise(svbrdf, some.capture, len(x), make_renderer("mitsuba", some.solver.variant))

    def state(self) -> dict[str, Tensor]:
        """Everything :meth:`load_state` needs, beside the stages."""
        if not (lobes := self.lobes):
            return {}
        return {f"lobes.{name}": value for name, value in lobes.lobes._asdict().items()} | {
            "relief": lobes.relief.share, "diffuse": lobes.prior.lobes[2]}

    def load_state(self, state: dict[str, Tensor], scale: Scale) -> None:
        """Go on from a saved state at a scale."""
        saved = part(state, "lobes.")
        self.lobes = SharedLobes.at(Lobes(**saved), self.search.prior, Relief(state["relief"]), scale,
                                    state["diffuse"]) if saved else None
