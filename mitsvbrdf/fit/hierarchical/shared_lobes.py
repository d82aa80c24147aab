"""Which of the shared lobes each texel of exact photos has, and what it is with it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor

from ...render import Renderer
from ..checkpoint import part
from .evidence import evidence, searched
from .lobes import Learner, Lobes
from .scales import COARSE, Scale
from .sensor_noise import sensor_noise
from .solver import Observations
from .stages import Stages
from .starts import other_starts
from .texel_prior import FIXED, TexelEstimate, TexelPrior

LIKELY = 8  # lobes that are tried in a texel: those most common among its look-alikes
STEEPEST = 10.0  # slope of a normal: 84 degrees
FAR_MORE = 30.0  # log of how much likelier than the present one a lobe may count

Start = Callable[[TexelEstimate], TexelEstimate]


class SharedLobes:
    """The lobes, once they are learned: a start, a prior and a cost for texels that have them.

    Args:
        prior: of the texels.
    """

    def __init__(self, prior: TexelPrior) -> None:
        self.prior, self.names = prior, [prior.unknowns.names[i] for i in prior.shared]
        self.lobes: Lobes | None = None
        # -2 log of the shares of lobes in the texels of the present scale, Q x R x R
        self.rare: Tensor | None = None

    def __bool__(self) -> bool:
        return self.lobes is not None

    def search(self, scale: Scale, answer: TexelEstimate, observed: Callable[[], Observations],
               stages: Stages, renderer: Renderer, seed: int) -> tuple[TexelEstimate, Tensor]:
        """Explain each texel at many roughnesses; learn of that the noise of the photos, then the lobes.

        Args:
            scale: of the texels.
            answer: where to start.
            observed: gives the photos, by the noise known so far.
            stages: learn the noise.
            renderer: of the material.
            seed: of the lobes.

        Returns:
            Texels with the lobes that they most probably have, and their lowest mean cost.
        """
        photos, side = observed(), scale.capture.resolution
        answers, best = searched(scale.solver, photos, self.prior, answer.x)
        svbrdf = scale.solver.svbrdf(best).map(Tensor.contiguous)
        stages.measure(sensor_noise(svbrdf, photos.views, scale.capture, renderer, len(best)))
        found = evidence(scale.solver, observed(), answer, self.prior.shared, answers)
        learner = Learner(self.names, scale.member, len(scale.capture))
        self._take(learner.learned(found, seed), scale)
        seen = learner.each(found, self._lobes)
        lobe = (seen.cost.T + self._rare.flatten(1)).argmin(dim=0)
        x = best.clone()
        x[self.prior.shared] = seen.mean[torch.arange(len(lobe)), lobe].T.float().reshape(-1, side, side)
        return self.having(answer._replace(x=self.prior.bounded(x).contiguous()),
                           lobe.reshape(side, side)), found.cost.amin(dim=0).mean()

    def learn_anew(self, scale: Scale, photos: Observations, answer: TexelEstimate) -> TexelEstimate:
        """Move the lobes to where the texels are that have them."""
        found = evidence(scale.solver, photos, answer, self.prior.shared, [answer.x])
        learner = Learner(self.names, scale.member, len(scale.capture))
        self._take(learner.moved(self._lobes, found, answer.lobe.flatten()), scale)
        return self.having(answer, answer.lobe)

    @property
    def _lobes(self) -> Lobes:
        assert self.lobes is not None
        return self.lobes

    @property
    def _rare(self) -> Tensor:
        assert self.rare is not None
        return self.rare

    def _take(self, lobes: Lobes, scale: Scale) -> None:
        side = scale.capture.resolution
        self.lobes = lobes
        self.prior.low[self.prior.slopes], self.prior.high[self.prior.slopes] = -STEEPEST, STEEPEST
        self.rare = (-2 * lobes.shares(scale.member).log()).T.reshape(-1, side, side)

    def having(self, answer: TexelEstimate, lobe: Tensor, at_mean: bool = False) -> TexelEstimate:
        """Texels with the priors of these lobes, R x R, and at their means where that is asked for."""
        of, lobes = self.prior.shared, self._lobes
        x, mean, precision = answer.x, answer.mean.clone(), answer.precision.clone()
        mean[of], precision[of] = lobes.mean.float().T[:, lobe], (1 / lobes.variance).float().T[:, lobe]
        if at_mean:
            x = x.clone()
            x[of] = mean[of]
        return answer._replace(x=x, mean=mean, precision=precision, lobe=lobe)

    def enlarged(self, answer: TexelEstimate, fine: Scale) -> TexelEstimate:
        """Texels of full size, each as the next coarse one: these are some of them; lobes do not mix."""
        side = fine.capture.resolution

        def nearest(planes: Tensor) -> Tensor:
            return F.interpolate(planes[None].float(), side, mode="nearest-exact")[0].contiguous()

        self._take(self._lobes, fine)
        planes = {name: nearest(getattr(answer, name)) for name in ("x", "mean", "precision")}
        return answer._replace(lobe=nearest(answer.lobe[None])[0].long(), **planes)

    def improbability(self, scale: Scale, photos: Observations, answer: TexelEstimate) -> Tensor:
        """What costs lack to -2 log of the marginal likelihood of texels' lobes, R x R (Laplace)."""
        _, narrowed = scale.solver.posterior(photos, answer.x, answer.precision)
        return (narrowed - answer.precision[self.prior.shared].log().sum(dim=0)
                + self._rare.gather(0, answer.lobe[None])[0])

    @property
    def tried(self) -> int:
        """How many lobes :meth:`averaged` tries."""
        return LIKELY + 1

    def _others(self, answer: TexelEstimate) -> list[Tensor]:
        """Lobes that texels may have: the common ones, and the last, that of texels like no others."""
        common = self._rare.topk(min(LIKELY, len(self._rare)), dim=0, largest=False).indices
        return [*common, torch.full_like(answer.lobe, len(self._rare) - 1)]

    def starts(self, answer: TexelEstimate, turn: int) -> list[Start]:
        """Other starts in a round: neighbours with their lobes, tilts, and other lobes.

        Args:
            answer: so far.
            turn: which round it is, from 1; in the first the other coarse texels nearby are starts, too.
        """
        *common, wide = self._others(answer)
        half = answer.x.shape[-1] // COARSE // 2 if turn == 1 else 0
        corners = [(y, x) for y in (-half, half) for x in (-half, half)] if half else []
        return [*(lambda _, y=y, x=x: answer.rolled(y, 1).rolled(x, 2) for y, x in corners),
                *other_starts(self.prior, turn),
                partial(self.having, lobe=common[turn % len(common)], at_mean=True),
                partial(self.having, lobe=wide)]

    def averaged(self, answer: TexelEstimate, cost: Tensor,
                 scored: Callable[[TexelEstimate], tuple[TexelEstimate, Tensor]]) -> TexelEstimate:
        """Texels averaged over the lobes that they may have, as likely as these are; shared numbers are held.

        Args:
            answer: with the likeliest lobes.
            cost: -2 log of their likelihoods, R x R.
            scored: gives such an answer and its costs from a start.
        """
        x, total, had = answer.x, torch.ones_like(cost), [answer.lobe]
        for lobe in self._others(answer):
            other, its = scored(self.having(answer, lobe))
            new = torch.stack([lobe != before for before in had]).all(dim=0)
            likely = torch.where(new & its.isfinite(), ((cost - its) / 2).clamp_max(FAR_MORE).exp(), 0.0)
            x, total, had = x + likely * other.x, total + likely, [*had, lobe]
        x, mean, precision, of = x / total, answer.mean.clone(), answer.precision.clone(), self.prior.shared
        mean[of], precision[of] = x[of], FIXED**-2.0
        return answer._replace(x=x, mean=mean, precision=precision)

    def state(self) -> dict[str, Tensor]:
        """Everything :meth:`load_state` needs."""
        return {f"lobes.{name}": value for name, value in self.lobes._asdict().items()} if self.lobes else {}

    def load_state(self, state: dict[str, Tensor], scale: Scale) -> None:
        """Go on from a saved state at a scale."""
        self.lobes = self.rare = None
        if saved := part(state, "lobes."):
            self._take(Lobes(**saved), scale)
