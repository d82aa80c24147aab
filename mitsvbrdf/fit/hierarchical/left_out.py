"""How far each photo of a phone is to be believed at full size: as far as it helps to predict the others.

What a rendering misses in real photos is no noise: alignment, lobes that are no GGX, light that is no point. It repeats in
neighbouring pixels and photos, so what is left unexplained does not tell how much of a texel's detail is the material's. Photos
that a fit did not see tell (cross-validation; Stone 1974): each is left out in turn and predicted with the views as they are,
at every k-th texel of full size, and of all noises that predict equally well the least is taken, by which the photos seen are
explained best (one standard error as in Breiman et al. 1984, of differences between the same photos).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from .solver import Observations, TexelSolver
from .starts import stepped
from .ties import LEAST_PRECISION, Answer, Ties

NOISES = (0.03, 0.05, 0.08, 0.12, 0.18)  # of display values; above the last, only diffuse maps keep detail
FEWEST = 4  # photos; of fewer, none can be spared
STEPS, ROUNDS = 6, 3  # of Levenberg-Marquardt, and of these with the freedom that texels took


def prediction_errors(photos: Observations, solver: TexelSolver, ties: Ties, starts: Sequence[Answer],
                      noises: Sequence[float]) -> Tensor:
    """Mean squared error of each photo's display values, predicted from the other photos: one row for each noise.

    Args:
        photos: N photos; their own noise does not matter, the ratio of ``robust`` to it stays.
        solver: of their texels.
        ties: of the fit.
        starts: N answers, each found without that photo, with texels that may leave it (:meth:`Ties.free`).
        noises: to try.
    """
    errors = torch.zeros(len(noises), len(starts))
    for k, start in enumerate(starts):
        others, alone = photos.without(k), replace(photos.pick([k]), noise=1.0, robust=None)
        for row, noise in enumerate(noises):
            robust = None if photos.robust is None else photos.robust / photos.noise * noise
            told, answer = replace(others, noise=noise, robust=robust), start
            for _ in range(ROUNDS):
                answer = answer._replace(x=stepped(solver, told, answer, ties, STEPS).x)
                answer = ties.loosen(answer, solver.variances(told, answer.x, answer.precision + LEAST_PRECISION))
            errors[row, k] = solver.normal_equations(alone, answer.x)[0].mean() / 3
    return errors


def least_as_good(errors: Tensor) -> int:
    """The first row of which the mean is within one standard error of the lowest: of its differences, column by column.

    Args:
        errors: rows to choose from x columns to compare them in, at least 2.
    """
    more = errors - errors[errors.mean(dim=1).argmin()]
    return int((more.mean(dim=1) <= more.std(dim=1) / errors.shape[1]**0.5).int().argmax())
