"""Which texels look alike: the texels that may share what the photos say about specular and roughness."""

from __future__ import annotations

import math

import cv2
import torch
import torch.nn.functional as F
from torch import Tensor

from ... import color
from ...capture import Capture
from ...capture.guess import over
from ...views import geometry

KMEANS_ROUNDS, KMEANS_STARTS = 30, 1


def appearance_of(capture: Capture, guess: Tensor) -> Tensor:
    """What a texel looks like whatever the light: M x 5, about 0 to 0.5 each.

    Its apparent albedo (falloff and cosine undone) without its darkest quarter and its brighter half, which
    hold shadows and highlights: chroma, a quarter of it, and lightness, half of it; and half the lightness of
    the guess.

    Args:
        capture: N photos with their views.
        guess: guessed diffuse map, R x R x 3.
    """
    _, _, irradiance = geometry(capture.views, capture.resolution)
    albedo = over(math.pi * capture.linear, irradiance).flatten(1, 2).transpose(0, 1)  # M x N x 3
    order, count = albedo.mean(dim=-1).argsort(dim=1), len(capture)
    middle = order[:, count // 4:max(count // 4 + 1, 3 * count // 4), None].expand(-1, -1, 3)
    encoded = color.encode(albedo.gather(1, middle).mean(dim=1).clamp(1e-4, 10))
    lightness = encoded.mean(dim=1, keepdim=True)
    chroma = encoded / lightness.clamp_min(0.02) - 1
    return torch.cat((chroma / 4, lightness / 2,
                      color.encode(guess.reshape(-1, 3).mean(dim=1, keepdim=True)) / 2), dim=1)


def basis_materials(appearance: Tensor, count: int, seed: int) -> Tensor:
    """The appearance of at most ``count`` basis materials, K x 5: k-means, which depends on the seed alone.

    Args:
        appearance: of M texels, M x 5 (:func:`appearance_of`).
        count: K; fewer where there are fewer texels.
        seed: of k-means.
    """
    cv2.setRNGSeed(seed % 2**31)
    count = min(count, len(appearance))
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, KMEANS_ROUNDS, 1e-4)
    _, _, centres = cv2.kmeans(appearance.numpy(), count, None, stop, KMEANS_STARTS, cv2.KMEANS_PP_CENTERS)
    return torch.from_numpy(centres)


def membership(appearance: Tensor, basis: Tensor, width: float) -> Tensor:
    """How much of each basis material a texel is, M x K, rows that sum to 1: normal kernels of this standard
    deviation.

    Args:
        appearance: of M texels, M x 5.
        basis: of :func:`basis_materials`, K x 5.
        width: the standard deviation.
    """
    return F.softmax(-torch.cdist(appearance, basis).square() / (2 * width**2), dim=1)
