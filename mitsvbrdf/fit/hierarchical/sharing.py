"""Evidence shared between texels that look alike: the prior of one texel is what the others say (empirical
Bayes).

A texel whose highlight no photo caught knows nothing of its specular level and roughness; texels of the same
stuff do. The model is hierarchical: a texel's number is that of its basis materials, plus a deviation of its
own with standard deviation tau. Each basis material has a tau of its own: gilt may vary where the wood around
it does not. From each texel's posterior the prior it had is divided out again, which leaves what its photos
alone say; the means of the basis materials are averages of that, weighted by how sure each texel is, and tau
follows by expectation-maximisation (Dempster et al. 1977; the division is that of expectation propagation,
Minka 2001).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ...material.maps import DIELECTRIC_F0

ROUNDS = 10  # of expectation-maximisation; tau changes by less than 1 % afterwards
LEAST_SPREAD = 0.01  # of tau; below it the common level moves too little a round
# a texel's own evidence counts as at most so far from its prior: divisions of small differences know no more
FARTHEST = 0.15
LEAST_EVIDENCE = 1.0  # precision below which photos say nothing of a number between 0 and 1
# mean and deviation of a material of which nothing is known
TYPICAL = {"specular": (DIELECTRIC_F0 ** (1 / 2.2), 0.05)}
UNKNOWN = 0.0, float("inf")
COMMON = 20.0  # texels whose worth the common spread counts as in that of each basis material
NOBODY = 1e-30


class Shared(NamedTuple):
    """What texels share: ``mean`` S x M of each number, the deviation ``tau`` S x M from it, and its
    ``spread`` S over all.
    """

    mean: Tensor
    tau: Tensor
    spread: Tensor


def shared(names: list[str], x: Tensor, variance: Tensor, prior_mean: Tensor, prior_precision: Tensor,
           member: Tensor, spread: Tensor, photos: int) -> Shared:
    """The prior that texels get from each other.

    Args:
        names: the map of each of the S numbers.
        x: posterior means, S x M.
        variance: posterior variances, S x M.
        prior_mean: of the prior that these had, S x M.
        prior_precision: the same.
        member: M x K, of :func:`mitsvbrdf.fit.hierarchical.appearance.membership`.
        spread: S, tau over all so far.
        photos: how many follow the model; 0: :data:`TYPICAL` does not count. It decides where photos leave a
            whole material open, as they do a broad lobe that looks like a diffuse one. It counts once for a
            basis material, and beside it its texels as many as there are photos: those that the same photos
            light err alike. Where photos do not follow the model it would weigh more than their highlights.
    """
    precision = (1 / variance - prior_precision).clamp_min(1e-3)  # of the photos alone
    alone = torch.where(precision > LEAST_EVIDENCE, (x / variance - prior_mean * prior_precision) / precision,
                        x)
    alone = torch.minimum(torch.maximum(alone, prior_mean - FARTHEST), prior_mean + FARTHEST).clamp(0, 1)
    usual, rare = torch.tensor([TYPICAL.get(name, UNKNOWN) if photos else UNKNOWN for name in names]).T[...,
                                                                                                        None]
    vague = (member.sum(dim=0) / max(photos, 1)).clamp_min(1) / rare.square()
    tau2 = spread.square()[:, None]
    for _ in range(ROUNDS):
        weight = 1 / (1 / precision + tau2)
        # A basis material of which no texel is any has weight 0, here and in the mean.
        basis = ((weight * alone) @ member + vague * usual) / (weight @ member + vague).clamp_min(NOBODY)
        mean = basis @ member.T
        own = 1 / (precision + 1 / tau2)
        off = own * (precision * alone + mean / tau2) - mean
        square = off.square() + own
        common = square.mean(dim=1, keepdim=True)
        tau2 = (square @ member + COMMON * common) / (member.sum(dim=0) + COMMON) @ member.T
    return Shared(mean, tau2.sqrt().clamp_min(LEAST_SPREAD), common[:, 0].sqrt().clamp_min(LEAST_SPREAD))
