"""The brushes of made materials: noise, cell borders, bevels, masks and layers on R x R grids.

Coordinates are patch sides around the centre; a :class:`Paint` becomes maps by :func:`painted`.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Generator, Tensor

from .maps import SVBRDF

Colour = tuple[float, float, float]

# No bevel is steeper than 30 degrees: a flash near the lens hardly lights what turns further away.
STEEPEST = math.tan(math.radians(30))


def painted(paint: Paint) -> SVBRDF:
    """The maps of a painted material at its resolution, cut as :func:`make_material` says."""
    down, right = torch.gradient(paint.height, spacing=1 / len(paint.height))
    slope = torch.stack((right, -down), dim=-1)
    slope = slope * (STEEPEST / slope.norm(dim=-1, keepdim=True).clamp_min(STEEPEST))
    specular = paint.specular.clamp(0.02, 0.95)
    return SVBRDF("roughconductor", {
        "diffuse": torch.minimum(paint.diffuse.clamp(0, 0.95), 1 - specular), "specular": specular,
        "roughness": paint.roughness.clamp(0.08, 1),
        "normal": F.normalize(torch.cat((-slope, torch.ones_like(slope[..., :1])), dim=-1), dim=-1)})


Value = Tensor | float | tuple[float, ...]


class Paint:
    """A material painted layer over layer on a flat black ground of the size of ``x``."""

    def __init__(self, x: Tensor) -> None:
        self.height, self.roughness = torch.zeros_like(x), torch.zeros_like(x)[..., None]
        self.diffuse = self.specular = self.roughness.expand(*x.shape, 3)

    def add(self, mask: Tensor | float, diffuse: Value, specular: Value, roughness: Value,
            height: Tensor | float) -> Paint:
        """Cover by ``mask`` (R x R); values are numbers, colours, R x R or R x R x 3."""
        mask = torch.as_tensor(mask).expand_as(self.height)
        for name, new in {"diffuse": diffuse, "specular": specular, "roughness": roughness}.items():
            new = torch.as_tensor(new)
            new = new[..., None] if new.shape == mask.shape else new
            setattr(self, name, torch.lerp(getattr(self, name), new, mask[..., None]))
        self.height = self.height + mask * (height - self.height)
        return self


def noise(x: Tensor, y: Tensor, cells: int, rng: Generator, octaves: int = 4) -> Tensor:
    """Fractal value noise at x, y (patch sides): R x R, mean near 0, mostly within [-1, 1].

    Each octave doubles the random values along a patch side (``cells`` in the first) and halves their
    strength.
    """
    grid = 2 * torch.stack((x, y), dim=-1)[None]
    values = [torch.rand(1, 1, cells << i, cells << i, generator=rng) * 2 - 1 for i in range(octaves)]
    return sum(F.grid_sample(v, grid, "bicubic", "reflection", align_corners=False)[0, 0] / 2**i
               for i, v in enumerate(values))


def cell_borders(x: Tensor, y: Tensor, n: int, rng: Generator) -> Tensor:
    """Distance to the border of a Worley cell, of n x n: half the difference to the second seed."""
    seeds = torch.rand(n + 2, n + 2, 2, generator=rng)
    u, v = (x.clamp(-0.499, 0.499) + 0.5) * n, (y.clamp(-0.499, 0.499) + 0.5) * n
    i, j = u.long(), v.long()
    around = [(a, b, seeds[j + b + 1, i + a + 1]) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    distances = torch.stack([torch.hypot(i + a + s[..., 0] - u, j + b + s[..., 1] - v) for a, b, s in around])
    nearest, second = distances.topk(2, dim=0, largest=False).values
    return (second - nearest) / 2


def inside(distance: Tensor, soft: float = 0.003) -> Tensor:
    """A mask of where a signed distance is negative, with an edge ``soft`` wide."""
    return (0.5 - distance / soft).clamp(0, 1)


def bevel(distance: Tensor, width: float) -> Tensor:
    """A ramp from 0 at the edge of a shape to 1 at ``width`` inside."""
    return (-distance / width).clamp(0, 1)


def mix(first: Colour, second: Colour, share: Tensor) -> Tensor:
    """A colour between two, R x R x 3."""
    return torch.lerp(torch.tensor(first), torch.tensor(second), share.clamp(0, 1)[..., None])


def star(x: Tensor, y: Tensor, points: int, outer: float, inner: float, turn: float = 0.0) -> Tensor:
    """Distance to the edge of a star with these two radii, negative inside."""
    half = math.pi / points
    angle, r = (torch.atan2(y, x) - turn + half).remainder(2 * half) - half, torch.hypot(x, y)
    run, rise = outer - inner * math.cos(half), inner * math.sin(half)
    return ((r * torch.cos(angle) - outer) * rise + r * torch.sin(angle).abs() * run) / math.hypot(run, rise)
