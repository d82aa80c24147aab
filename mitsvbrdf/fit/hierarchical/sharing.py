"""Evidence shared by texels that look alike: a texel's prior comes from the others (empirical Bayes).

If no photo shows a texel's highlight, its photos do not determine its specular and roughness; texels of the
same material may do so. The model is hierarchical: a number of a texel is that of its basis materials
(clusters of similar texels) plus its own deviation, of standard deviation tau. Each basis material has its
own tau: gilt may vary while the wood around it does not. The posterior of a texel divided by its prior is the
evidence of its photos alone (as in expectation propagation, Minka 2001). The means of the basis materials are
precision-weighted averages of this evidence. Tau follows by expectation-maximisation (Dempster et al. 1977).
"""

import math
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import color
from ...capture import Capture
from ...capture.guess import over
from ...material.maps import DIELECTRIC_F0
from ...views import STRIP, geometry, strips

KMEANS_ROUNDS, KMEANS_STARTS = 30, 1
ROUNDS = 10  # of expectation-maximisation; tau changes by less than 1 % afterwards
LEAST_SPREAD = 0.01  # least tau; below it the common level moves too little in a round
# largest distance of a texel's own evidence from its prior: the quotient of small differences is inexact
FARTHEST = 0.15
LEAST_EVIDENCE = 1.0  # precision below which photos do not determine a number between 0 and 1
# mean and standard deviation of a number of a material of which nothing is known
TYPICAL = {"specular": (DIELECTRIC_F0 ** (1 / 2.2), 0.05)}
UNKNOWN = 0.0, float("inf")
COMMON = 20.0  # the mean spread over all texels counts as this many texels in that of each basis material
NOBODY = 1e-30


def appearance_of(capture: Capture, guess: Tensor) -> Tensor:
    """The appearance of each texel, whatever the light: M x 5, about -0.25 to 0.5 each.

    Chroma / 4 (three numbers) and lightness / 2 of its mean apparent albedo (falloff and cosine undone), and
    lightness / 2 of the guess. The mean omits the darkest and the brightest quarter of the photos, because
    of shadows and highlights.

    Args:
        capture: N photos with their views.
        guess: guessed diffuse map, R x R x 3.
    """
    side = capture.resolution
    look = torch.empty(side, side, 5)  # many small parts would leave gaps in memory when they are freed
    for rows in strips(side):
        look[rows] = _appearance(capture, guess, rows).reshape(-1, side, 5)
    return look.flatten(0, 1)


def _appearance(capture: Capture, guess: Tensor, rows: slice) -> Tensor:
    _, _, irradiance = geometry(capture.views, capture.resolution, rows)
    linear = color.decode(color.shown(capture.stored[:, rows]), capture.transfer)
    albedo = over(math.pi * linear, irradiance).flatten(1, 2).transpose(0, 1)  # M x N x 3
    order, count = albedo.mean(dim=-1).argsort(dim=1), len(capture)
    middle = order[:, count // 4:max(count // 4 + 1, 3 * count // 4), None].expand(-1, -1, 3)
    encoded = color.encode(albedo.gather(1, middle).mean(dim=1).clamp(1e-4, 10))
    lightness = encoded.mean(dim=1, keepdim=True)
    chroma = encoded / lightness.clamp_min(0.02) - 1
    return torch.cat((chroma / 4, lightness / 2,
                      color.encode(guess[rows].reshape(-1, 3).mean(dim=1, keepdim=True)) / 2), dim=1)


def basis_materials(appearance: Tensor, count: int, seed: int) -> Tensor:
    """The appearance of at most ``count`` basis materials, K x 5, by k-means; ``seed`` fixes its choices.

    Args:
        appearance: of M texels, M x 5 (:func:`appearance_of`).
        count: K; fewer if there are fewer texels.
    """
    import cv2

    cv2.setRNGSeed(seed % 2**31)
    count = min(count, len(appearance))
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, KMEANS_ROUNDS, 1e-4)
    rows = appearance.expand(max(2, len(appearance)), -1).contiguous()  # one row would be read as a column
    _, _, centres = cv2.kmeans(rows.numpy(), count, None, stop, KMEANS_STARTS, cv2.KMEANS_PP_CENTERS)
    return torch.from_numpy(centres)


