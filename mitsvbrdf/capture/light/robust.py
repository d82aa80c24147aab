"""Robust statistics of residuals: their noise, the weight of each, and how many count as one."""

from __future__ import annotations

import numpy as np

from ..lens import Array

LEAST_LOG_NOISE = 0.002  # of log radiance
BELOW, ABOVE = 2.0, 3.0  # standard deviations from where residuals count less


def noise_of(error: Array, weights: Array) -> float:
    """Standard deviation of residuals that have company, from the weighted median of their size."""
    order = np.argsort(np.abs(error))
    half = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    return max(LEAST_LOG_NOISE, 1.4826 * float(np.abs(error)[order][min(half, len(error) - 1)]))


def trust_of(size: Array) -> Array:
    """Weights of residuals in deviations: 1 / |r| below (Huber 1981), 1 / r^4 above (Geman, McClure 1985)."""
    return np.where(size < 0, 1 / (np.abs(size) / BELOW).clip(1), 1 / (1 + (size / ABOVE) ** 2) ** 2)


def alike(error: Array, weights: Array, cell: np.ndarray) -> float:
    """How many residuals count as one: the mean square of sums over cells, over that of independent ones."""
    sums, squares = (np.bincount(cell, v) for v in (weights * error, (weights * error) ** 2))
    return max(1.0, float(np.square(sums).sum() / max(squares.sum(), 1e-30)))
