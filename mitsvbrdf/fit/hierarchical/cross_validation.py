"""How much noise to assume in photos of a phone at full size: the noise that predicts held-out photos well.

Renderings of real photos have errors that are no noise: alignment, lobes that are no GGX, light that is no
point. They repeat in neighbouring pixels and photos, so the errors of photos seen do not tell how much of a
texel's detail is the material's. Photos that a fit did not see tell this (cross-validation; Stone 1974). Each
is held out in turn and predicted with the present views, at every k-th texel of full size. Of all noises that
predict equally well, the fit takes the least, which explains the photos seen best. Equally well means within
one standard error of the differences between the same photos (Breiman et al. 1984).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from .solver import Observations, TexelSolver
from .starts import stepped, variances
from .texel_prior import TexelEstimate, TexelPrior

# Of display values. A fit without one photo asks for more noise than all photos need: six real captures asked
# for 0.12 or 0.18. With 0.08, four of them predicted photos that no fit saw as well or better, one 2 % worse
# and one 12 %, and all explained the photos seen better.
NOISES = (0.03, 0.05, 0.08)
# Fewest photos of which one can be held out, and most that are held out in turn. Four of seven were too few:
# by chance less noise was chosen, and two captures of eight were predicted worse (1.13 and 1.03 times).
FEWEST, MOST = 4, 12
AGREED = 4  # rounds in which texels forget a photo that is held out
STEPS, ROUNDS = 6, 3  # Levenberg-Marquardt steps of a round; rounds, which end by setting texels' freedom
TURN = AGREED * (STEPS + 1)  # steps of the solver to forget a photo; variances count as one


def in_turn(count: int) -> range:
    """Which of ``count`` photos are held out in turn: all, or evenly spaced ones; none of too few."""
    return range(0, count if count >= FEWEST else 0, math.ceil(count / MOST))


def steps_of_turns(count: int) -> int:
    """Steps of the solver for the cross-validation of so many photos."""
    return len(in_turn(count)) * (TURN + len(NOISES) * ROUNDS * (STEPS + 1))


def prediction_errors(photos: Observations, solver: TexelSolver, prior: TexelPrior,
                      starts: Mapping[int, TexelEstimate], noises: Sequence[float]) -> Tensor:
    """Mean squared errors of display values, each photo predicted from all others: a row for each noise.

    Args:
        photos: N photos; ``noises`` replace their noise, and the ratio of ``robust`` to it stays.
        starts: photo -> answer found without this photo; texels may leave it (:meth:`TexelPrior.free`).
    """
    errors = torch.zeros(len(noises), len(starts))
    for column, (photo, start) in enumerate(starts.items()):
        others, alone = photos.without(photo), replace(photos.pick([photo]), noise=1.0, robust=None)
        for row, noise in enumerate(noises):
            robust = None if photos.robust is None else photos.robust / photos.noise * noise
            told, answer = replace(others, noise=noise, robust=robust), start
            for _ in range(ROUNDS):
                answer = answer._replace(x=stepped(solver, told, answer, prior, STEPS).x)
                answer = prior.loosen(answer, variances(solver, told, answer))
            errors[row, column] = solver.normal_equations(alone, answer.x)[0].mean() / 3
    return errors


def least_as_good(errors: Tensor) -> int:
    """The first row whose mean is above the lowest by at most one standard error of differences by column.

    Args:
        errors: rows to choose from x columns to compare them in, at least 2.
    """
    more = errors - errors[errors.mean(dim=1).argmin()]
    return int((more.mean(dim=1) <= more.std(dim=1) / errors.shape[1]**0.5).int().argmax())
