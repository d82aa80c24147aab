"""How much noise to assume in photos of a phone at full size: the noise that predicts held-out photos well.

Renderings of real photos have errors that are not noise: misalignment, lobes unlike GGX, a flash with an
area. These errors repeat in neighbouring pixels and photos. So the errors of photos seen do not show how much
of a texel's detail belongs to the material; those of held-out photos do (cross-validation; Stone 1974).
Photos are held out in turn and predicted with the present views, at every k-th texel of full size. Of all
noises that predict equally well, the fit takes the least: it explains the photos seen best. Equally well
means within one standard error of the differences, photo by photo (Breiman et al. 1984).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from .solver import Observations, TexelSolver
from .starts import stepped, variances
from .texel_prior import TexelEstimate, TexelPrior

# In display values. With one photo held out, more noise is chosen than all photos need: 0.12 or 0.18 for six
# real captures. With 0.08, four of them predicted unseen photos as well or better, one 2 % worse and one 12 %
# worse; all six explained the photos seen better.
NOISES = (0.03, 0.05, 0.08)
# Fewest photos for cross-validation, and most that are held out in turn. Holding out four of seven was too
# few: by chance, too little noise was chosen, and two of eight captures had 1.13 and 1.03 times the error.
FEWEST, MOST = 4, 12
AGREED = 4  # rounds in which texels forget a photo that is held out
STEPS, ROUNDS = 6, 3  # Levenberg-Marquardt steps of a round; rounds, each of which ends with a new prior
TURN = AGREED * (STEPS + 1)  # steps of the solver to forget a photo; variances count as one


def in_turn(count: int) -> range:
    """Numbers of the photos held out in turn: all ``count``, or evenly spaced ones; none if too few."""
    return range(0, count if count >= FEWEST else 0, math.ceil(count / MOST))


def steps_of_turns(count: int) -> int:
    """Steps of the solver for the cross-validation of ``count`` photos."""
    return len(in_turn(count)) * (TURN + len(NOISES) * ROUNDS * (STEPS + 1))


def prediction_errors(photos: Observations, solver: TexelSolver, prior: TexelPrior,
                      starts: Mapping[int, TexelEstimate], noises: Sequence[float]) -> Tensor:
    """Mean squared errors of predicted photos, in display values: a row per noise, a column per photo.

    Args:
        photos: N photos; ``noises`` replace their noise, and ``robust`` scales with it.
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
    """The first row whose mean exceeds the lowest mean by at most one standard error of the differences.

    Args:
        errors: a row for each choice, a column for each photo; at least 2 columns.
    """
    more = errors - errors[errors.mean(dim=1).argmin()]
    return int((more.mean(dim=1) <= more.std(dim=1) / errors.shape[1]**0.5).int().argmax())
