"""Which of the shared lobes each texel of exact photos has, and what it is with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import torch
import torch.nn.functional as F
from torch import Tensor

from ...render import Renderer
from .evidence import evidence, searched
from .kernel import tile_rows, tiles
from .lobes import Learner, Lobes
from .observations import ObservationModel
from .relief import STEEPEST, Relief
from .scales import COARSE, Scale
from .sharing import membership
from .solver import Observations, TexelSolver
from .starts import GOLDEN, TILTS, Start, other_starts, tilted, variances
from .texel_prior import FIXED, TexelEstimate, TexelPrior

LIKELY = 8  # lobes that are tried in a texel: those most common among its look-alikes
TRIED = LIKELY + 2  # by :meth:`SharedLobes.averaged`
TURNS = 6  # tilts that a texel is begun at whose photos refuse its answer
FAR_MORE = 30.0  # log of how much likelier than the present one a lobe may count


@dataclass(frozen=True, eq=False)
class SharedLobes:
    """A start, a prior and a cost for the texels of a scale.

    Args:
        lobes: that they share.
        prior: of them, whose normals may be steep.
        relief: how steep they are.
        scale: of the texels.
        look: of each, M x 5 (:func:`.sharing.appearance_of`).
    """

    lobes: Lobes
    prior: TexelPrior
    relief: Relief
    scale: Scale
    look: Tensor

    @classmethod
    def at(cls, lobes: Lobes, prior: TexelPrior, relief: Relief, scale: Scale) -> SharedLobes:
        """Lobes for the texels of a scale."""
        return cls(lobes, prior.within("normal", -STEEPEST, STEEPEST), relief, scale, scale.look)

    def rare(self, texels: Tensor) -> Tensor:
        """-2 log of the shares of the lobes in the texels at some places, Q x ..."""
        member = membership(self.look[texels.flatten()], self.scale.basis, self.scale.width)
        return (-2 * self.lobes.shares(member).log()).T.reshape(-1, *texels.shape)

    @classmethod
    def searched(cls, prior: TexelPrior, scale: Scale, answer: TexelEstimate, seen: ObservationModel,
                 renderer: Renderer) -> tuple[SharedLobes, TexelEstimate, Tensor]:
        """Explain each texel at many roughnesses; learn of that the noise of the photos, then the lobes.

        Gives the lobes, texels with those that they most probably have, and their lowest mean cost.
        """
        photos, side = replace(seen.observations(scale, answer), robust=None), scale.capture.resolution
        answers, best = searched(scale.solver, photos, prior, answer.x)
        svbrdf = scale.solver.svbrdf(best)
        seen.measure_noise(svbrdf, scale.capture, len(best), renderer)
        photos = replace(seen.observations(scale, answer), robust=None)
        relief = relief_of(prior, scale.solver, photos, answer)[0]
        found = evidence(scale.solver, photos, answer, prior.shared, answers)
        learner = Learner(prior.names, scale.member, len(scale.capture))
        lobes = cls.at(learner.learned(found, seen.config.seed), prior, relief, scale)
        each = learner.each(found, lobes.lobes)
        lobe = (each.cost.T + lobes.rare(torch.arange(side**2))).argmin(dim=0)
        x = best.clone()
        x[prior.shared] = each.mean[torch.arange(len(lobe)), lobe].T.float().reshape(-1, side, side)
        return lobes, lobes.having(answer._replace(x=prior.bounded(x).contiguous()),
                                   lobe.reshape(side, side)), found.cost.amin(dim=0).mean()

    def moved(self, scale: Scale, photos: Observations,
              answer: TexelEstimate) -> tuple[SharedLobes, TexelEstimate]:
        """The lobes moved to where the texels are that have them, and the texels with these."""
        found = evidence(scale.solver, photos, answer, self.prior.shared, [answer.x])
        learner = Learner(self.prior.names, scale.member, len(scale.capture))
        lobes = learner.moved(self.lobes, found, answer.lobe.flatten())
        moved = self.at(lobes, self.prior, self.relief, scale)
        return moved, moved.having(answer, answer.lobe)

    def having(self, answer: TexelEstimate, lobe: Tensor, at_mean: bool = False) -> TexelEstimate:
        """Texels with the priors of these lobes, R x R, and at their means where that is asked for."""
        of, lobes = self.prior.shared, self.lobes
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

        planes = {name: nearest(getattr(answer, name)) for name in ("x", "mean", "precision")}
        return answer._replace(lobe=nearest(answer.lobe[None])[0].long(), **planes)

    def improbability(self, solver: TexelSolver, photos: Observations, answer: TexelEstimate) -> Tensor:
        """What costs of the photos' texels lack to -2 log of the lobes' marginal likelihood (Laplace)."""
        _, narrowed = solver.posterior(photos, answer.x, answer.precision)
        lacking = (narrowed - answer.precision[self.prior.shared].log().sum(dim=0)
                   + self.rare(photos.places(slice(0, len(answer.lobe)))).gather(0, answer.lobe[None])[0])
        square = answer.x[self.prior.slopes].square()
        return (lacking + self.relief.improbability(square.sum(dim=0))
                - (answer.precision[self.prior.slopes] * square).sum(dim=0))

    def with_relief(self, answer: TexelEstimate, photos: Observations) -> SharedLobes:
        """With the relief that texels are seen to have, and write the prior of slopes that this gives."""
        relief, square = relief_of(self.prior, self.scale.solver, photos, answer)
        answer.mean[self.prior.slopes], answer.precision[self.prior.slopes] = 0, relief.precision(square)
        return replace(self, relief=relief)

    def _as_steep(self, answer: TexelEstimate) -> TexelEstimate:
        """Texels with a prior that lets them be as steep as they are."""
        of, precision = self.prior.slopes, answer.precision.clone()
        precision[of] = precision[of].minimum(self.relief.precision(answer.x[of].square().sum(dim=0)))
        return answer._replace(precision=precision)

    @cached_property
    def others(self) -> list[Tensor]:
        """Lobes that texels may have, 8 bits: common ones, and the last, that of texels like no others."""
        count, side = len(self.lobes.mean), self.scale.capture.resolution
        places = torch.arange(side**2).reshape(side, side).split(tile_rows(side))
        common = torch.cat([self.rare(part).topk(min(LIKELY, count), dim=0, largest=False).indices.byte()
                            for part in places], dim=1)
        return [*common, torch.full_like(common[0], count - 1)]

    def starts(self, answer: TexelEstimate, turn: int) -> list[Start]:
        """Other starts in a round: neighbours with their lobes, tilts, and other lobes.

        Turns count from 1; in the first the other coarse texels nearby are starts, too.
        """
        *common, wide = self.others
        half = answer.x.shape[-1] // COARSE // 2 if turn == 1 else 0
        corners = [(y, x) for y in (-half, half) for x in (-half, half)] if half else []
        return [*(lambda answer, rows, y=y, x=x: answer.rows(rows, y, x) for y, x in corners),
                *(lambda answer, rows, start=start: self._as_steep(start(answer, rows))
                  for start in other_starts(self.prior, turn)),
                partial(self._with, lobe=common[turn % len(common)], at_mean=True),
                partial(self._with, lobe=wide)]

    def further_starts(self, answer: TexelEstimate, texels: Tensor) -> list[TexelEstimate]:
        """Starts of the texels at some places whose photos refuse their answer.

        All neighbours with their lobes, then tilts with all else as it is in the mean: such a texel explains
        nothing, so none of its numbers is worth keeping.
        """
        side, own, wide = answer.x.shape[-1], answer.of_texels(texels), self.others[-1].take(texels).long()
        rows, columns = texels // side, texels % side
        near = [answer.of_texels((rows + y) % side * side + (columns + x) % side)
                for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x]
        x = answer.x.mean(dim=(1, 2))[:, None, None].expand_as(own.x)
        tilts = range(TURNS if len(self.prior.slopes) else 1)
        return [self._as_steep(start) for start in [*near, *(
            tilted(lobed._replace(x=x), self.prior, TILTS[turn % len(TILTS)], GOLDEN * turn)
            for lobed in (own, self.having(own, wide)) for turn in tilts)]]

    def _with(self, answer: TexelEstimate, rows: slice, lobe: Tensor, at_mean: bool = False) -> TexelEstimate:
        return self.having(answer.rows(rows), lobe[rows].long(), at_mean)

    def averaged(self, answer: TexelEstimate, cost: Tensor, rows: slice,
                 scored: Callable[[TexelEstimate], tuple[TexelEstimate, Tensor]]) -> TexelEstimate:
        """Texels averaged over the lobes that they may have, as likely as these are; shared numbers are held.

        Args:
            answer: some rows of texels, with the likeliest lobes.
            cost: -2 log of their likelihoods.
            rows: which these are.
            scored: gives such an answer and its costs from a start.
        """
        x, total, had = answer.x, torch.ones_like(cost), [answer.lobe]
        for lobe in self.others:
            lobe = lobe[rows].long()
            other, its = scored(self.having(answer, lobe))
            new = torch.stack([lobe != before for before in had]).all(dim=0)
            likely = torch.where(new & its.isfinite(), ((cost - its) / 2).clamp_max(FAR_MORE).exp(), 0.0)
            x, total, had = x + likely * other.x, total + likely, [*had, lobe]
        x, mean, precision, of = x / total, answer.mean.clone(), answer.precision.clone(), self.prior.shared
        mean[of], precision[of] = x[of], FIXED**-2.0
        return answer._replace(x=x, mean=mean, precision=precision)


def relief_of(prior: TexelPrior, solver: TexelSolver, photos: Observations,
              answer: TexelEstimate) -> tuple[Relief, Tensor]:
    """The relief that texels are seen to have, and the squares to expect of their slopes, R x R."""
    of, side = prior.slopes, answer.x.shape[-1]
    variance = torch.empty(len(of), side, side)
    for rows in tiles(side):
        variance[:, rows] = variances(solver, photos.of_rows(rows), answer.rows(rows))[of]
    x, precision = answer.x[of], answer.precision[of]
    return Relief.learned(x, variance, precision), x.square().add_(variance).sum(dim=0)
