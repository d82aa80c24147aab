"""Steps of all texels from a start, and other starts in each round."""

import math
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from .solver import Observations, Solved, TexelSolver
from .texel_prior import LEAST_PRECISION, TexelEstimate, TexelPrior

DAMPING = 0.01  # first damping of Levenberg-Marquardt
LESS = 1e-3  # share of its cost that a texel must save to take another start
# slopes tried as starts, and the angle by which their direction turns in each round
TILTS, GOLDEN = (0.15, 0.4, 0.8), math.pi * (3 - math.sqrt(5))


def stepped(solver: TexelSolver, observations: Observations, answer: TexelEstimate, prior: TexelPrior,
            count: int) -> Solved:
    """Levenberg-Marquardt steps of every texel from an estimate, within bounds and with its prior."""
    answer = prior.whole(answer)
    return solver.solve(observations, answer.x, torch.full_like(answer.x[0], DAMPING), answer.mean,
                        answer.precision, prior.low, prior.high, count)


def variances(solver: TexelSolver, observations: Observations, answer: TexelEstimate) -> Tensor:
    """Variances of the unknowns, given photos and prior, U x R x R."""
    return solver.variances(observations, answer.x, (answer.once() + LEAST_PRECISION).expand_as(answer.x))


# gives the start of some rows of texels; the first argument holds all texels
Start = Callable[[TexelEstimate, slice], TexelEstimate]


def other_starts(prior: TexelPrior, turn: int) -> list[Start]:
    """Starts from two neighbours and two tilts, which change with ``turn``."""
    by = 1 if turn % 2 else -1
    starts: list[Start] = [partial(TexelEstimate.rows, down=by), partial(TexelEstimate.rows, right=by)]
    if len(prior.slopes):
        starts += [partial(_tilted, prior=prior, steep=TILTS[turn % len(TILTS)],
                           along=GOLDEN * turn + half_turn) for half_turn in (0.0, math.pi)]
    return starts


def _tilted(answer: TexelEstimate, rows: slice, prior: TexelPrior, steep: float,
            along: float) -> TexelEstimate:
    return tilted(answer.rows(rows), prior, steep, along)


def tilted(answer: TexelEstimate, prior: TexelPrior, steep: float, along: float) -> TexelEstimate:
    """Texels of slope ``steep`` towards the angle ``along``; shared numbers are the means of their prior."""
    x = answer.x.clone()
    x[prior.shared] = prior.whole(answer).mean[prior.shared]
    x[prior.slopes] = torch.tensor([steep * math.cos(along), steep * math.sin(along)])[:, None, None]
    return answer._replace(x=x)
