"""How evenly each photo is lit: 0 where light falls off as a flash's, 1 where only the room's light is.

Each photo's log radiance, less what the other photos say of its texels, is set against the pattern a flash
would make.
"""

from __future__ import annotations

import math

import numpy as np

from ..lens import Array
from .problem import Problem
from .robust import noise_of, trust_of

EVEN = 0.5  # evenness from which a photo takes no part
SURE = 0.2  # standard deviation up to which evenness counts as measured


def evenness_of(problem: Problem, unknowns: Array, weights: Array, gloss: Array) -> dict[str, float]:
    """1 - slope of each photo's log radiance, less what others say of its texels, over a flash's pattern."""
    samples, pattern = problem.samples, problem.falloff(unknowns) + gloss
    own = samples.weight * problem.away(unknowns)
    weights = np.minimum(weights, own)
    others = samples.log - problem.model(unknowns) - gloss
    total, found = np.bincount(samples.texel, weights), {}
    for number, name in enumerate(samples.names):
        at = samples.photo == number
        mine = np.bincount(samples.texel[at], (weights * others)[at], len(total))
        rest = total - np.bincount(samples.texel[at], weights[at], len(total))
        albedo = (np.bincount(samples.texel, weights * others) - mine) / rest.clip(1e-12)
        there = at & (rest > 0.1)[samples.texel]
        found[name] = _flatness(pattern[there], (others - albedo[samples.texel])[there], own[there],
                                samples.cell[there])
    return found


def _flatness(pattern: Array, error: Array, weights: Array, cell: np.ndarray) -> float:
    """- slope of errors over the pattern, robust, in [0, 1]; 0 where its standard deviation is above SURE."""
    if len(pattern) < 20:
        return 0.0
    found = min((_line(pattern, error, weights, cell, start) for start in (0.0, -1.0)),
                key=lambda line: line[2])
    return min(1.0, max(0.0, -found[0])) if found[1] < SURE else 0.0


def _line(x: Array, y: Array, weights: Array, cell: np.ndarray, slope: float) -> tuple[float, float, float]:
    """A robust line: its slope, the standard deviation of that, and of the rest. It starts from ``slope``."""
    for _ in range(5):
        rest = y - slope * x
        rest = rest - np.median(rest)
        noise = noise_of(rest, weights)
        trust = weights * trust_of(rest / noise)
        aside = x - np.average(x, weights=trust)
        spread = max(float((trust * aside**2).sum()), 1e-12)
        slope = float((trust * aside * y).sum()) / spread
    rest = y - slope * x
    rest = rest - np.average(rest, weights=trust)
    sums = np.bincount(cell, trust * aside * rest)
    deviation = math.sqrt(float(np.square(sums).sum())) / spread if spread > 1e-9 else math.inf
    return slope, deviation, noise_of(rest, weights)
