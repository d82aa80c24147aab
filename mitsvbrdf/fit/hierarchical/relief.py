"""How steep texels are: a mixture of normal distributions of slopes, learned from all texels.

Most of a surface may be flat while its edges are steep. A single width fits neither: it lets flat texels
tilt, and makes the true slope of a steep texel improbable. The shares of many widths are learned from all
texels (Kiefer and Wolfowitz 1956). Each texel then has a precision of its own, as in a scale mixture of
normal distributions (Andrews and Mallows 1974).
"""

from __future__ import annotations

import torch
from torch import Tensor

STEEPEST = 10.0  # largest slope of a normal: 84 degrees
WIDTHS = [0.005 * 2.0**k for k in range(11)]  # standard deviations of a slope
ROUNDS = 40  # of expectation-maximisation
NOBODY = 1e-6  # least share of a width
SAMPLED = 256  # most texels a side from which the shares are learned


class Relief:
    """The shares of :data:`WIDTHS` among texels; they sum to 1."""

    def __init__(self, share: Tensor) -> None:
        self.share = share

    @classmethod
    def learned(cls, x: Tensor, variance: Tensor, precision: Tensor) -> Relief:
        """The shares of maximum likelihood. The photos of a texel give a normal distribution of its slopes
        (Bovy et al. 2011).

        The prior is removed first: if photos determine a slope only weakly, the answer follows its prior.

        Args:
            x: slopes of the answer, 2 x R x R.
            variance: of these, given photos and prior.
            precision: of that prior, whose mean is 0.
        """
        step = -(-x.shape[-1] // SAMPLED)
        x, variance, precision = (part[:, ::step, ::step].flatten(1).double()
                                  for part in (x, variance, precision))
        told = (1 / variance - precision).clamp_min(0)
        pull = (x / variance).clamp(-STEEPEST * told, STEEPEST * told)
        spread = torch.tensor(WIDTHS).double().square()[:, None, None]
        wide = 1 + told * spread
        # log likelihood of each width, relative to that of a flat texel
        likely = (pull.square() * spread / wide - wide.log()).sum(dim=1) / 2
        likely, share = (likely - likely.amax(dim=0)).exp(), torch.full_like(likely[:, 0], 1 / len(WIDTHS))
        for _ in range(ROUNDS):
            mixed = share[:, None] * likely
            share = (mixed / mixed.sum(dim=0)).mean(dim=1).clamp_min(NOBODY)
        return cls(share / share.sum())

    def precision(self, square: Tensor) -> Tensor:
        """Precision of the normal distribution that replaces the mixture at these sums of squared slopes."""
        return sum((s / w**2 * _density(square, w) for s, w in self._widths), 0.0) / self._density(square)

    def improbability(self, square: Tensor) -> Tensor:
        """-2 log of the density at these sums of squares of two slopes, less 2 log 2 pi."""
        return -2 * self._density(square).log()

    @property
    def _widths(self) -> list[tuple[float, float]]:
        return list(zip(self.share.tolist(), WIDTHS, strict=True))

    def _density(self, square: Tensor) -> Tensor:
        return sum((s * _density(square, w) for s, w in self._widths), torch.zeros_like(square))


def _density(square: Tensor, width: float) -> Tensor:
    """Density at these sums of squares of two slopes, times 2 pi."""
    return torch.exp(-square / (2 * width**2)) / width**2
