"""What each texel's answer costs, and a further search where the photos refuse it.

Most texels converge from the usual starts. Some do not: a texel that turned away from the light explains its
photos a thousand times worse than their noise allows, and stays there. The noise tells which texels these
are. Only they are searched from more starts and by more steps (multi-start; Martí et al. 2018).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from .kernel import tile_rows, tiles
from .scales import COARSE, Scale
from .shared_lobes import SharedLobes
from .solver import Observations
from .starts import LESS, Start, stepped
from .texel_prior import TexelEstimate, TexelPrior
from .time_budget import LAST_STEPS, TimeBudget

RARE = 1e-6  # probability of errors by noise alone, below which the photos refuse a texel's answer
FURTHER_STEPS, PASSES = 20, 3  # of the further search: steps from each start, passes over refused texels
GROUP = 64  # texels a side of a square in which refused texels are searched together

Scored = tuple[TexelEstimate, Tensor]  # an answer, and what each texel costs, R x R


@dataclass(frozen=True, eq=False)
class Scoring:
    """Costs of the texels of a round, which may share lobes."""

    scale: Scale
    photos: Observations
    prior: TexelPrior
    lobes: SharedLobes | None
    budget: TimeBudget

    def scored(self, answer: TexelEstimate, steps: int, start: Start = TexelEstimate.rows,
               cost: Tensor | None = None) -> Scored:
        """An answer after some steps from a start, and the cost of each texel, by tiles.

        Args:
            answer: all texels; it is written into, and so is the cost.
            start: gives the start of some rows of the answer.
            cost: of the answer, R x R: texels stay as they are where the steps would not lower it.
        """
        def found(rows: slice) -> Scored:
            tried = self._tried(self.photos.of_rows(rows), start(answer, rows), steps)
            return tried if cost is None else _better(answer.rows(rows), cost[rows], *tried)

        least = torch.empty_like(answer.x[0]) if cost is None else cost
        with self.budget.timed("solver", steps * least.numel()):
            write_by_tiles(answer, least, found)
        return answer, least

    def averaged(self, lobes: SharedLobes, answer: TexelEstimate, cost: Tensor, steps: int) -> TexelEstimate:
        """Texels averaged over likely lobes, after the last steps, by tiles; the answer is written into."""
        def found(rows: slice) -> Scored:
            photos, part = self.photos.of_rows(rows), answer.rows(rows)
            held = lobes.averaged(part, cost[rows], rows, partial(self._tried, photos, steps=steps))
            last = stepped(self.scale.solver, photos, held, self.prior, LAST_STEPS)
            return part._replace(x=last.x), cost[rows]

        with self.budget.timed("solver", (len(lobes.others) * steps + LAST_STEPS) * cost.numel()):
            write_by_tiles(answer, cost, found)
        return answer

    def _tried(self, photos: Observations, start: TexelEstimate, steps: int) -> Scored:
        found = stepped(self.scale.solver, photos, start, self.prior, steps)
        answer, cost = start._replace(x=found.x), found.data + found.prior
        if self.lobes:
            cost += self.lobes.improbability(self.scale.solver, photos, answer)
        return answer, cost

    def refused(self, answer: TexelEstimate) -> Tensor:
        """Places of the texels whose errors are too large for noise (chi-square test)."""
        from scipy.special import chdtri

        found, limit = [], chdtri(3 * len(self.photos.views), RARE)
        for rows in tiles(answer.x.shape[-1]):
            photos = self.photos.of_rows(rows)
            errors = stepped(self.scale.solver, photos, answer.rows(rows), self.prior, 0).data
            found.append(self.photos.places(rows)[errors > limit])
        return torch.cat(found).unique()

    def searched_further(self, answer: TexelEstimate, cost: Tensor,
                         starts: Callable[[TexelEstimate, Tensor], Sequence[TexelEstimate]]) -> Scored:
        """Search further for the texels that the photos refuse, while time is left; answer and its cost.

        Args:
            answer: of all texels; it is written into, and so is the cost.
            cost: of each, R x R.
            starts: gives starts of the texels at some places.
        """
        for _ in range(PASSES):
            refused, found, moved = self.refused(answer), list[tuple[Tensor, Scored]](), False
            for texels in refused.split(GROUP**2) if len(refused) else ():
                # always as many, so that one kernel serves all
                texels = torch.cat((texels, texels[-1:].expand(GROUP**2 - len(texels)))).reshape(GROUP, GROUP)
                photos, best = self.photos.of_texels(texels), (answer.of_texels(texels), cost.take(texels))
                tried = starts(answer, texels)
                if not self.budget.in_time(len(tried) * FURTHER_STEPS * texels.numel()):
                    moved = False
                    break
                first = best[1]
                for start in tried:
                    best = _better(*best, *self._tried(photos, start, FURTHER_STEPS))
                found.append((texels, best))
                moved |= bool((best[1] < first).any())
            for texels, (part, its) in found:
                answer.put_texels(texels, part)
                cost.put_(texels, its)
            if not moved:
                break
        return answer, cost


def write_by_tiles(answer: TexelEstimate, cost: Tensor, found: Callable[[slice], Scored]) -> None:
    """Write each tile's result into all texels, once no other tile starts from the tile's old texels."""
    side, waiting = len(cost), list[tuple[slice, Scored]]()
    near = 1 + side // COARSE // tile_rows(side)  # neighbouring tiles, each way, that hold starts of a tile

    def write(rows: slice, part: Scored) -> None:
        answer.put(rows, part[0])
        cost[rows] = part[1]

    for rows in tiles(side):
        waiting.append((rows, found(rows)))
        if len(waiting) > 2 * near + 1:
            write(*waiting.pop(near))
    for each in waiting:
        write(*each)


def _better(answer: TexelEstimate, cost: Tensor, other: TexelEstimate, its: Tensor) -> Scored:
    """Texels of an answer, or of another one where that costs less."""
    better = its < cost * (1 - LESS)
    return answer.where(better, other), torch.where(better, its, cost)
