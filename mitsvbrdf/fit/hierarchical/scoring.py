"""The cost of each texel's answer, and a further search if its errors are too large for noise.

Most texels converge from the usual starts. Some do not: a texel whose normal turned away from the light
explains its photos a thousand times worse than noise allows, and stays there. A test against the noise finds
these texels. Only they are searched from more starts with more steps (multi-start; Martí et al. 2018).
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

RARE = 1e-6  # an answer is refused if noise alone would cause its errors with less than this probability
FURTHER_STEPS, PASSES = 20, 3  # of the further search: steps from each start, passes over refused texels
GROUP = 64  # texels a side of a square in which refused texels are searched together

Scored = tuple[TexelEstimate, Tensor]  # an answer, and what each texel costs, R x R


@dataclass(frozen=True, eq=False)
class Scoring:
    """The costs of texels in a round; the texels may share lobes."""

    scale: Scale
    photos: Observations
    prior: TexelPrior
    lobes: SharedLobes | None
    budget: TimeBudget

    def scored(self, answer: TexelEstimate, steps: int, start: Start = TexelEstimate.rows,
               cost: Tensor | None = None) -> Scored:
        """The answer after some steps from a start, and the cost of each texel; computed by tiles.

        Args:
            answer: all texels. Results are written into ``answer`` and ``cost``.
            start: gives the start of some rows of the answer.
            cost: of the answer, R x R. Texels stay as they are if it would not fall. None: all change.
        """
        def found(rows: slice) -> Scored:
            tried = self._tried(self.photos.of_rows(rows), start(answer, rows), steps)
            return tried if cost is None else _better(answer.rows(rows), cost[rows], *tried)

        least = torch.empty_like(answer.x[0]) if cost is None else cost
        with self.budget.timed("solver", steps * least.numel()):
            write_by_tiles(answer, least, found)
        return answer, least

    def averaged(self, lobes: SharedLobes, answer: TexelEstimate, cost: Tensor, steps: int) -> TexelEstimate:
        """Average texels over likely lobes, then take the last steps; written into ``answer`` by tiles."""
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
        """Places (row-major indices) of texels whose errors are too large for noise (chi-square test)."""
        from scipy.special import chdtri

        found, limit = [], chdtri(3 * len(self.photos.views), RARE)
        for rows in tiles(answer.x.shape[-1]):
            photos = self.photos.of_rows(rows)
            errors = stepped(self.scale.solver, photos, answer.rows(rows), self.prior, 0).data
            found.append(self.photos.places(rows)[errors > limit])
        return torch.cat(found).unique()

    def searched_further(self, answer: TexelEstimate, cost: Tensor,
                         starts: Callable[[TexelEstimate, Tensor], Sequence[TexelEstimate]]) -> Scored:
        """Search further for :meth:`refused` texels while time is left; returns the answer and its costs.

        Args:
            answer: all texels. Results are written into ``answer`` and ``cost``.
            cost: of each texel, R x R.
            starts: gives starts of the texels at some places.
        """
        for _ in range(PASSES):
            refused, found, moved = self.refused(answer), list[tuple[Tensor, Scored]](), False
            for texels in refused.split(GROUP**2) if len(refused) else ():
                # always the same number, so that one kernel serves all
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
    """Write each tile's result into all texels, once no later tile needs the tile's old texels as starts."""
    side, waiting = len(cost), list[tuple[slice, Scored]]()
    near = 1 + side // COARSE // tile_rows(side)  # neighbouring tiles, each way, that have starts of a tile

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
    """Each texel of an answer, or of ``other`` if it costs less there; and the costs."""
    better = its < cost * (1 - LESS)
    return answer.where(better, other), torch.where(better, its, cost)
