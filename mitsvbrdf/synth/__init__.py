"""Simulated photos of known maps: rectified ones, and those that a hand-held phone would take."""

import torch

from .. import color
from ..capture.capture import Capture
from ..io.entry import entry
from ..material.maps import SVBRDF
from ..render import Renderer
from ..views import Views


@entry()
def photograph(svbrdf: SVBRDF, views: Views, renderer: Renderer, noise: float = 0.0, seed: int = 0,
               transfer: color.Transfer = "gamma2.2") -> Capture:
    """What a camera would store of a material: 8 bits, clipped, with sensor noise.

    The noise is the standard deviation of normally distributed numbers, in linear radiance.
    """
    with torch.no_grad():
        radiance = renderer.render(svbrdf, views).float()
    grain = torch.randn(radiance.shape, generator=torch.Generator().manual_seed(seed))
    photos = color.to_display((radiance + noise * grain).clamp_min(0), transfer)
    return Capture((photos * 255).round() / 255, views, transfer)
