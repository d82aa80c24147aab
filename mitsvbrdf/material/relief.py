"""The relief of a normal map: its heights, and how much of the sky each texel sees."""

import math

import torch
import torch.nn.functional as F
from scipy.fft import dctn, idctn
from torch import Tensor

from .resample import enlarged

STEEPEST = 10.0  # largest slope, 84 degrees: a normal in the plane would mean heights of hundreds of sides
DIRECTIONS = 16  # directions in which the horizon of a texel is computed
FINEST = 512  # most texels a side for occlusion; larger reliefs are reduced first, the result enlarged
FARTHEST = 0.25  # largest distance of a point that may hide the sky, in patch sides


def heights(normal: Tensor, periodic: bool = False) -> Tensor:
    """Heights whose slopes fit the normals in least squares: R x R in patch sides, mean 0.

    The slope between two neighbours is the mean of their slopes; across the border it is free. This is
    Poisson's equation with Neumann's condition, solved exactly by a cosine transform (Simchony, Chellappa and
    Shao 1990, after Frankot and Chellappa 1988). Slopes above :data:`STEEPEST` are clamped. In a periodic
    material the last texel continues in the first, and the mean slope is dropped.
    """
    size, z = len(normal), normal[..., 2].double().clamp_min(1 / STEEPEST)
    right, down = -normal[..., 0].double() / z / size, normal[..., 1].double() / z / size
    if periodic:
        between_right, between_down = (right + right.roll(-1, 1)) / 2, (down + down.roll(-1, 0)) / 2
        source = between_right - between_right.roll(1, 1) + between_down - between_down.roll(1, 0)
        waves = torch.fft.rfft2(source) / _laplacian(size, 2 * math.pi / size, size // 2 + 1)
        return torch.fft.irfft2(waves, (size, size))
    between_right, between_down = (right[:, 1:] + right[:, :-1]) / 2, (down[1:] + down[:-1]) / 2
    source = torch.zeros(size, size, dtype=torch.float64)
    source[:, :-1] += between_right
    source[:, 1:] -= between_right
    source[:-1] += between_down
    source[1:] -= between_down
    spectrum = torch.from_numpy(dctn(source.numpy(), overwrite_x=True))
    return torch.from_numpy(idctn((spectrum / _laplacian(size, math.pi / size)).numpy(), overwrite_x=True))


def _laplacian(rows: int, step: float, columns: int = 0) -> Tensor:
    """Eigenvalues of the discrete Laplacian for waves of rising frequency; infinity for the constant."""
    down, right = (2 * torch.cos(torch.arange(count, dtype=torch.float64) * step) - 2
                   for count in (rows, columns or rows))
    laplacian = down[:, None] + right
    laplacian[0, 0] = torch.inf
    return laplacian


def occlusion(height: Tensor, periodic: bool = False) -> Tensor:
    """Share of the light of a uniform sky that reaches each texel of a relief, R x R in [0, 1].

    The horizon in a direction is the steepest upward slope to any point within :data:`FARTHEST`. From
    there, a flat texel gets the share cos^2 (elevation of the horizon); the result is the mean over all.
    Heights are R x R in patch sides, row 0 at the top; outside they stay constant, or repeat if ``periodic``.

    Source: Bavoil, Sainz and Dimitrov 2008, "Image-space horizon-based ambient occlusion".
    """
    size = len(height)
    if size > FINEST:
        # Bilinear: area averages over alternately 1 and 2 texels would make steps.
        coarse = F.interpolate(height[None, None], (FINEST, FINEST), mode="bilinear", antialias=True)[0, 0]
        return enlarged(occlusion(coarse, periodic)[None], size)[0]
    rim = max(1, round(FARTHEST * size))
    around = F.pad(height[None, None], (rim,) * 4, mode="circular" if periodic else "replicate")[0, 0]
    seen = torch.zeros_like(height)
    for k in range(DIRECTIONS):
        angle = 2 * math.pi * k / DIRECTIONS
        horizon, steps = torch.zeros_like(height), set()
        for step in range(math.ceil(4 * math.log2(rim + 1)) + 1):  # four for each doubling of the distance
            far = min(2 ** (step / 4), rim)
            steps.add((round(far * math.sin(angle)), round(far * math.cos(angle))))
        for down, right in steps:
            there = around[rim + down:rim + down + size, rim + right:rim + right + size]
            horizon = torch.maximum(horizon, (there - height) * (size / math.hypot(down, right)))
        seen += 1 / (1 + horizon.square())
    return seen / DIRECTIONS
