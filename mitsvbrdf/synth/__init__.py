"""Simulated photos of known maps: rectified ones, and those that a hand-held phone would take."""

import torch

from .. import color
from ..capture.capture import Capture
from ..io.entry import entry
from ..material.maps import SVBRDF
from ..measure.rerender import batches
from ..render import Renderer
from ..views import Views


@entry()
def photograph(svbrdf: SVBRDF, views: Views, renderer: Renderer, noise: float = 0.0, seed: int = 0,
               transfer: color.Transfer = "gamma2.2") -> Capture:
    """Simulate photos of a material as a camera stores them: 8 bits, clipped, with sensor noise.

    ``noise``: standard deviation of the normally distributed noise, in linear radiance.
    """
    stored, random = [], torch.Generator().manual_seed(seed)
    for some in batches(len(views), svbrdf.resolution):  # memory stays small
        lit = views.pick(some)
        with torch.no_grad():
            radiance = renderer.render(svbrdf, lit).float()
        if noise:
            radiance = radiance + noise * torch.randn(radiance.shape, generator=random)
        seen = Capture(color.to_display(radiance.clamp_min(0), transfer), lit, transfer).photos
        stored.append((seen * 255).round().byte())
    return Capture(torch.cat(stored), views, transfer)
