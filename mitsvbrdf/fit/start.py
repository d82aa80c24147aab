"""The robust start: guessed diffuse, one specular level, one roughness, flat normals, or fixed maps."""

from collections.abc import Mapping

import torch
from torch import Tensor

from ..capture import Capture
from ..material.maps import DIELECTRIC_F0, SVBRDF, Bsdf, flat
from ..render.analytic import AnalyticRenderer

ROUGHNESS_GRID = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.85)


def robust_start(capture: Capture, guess: Tensor, bsdf: Bsdf, fixed: Mapping[str, Tensor]
                 | None = None) -> SVBRDF:
    """The start of a fit: the guess (R x R x 3, linear), one specular level and one roughness for all texels.

    This lobe explains best what the guess leaves unexplained in the photos, at 64 px at most. For each
    roughness of a short grid, the level is the least-squares one over unclipped pixels of all photos. The
    search uses the fixed maps, R x R x C, and the result contains them.
    """
    fixed = fixed or {}
    level, roughness = _lobe(capture, guess, fixed)
    size = capture.resolution
    if bsdf == "principled":
        # The same two lobes: base colour times (1 - metallic) is the guess, base colour times metallic is the
        # excess of F0 over a dielectric's.
        metal = max(level - DIELECTRIC_F0, 0.0)
        base = (guess + metal).clamp(0.01, 1)
        metallic = (metal / base.mean(dim=2, keepdim=True)).clamp(0.05, 0.95)
        maps = {"base_color": base, "metallic": metallic}
    else:
        maps = {"diffuse": guess}
    return SVBRDF(bsdf, dict(flat(size, bsdf, specular=level, roughness=roughness).maps) | maps | dict(fixed))


def _lobe(capture: Capture, guess: Tensor, fixed: Mapping[str, Tensor]) -> tuple[float, float]:
    """Specular level and roughness for all texels; the number for a fixed map is not used."""
    side = min(64, capture.resolution)
    shrink = torch.nn.AdaptiveAvgPool2d(side)
    radiance = shrink(capture.linear.permute(0, 3, 1, 2)).permute(0, 2, 3, 1)
    usable = (shrink(capture.usable.float().permute(0, 3, 1, 2)).permute(0, 2, 3, 1) > 0.99).float()
    small = shrink(guess.permute(2, 0, 1)[None])[0].permute(1, 2, 0)
    lobe_maps = {name: fixed[name] for name in ("specular", "roughness", "normal") if name in fixed}
    if lobe_maps:
        maps = SVBRDF("roughconductor", dict(flat(capture.resolution).maps) | lobe_maps).resized(side)
        lobe_maps = {name: maps[name] for name in lobe_maps}
    renderer = AnalyticRenderer()

    def response(maps: Mapping[str, Tensor], specular: float, roughness: float) -> Tensor:
        constant = flat(side, specular=specular, roughness=roughness, diffuse=0.0)
        return renderer.render(SVBRDF("roughconductor", {**constant.maps, **maps}), capture.views)

    matt = {name: value for name, value in lobe_maps.items() if name == "normal"} | {"diffuse": small}
    left = radiance - response(matt, 0.0, 0.5)
    best = (float("inf"), DIELECTRIC_F0, 0.5)
    for roughness in ROUGHNESS_GRID[:1] if "roughness" in fixed else ROUGHNESS_GRID:
        lobe = response(lobe_maps, 1.0, roughness)
        level = 1.0
        if "specular" not in fixed:
            level = float((usable * lobe * left).sum() / (usable * lobe**2).sum().clamp_min(1e-20))
            level = min(max(level, 0.02), 0.9)
        error = float((usable * (left - level * lobe).abs()).mean())
        best = min(best, (error, level, roughness))
    return best[1:]
