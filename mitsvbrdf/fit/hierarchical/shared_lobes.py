"""Which of the shared lobes each texel of exact photos has, and the texel's numbers with that lobe."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from ...render import Renderer
from ...views import STRIP, strips
from .evidence import evidence, searched
from .kernel import tiles
from .lobes import Learner, Lobes
from .observations import ObservationModel
from .relief import STEEPEST, Relief
from .scales import COARSE, Scale
from .sharing import membership
from .solver import Observations, TexelSolver
from .starts import GOLDEN, TILTS, Start, other_starts, tilted, variances
from .texel_prior import FIXED, TexelEstimate, TexelPrior

LIKELY = 8  # lobes that are tried in a texel: those most common among its look-alikes
TRIED = LIKELY + 2  # lobes that the last steps try in each texel: its own, LIKELY others, the wide one
TURNS = 6  # tilts from which a texel starts again if its answer is refused (:meth:`.Scoring.refused`)
FAR_MORE = 30.0  # largest log ratio by which a lobe counts as likelier than the present one


@dataclass(frozen=True, eq=False)
class SharedLobes:
    """Lobes of the texels of a scale: they give starts, a prior and a cost. Normals may be steep."""

    lobes: Lobes
    prior: TexelPrior
    relief: Relief
    scale: Scale

    @classmethod
    def at(cls, lobes: Lobes, prior: TexelPrior, relief: Relief, scale: Scale, means: Tensor) -> SharedLobes:
        """Lobes for the texels of a scale, with the diffuse means of coarse texels."""
        prior = prior.within("normal", -STEEPEST, STEEPEST)
        prior.lobes = lobes.mean.float().T, (1 / lobes.variance).float().T, means
        return cls(lobes, prior, relief, scale)

    def rare(self, texels: Tensor) -> Tensor:
        """-2 log of the shares of the lobes in M texels at some places, Q x M."""
        member = membership(self.scale.look[texels], self.scale.basis, self.scale.width)
        return -2 * self.lobes.shares(member).log().T

    @classmethod
    def searched(cls, prior: TexelPrior, scale: Scale, answer: TexelEstimate, seen: ObservationModel,
                 renderer: Renderer) -> tuple[SharedLobes, TexelEstimate, Tensor]:
        """Fit each texel at many roughnesses; from these fits, learn the noise of the photos and the lobes.

        Returns the lobes, the texels with their most probable lobes, and the mean of their lowest costs.
        """
        photos, side = replace(seen.observations(scale, answer), robust=None), scale.capture.resolution
        answers, best = searched(scale.solver, photos, prior, answer.x)
        seen.measure_noise(scale.solver.svbrdf(best), scale.capture, len(best), renderer)
        photos = replace(seen.observations(scale, answer), robust=None)
        relief = relief_of(prior, scale.solver, photos, answer)[0]
        found = evidence(scale.solver, photos, answer, prior.shared, answers)
        learner = Learner(prior.names, scale.member, len(scale.capture))
        lobes = cls.at(learner.learned(found, seen.config.seed), prior, relief, scale,
                       answer.mean[prior.diffuse].flatten(1))
        each = learner.each(found, lobes.lobes)
        lobe = (each.cost.T + lobes.rare(torch.arange(side**2))).argmin(dim=0)
        mean = each.mean[torch.arange(len(lobe)), lobe].T.float().reshape(-1, side, side)
        x, own = prior.bounded(best.index_copy(0, prior.shared, mean)), torch.arange(side**2).short()
        return lobes, TexelEstimate(x, own.reshape(1, side, side), answer.precision[prior.slopes[:1]],
                                    answer.spread, lobe.view(side, side).byte()), found.cost.amin(0).mean()

    def moved(self, scale: Scale, photos: Observations, answer: TexelEstimate) -> SharedLobes:
        """The lobes, each learned again from the texels that have it."""
        found = evidence(scale.solver, photos, self.prior.whole(answer), self.prior.shared, [answer.x])
        learner = Learner(self.prior.names, scale.member, len(scale.capture))
        lobes = learner.moved(self.lobes, found, answer.lobe.flatten().long())
        return self.at(lobes, self.prior, self.relief, scale, self.prior.lobes[2])

    def _at_mean(self, answer: TexelEstimate) -> TexelEstimate:
        mean = self.prior.lobes[0][:, answer.lobe.long()]
        return answer._replace(x=answer.x.index_copy(0, self.prior.shared, mean))

    def enlarged(self, answer: TexelEstimate, fine: Scale) -> TexelEstimate:
        """Texels at full size, each a copy of the nearest coarse texel, so that lobes are not averaged."""
        count, side = answer.x.shape[-1], fine.capture.resolution
        at = (2 * torch.arange(side) + 1) * count // (2 * side)
        return answer.of_texels(at[:, None] * count + at)

    def improbability(self, solver: TexelSolver, photos: Observations, answer: TexelEstimate) -> Tensor:
        """Terms that, added to texels' costs, give -2 log of their lobes' marginal likelihood (Laplace)."""
        answer, places = self.prior.whole(answer), photos.places(slice(0, len(answer.lobe)))
        _, narrowed = solver.posterior(photos, answer.x, answer.precision)
        rare = [self.rare(at).gather(0, lobe[None].long())[0] for at, lobe in zip(
            places.flatten().split(STRIP), answer.lobe.flatten().split(STRIP))]
        lacking = (narrowed - answer.precision[self.prior.shared].log().sum(dim=0)
                   + torch.cat(rare).reshape(places.shape))
        square = answer.x[self.prior.slopes].square()
        return (lacking + self.relief.improbability(square.sum(dim=0))
                - (answer.precision[self.prior.slopes] * square).sum(dim=0))

    def with_relief(self, answer: TexelEstimate, photos: Observations) -> SharedLobes:
        """Learn the relief from the texels, and write its prior of slopes into ``answer``."""
        relief, square = relief_of(self.prior, self.scale.solver, photos, answer)
        for rows in strips(len(square)):
            answer.precision[:, rows] = relief.precision(square[rows])
        return replace(self, relief=relief)

    def _as_steep(self, answer: TexelEstimate) -> TexelEstimate:
        square = answer.x[self.prior.slopes].square().sum(dim=0)
        return answer._replace(precision=answer.precision.minimum(self.relief.precision(square)))

    @cached_property
    def others(self) -> list[Tensor]:
        """Lobes to try, R x R numbers each, 8 bits: the most common in each texel, then the wide one."""
        count, side = len(self.lobes.mean), self.scale.capture.resolution
        common = torch.cat([self.rare(at).topk(min(LIKELY, count), dim=0, largest=False).indices.byte()
                            for at in torch.arange(side**2).split(STRIP)], dim=1).reshape(-1, side, side)
        return [*common, torch.full_like(common[0], count - 1)]

    def starts(self, answer: TexelEstimate, turn: int) -> list[Start]:
        """Other starts in a round: neighbours with their lobes, tilts, and other lobes.

        ``turn`` is the number of the round, from 1. In round 1, nearby coarse texels are starts, too.
        """
        usual, wide = self.others[turn % (len(self.others) - 1)], self.others[-1]
        half = answer.x.shape[-1] // COARSE // 2 if turn == 1 else 0
        corners = [(y, x) for y in (-half, half) for x in (-half, half)] if half else []
        return [*(lambda answer, rows, y=y, x=x: answer.rows(rows, y, x) for y, x in corners),
                *(lambda answer, rows, start=start: self._as_steep(start(answer, rows))
                  for start in other_starts(self.prior, turn)),
                lambda answer, rows: self._at_mean(answer.rows(rows)._replace(lobe=usual[rows])),
                lambda answer, rows: answer.rows(rows)._replace(lobe=wide[rows])]

    def further_starts(self, answer: TexelEstimate, texels: Tensor) -> list[TexelEstimate]:
        """Starts of the texels at some places, whose answers are refused (:meth:`.Scoring.refused`).

        First all neighbours with their lobes, then tilts whose other numbers are means: a refused answer
        explains nothing, so none of its numbers is worth keeping.
        """
        side, own, wide = answer.x.shape[-1], answer.of_texels(texels), self.others[-1].take(texels)
        rows, columns = texels // side, texels % side
        near = [answer.of_texels((rows + y) % side * side + (columns + x) % side)
                for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x]
        x = answer.x.mean(dim=(1, 2))[:, None, None].expand_as(own.x)
        tilts = range(TURNS if len(self.prior.slopes) else 1)
        return [self._as_steep(start) for start in [*near, *(
            tilted(lobed._replace(x=x), self.prior, TILTS[turn % len(TILTS)], GOLDEN * turn)
            for lobed in (own, own._replace(lobe=wide)) for turn in tilts)]]

    def averaged(self, answer: TexelEstimate, cost: Tensor, rows: slice,
                 scored: Callable[[TexelEstimate], tuple[TexelEstimate, Tensor]]) -> TexelEstimate:
        """Texels averaged over lobes that they may have, weighted by likelihood; shared numbers are held.

        Args:
            answer: some rows of texels, with the likeliest lobes.
            cost: -2 log of their likelihoods.
            scored: takes steps from a start; gives the answer and its costs.
        """
        x, total, had = answer.x, torch.ones_like(cost), [answer.lobe]
        for lobe in (planes[rows] for planes in self.others):
            other, its = scored(answer._replace(lobe=lobe))
            new = torch.stack([lobe != before for before in had]).all(dim=0)
            likely = torch.where(new & its.isfinite(), ((cost - its) / 2).clamp_max(FAR_MORE).exp(), 0.0)
            x, total, had = x + likely * other.x, total + likely, [*had, lobe]
        held, of = self.prior.whole(answer._replace(x=x / total)), self.prior.shared
        held.mean[of], held.precision[of] = held.x[of], FIXED**-2.0
        return held._replace(lobe=answer.lobe[:0])


def relief_of(prior: TexelPrior, solver: TexelSolver, photos: Observations,
              answer: TexelEstimate) -> tuple[Relief, Tensor]:
    """The relief learned from the texels, and the expected sum of squares of their slopes, R x R."""
    of, side = prior.slopes, answer.x.shape[-1]
    variance = torch.empty(len(of), side, side)
    for rows in tiles(side):
        variance[:, rows] = variances(solver, photos.of_rows(rows), prior.whole(answer.rows(rows)))[of]
    x, precision = answer.x[of], answer.precision if len(answer.lobe) else answer.precision[of]
    return Relief.learned(x, variance, precision), x.square_().add_(variance).sum(dim=0)
