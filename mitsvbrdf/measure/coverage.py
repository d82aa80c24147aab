"""Are stated uncertainties true? Where the truth is known, errors over stated deviations say.

If errors were normal with the deviations stated, the rank of the truth in what was stated, Phi(-error /
deviation), would be uniform: simulation-based calibration (Talts et al. 2018), with one normal in place of
draws from a posterior.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

# deviations either way, and the share of a normal distribution in them
INTERVALS = {"within_68": 1.0, "within_95": 1.96}
BINS = 10  # of the ranks


def coverage(error: Tensor, deviation: Tensor) -> dict:
    """How often the truth lies in the intervals stated.

    Args:
        error: found minus true, any shape.
        deviation: stated standard deviations, of the same shape, above 0.

    Returns:
        ``within_68`` and ``within_95``, shares of the errors of at most 1 and 1.96 deviations; ``ranks``,
        shares of the truth's ranks in ten equal bins, the lowest first (a truth far below what was found has
        rank 0); ``rmse``; ``median_sd``.
    """
    z = (error / deviation).double().flatten()
    ranks = 0.5 * (1 + torch.erf(-z / math.sqrt(2)))
    counts = torch.histc(ranks, bins=BINS, min=0.0, max=1.0) / len(z)
    return {name: float((z.abs() <= reach).double().mean()) for name, reach in INTERVALS.items()} | {
        "ranks": counts.tolist(), "rmse": float(error.double().square().mean().sqrt()),
        "median_sd": float(deviation.median())}
