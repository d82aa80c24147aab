"""The robust start: guessed diffuse, one specular level and one roughness for all texels, flat normals."""

from __future__ import annotations

import torch
from torch import Tensor

from ..capture import Capture
from ..maps import DIELECTRIC_F0, SVBRDF, Bsdf, flat
from ..render.analytic import AnalyticRenderer
from .losses import CLIPPED

ROUGHNESS_GRID = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.85)


def robust_start(capture: Capture, guess: Tensor, bsdf: Bsdf) -> SVBRDF:
    """A material to start from: the guess, and the specular level and roughness whose lobe best explains what it leaves.

    For each roughness of a short grid the level is the least-squares one over unclipped pixels of all photos.

    Args:
        capture: photos and views; reduced to at most 64 px for the search.
        guess: guessed diffuse map, R x R x 3 linear.
    """
    side = min(64, capture.resolution)
    shrink = torch.nn.AdaptiveAvgPool2d(side)
    radiance = shrink(capture.linear.permute(0, 3, 1, 2)).permute(0, 2, 3, 1)
    usable = (shrink((capture.photos < CLIPPED).float().permute(0, 3, 1, 2)).permute(0, 2, 3, 1) > 0.99).float()
    small = shrink(guess.permute(2, 0, 1)[None])[0].permute(1, 2, 0)
    renderer = AnalyticRenderer()

    def response(diffuse: Tensor | float, specular: float, roughness: float) -> Tensor:
        svbrdf = flat(side, specular=specular, roughness=roughness, diffuse=0.0)
        maps = dict(svbrdf.maps) | ({"diffuse": diffuse} if isinstance(diffuse, Tensor) else {})
        return renderer.render(SVBRDF("roughconductor", maps), capture.views)

    left = radiance - response(small, 0.0, 0.5)
    best = (float("inf"), DIELECTRIC_F0, 0.5)
    for roughness in ROUGHNESS_GRID:
        lobe = response(0.0, 1.0, roughness)
        level = float((usable * lobe * left).sum() / (usable * lobe**2).sum().clamp_min(1e-20))
        level = min(max(level, 0.02), 0.9)
        error = float((usable * (left - level * lobe).abs()).mean())
        best = min(best, (error, level, roughness))
    _, level, roughness = best
    size = capture.resolution
    if bsdf == "principled":
        # The same two lobes: base colour (1 - metallic) is the guess, base colour metallic what F0 exceeds a dielectric's.
        metal = max(level - DIELECTRIC_F0, 0.0)
        base = (guess + metal).clamp(0.01, 1)
        metallic = (metal / base.mean(dim=2, keepdim=True)).clamp(0.05, 0.95)
        start = flat(size, "principled", roughness=roughness)
        return SVBRDF("principled", dict(start.maps) | {"base_color": base, "metallic": metallic})
    start = flat(size, specular=level, roughness=roughness)
    return SVBRDF("roughconductor", dict(start.maps) | {"diffuse": guess})