def membership(appearance: Tensor, basis: Tensor, width: float) -> Tensor:
    """Share of each basis material in each texel, M x K, rows sum to 1: Gaussian kernels of this ``width``.

    Args:
        appearance: of M texels, M x 5.
        basis: of :func:`basis_materials`, K x 5.
        width: standard deviation of the kernels.
    """
    return torch.cat([F.softmax(-torch.cdist(part, basis).square() / (2 * width**2), dim=1)
                      for part in appearance.split(STRIP)])


class Shared(NamedTuple):
    """Prior of shared numbers: ``mean`` and deviation ``tau``, S x M; ``spread``, S: tau over all texels."""

    mean: Tensor
    tau: Tensor
    spread: Tensor


def shared(names: list[str], x: Tensor, variance: Tensor, prior_mean: Tensor, prior_precision: Tensor,
           members: Callable[[], Iterable[Tensor]], spread: Tensor, photos: int) -> Shared:
    """The prior that texels get from each other.

    Args:
        names: the map of each of the S numbers.
        x: posterior means, S x M.
        variance: posterior variances, S x M.
        prior_mean: mean of the prior that led to these, S x M.
        prior_precision: its precision (1 / variance), S x M.
        members: gives M x K, of :func:`membership`, in parts of :data:`STRIP` texels.
        spread: tau over all texels so far, S.
        photos: number of photos if they follow the model; 0 if not: :data:`TYPICAL` is then not used. TYPICAL
            decides if photos do not determine a whole material: a broad lobe may look diffuse. It counts as
            one texel. All texels of a basis material count as ``photos`` texels: texels in the same photos
            have similar errors. If photos do not follow the model, TYPICAL would outweigh highlights.
    """
    def alone() -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """In parts: membership; precision of the estimate by photos alone; this estimate."""
        numbers = zip(*(each.split(STRIP, dim=1) for each in (x, variance, prior_mean, prior_precision)))
        for member, (here, its, mean, known) in zip(members(), numbers):
            precision = (1 / its - known).clamp_min(1e-3)
            told = torch.where(precision > LEAST_EVIDENCE, (here / its - mean * known) / precision, here)
            yield member, precision, torch.minimum(torch.maximum(told, mean - FARTHEST),
                                                   mean + FARTHEST).clamp(0, 1)

    usual, rare = torch.tensor([(TYPICAL if photos else {}).get(n, UNKNOWN) for n in names]).T[..., None]
    count = sum((member.sum(dim=0) for member in members()), torch.zeros(()))
    vague = (count / max(photos, 1)).clamp_min(1) / rare.square()
    each: Tensor | None = None  # tau^2 of the basis materials, S x K

    def tau2(member: Tensor) -> Tensor:
        return spread.square()[:, None] if each is None else each @ member.T

    for _ in range(ROUNDS):
        weighted, weights, square, squares = (torch.zeros(()) for _ in range(4))
        for member, precision, told in alone():
            weight = 1 / (1 / precision + tau2(member))
            weighted, weights = weighted + (weight * told) @ member, weights + weight @ member
        # A basis material that no texel has gets weight 0, here and in the mean.
        basis = (weighted + vague * usual) / (weights + vague).clamp_min(NOBODY)
        for member, precision, told in alone():
            mean, before = basis @ member.T, tau2(member)
            own = 1 / (precision + 1 / before)
            off = (own * (precision * told + mean / before) - mean).square() + own
            square, squares = square + off @ member, squares + off.sum(dim=1, keepdim=True)
        common = squares / x.shape[1]
        each = (square + COMMON * common) / (count + COMMON)
    mean = torch.cat([basis @ member.T for member in members()], dim=1)
    tau = torch.cat([tau2(member) for member in members()], dim=1)
    return Shared(mean, tau.sqrt().clamp_min(LEAST_SPREAD), common[:, 0].sqrt().clamp_min(LEAST_SPREAD))
