"""Where to start from: other starts of a texel in each round, and other starts of the whole fit.

Texels that share a roughness hold each other in it, be it right or wrong: which of two answers a fit of all
of them ends in can hang on the last bits. A start whose lobe is far narrower or wider decides such cases by
how probable its answer is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from ..checkpoint import part
from .solver import Observations, Solved, TexelSolver
from .texel_prior import TexelEstimate, TexelPrior

DAMPING = 0.01  # that Levenberg-Marquardt starts with
LESS = 1e-3  # share of its cost that a texel must save to take another start
# slopes tried as starts, and the turn from one to the next
TILTS, GOLDEN = (0.15, 0.4, 0.8), math.pi * (3 - math.sqrt(5))


def stepped(solver: TexelSolver, observations: Observations, answer: TexelEstimate, prior: TexelPrior,
            count: int) -> Solved:
    """Levenberg-Marquardt steps of every texel from an estimate, within bounds and with its prior."""
    return solver.solve(observations, answer.x, torch.full_like(answer.x[0], DAMPING), answer.mean,
                        answer.precision, prior.low, prior.high, count)


def other_starts(prior: TexelPrior, turn: int) -> list[Callable[[TexelEstimate], TexelEstimate]]:
    """Starts from two neighbours and two tilts; others in each turn."""
    starts: list[Callable[[TexelEstimate], TexelEstimate]] = [
        partial(_neighbour, by=1 if turn % 2 else -1, axis=axis) for axis in (1, 2)]
    if len(prior.slopes):
        starts += [partial(_tilted, prior=prior, steep=TILTS[turn % len(TILTS)], along=GOLDEN * turn
                           + half_turn) for half_turn in (0.0, math.pi)]
    return starts


def _neighbour(answer: TexelEstimate, by: int, axis: int) -> TexelEstimate:
    return answer._replace(x=torch.roll(answer.x, by, axis).contiguous())


def _tilted(answer: TexelEstimate, prior: TexelPrior, steep: float, along: float) -> TexelEstimate:
    x = answer.x.clone()
    x[prior.shared] = answer.mean[prior.shared]
    x[prior.slopes] = torch.tensor([steep * math.cos(along), steep * math.sin(along)])[:, None, None]
    return answer._replace(x=x)


class MultiStart:
    """The most probable answer of the starts tried so far."""

    def __init__(self) -> None:
        self.best: TexelEstimate | None = None
        self.cost = torch.tensor(torch.inf)

    @staticmethod
    def start(answer: TexelEstimate, trial: int, prior: TexelPrior) -> TexelEstimate:
        """A start like another, with lobes far narrower (the first trial) or wider (the second)."""
        x, mean, lobe = answer.x.clone(), answer.mean.clone(), prior.unknowns.of("roughness")
        x[lobe] = prior.bounded((x[lobe] / 2, (1 + x[lobe]) / 2)[trial - 1], lobe)
        mean[lobe] = x[lobe]
        return answer._replace(x=x, mean=mean)

    def keep(self, answer: TexelEstimate, solver: TexelSolver, observations: Observations,
             prior: TexelPrior) -> None:
        """Keep this answer where the photos make it more probable than those of the starts before.

        Compared is -2 log of the marginal likelihood (Laplace's approximation): the cost, and by how much the
        photos narrow the prior. The cost alone takes an answer that explains photos less well for a better
        one where its prior is narrower.
        """
        found = stepped(solver, observations, answer, prior, 0)
        _, narrowed = solver.posterior(observations, answer.x, answer.precision)
        cost = (found.data + found.prior + narrowed - answer.precision.log().sum(dim=0)).mean()
        if self.best is None or cost < self.cost:
            self.best, self.cost = answer, cost

    def take(self, otherwise: TexelEstimate) -> TexelEstimate:
        """The best answer, kept no longer; where none was, another."""
        best = otherwise if self.best is None else self.best
        self.best = None
        return best

    def state(self) -> dict[str, Tensor]:
        """Everything :meth:`load_state` needs."""
        if self.best is None:
            return {}
        return {f"winner.{name}": value for name, value in (self.best._asdict()
                                                            | {"cost": self.cost}).items()}

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state."""
        saved = part(state, "winner.")
        self.cost = saved.pop("cost", torch.tensor(torch.inf))
        self.best = TexelEstimate(**saved) if saved else None
