"""What a fit needs to compute, and what it leaves out: known from capture, renderer and settings before it starts."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from ..calibrate.estimate import why_not
from ..capture import Capture
from ..material.maps import CHANNELS, SVBRDF
from ..render import Renderer
from ..render.needs import scene_needs
from ..views import Views
from . import losses
from .config import FitConfig, HierarchicalConfig, HybridConfig
from .fixed_maps import described, fixed_maps


def left_out(capture: Capture, renderer: Renderer, config: FitConfig, views: Views | None = None) -> list[tuple[str, str]]:
    """What a fit with these settings does not compute, as (what, why): the renderer's list and the method's.

    Args:
        capture: photos and views.
        renderer: what would carry the gradients.
        config: method and settings.
        views: as fitted; left out: as calibrated. A flash offset found later can call for the Fresnel curve.
    """
    held = fixed_maps(config.fix, config.bsdf, capture.resolution)
    items = list(scene_needs(_unknown(config, held, capture.resolution), views or capture.views, renderer.name).left_out)
    items += [(f"gradient of {name}", why) for name, why in described(config.fix).items()]
    if "diffuse" in held:
        items.append(("guessed diffuse map", "diffuse held fixed"))
    items += [(losses.NAMES[name], why) for name, why in losses.unused(config, held).items()]
    if isinstance(config, (HierarchicalConfig, HybridConfig)) and (why := no_flash_offset(capture, renderer, config)):
        items.append(("flash offset", why))
    return items


def no_flash_offset(capture: Capture, renderer: Renderer, config: HierarchicalConfig | HybridConfig) -> str | None:
    """Why the distance between lens and flash is not fitted; None where it is."""
    if not config.flash_offset:
        return "not asked for"
    if not capture.calibrated and (why_not(capture) or getattr(config, "calibrate", None) is False):
        return "the views are a stated default, not a calibration"
    return "mitsuba-scene has no gradient to the lights" if renderer.name == "mitsuba-scene" else None


def _unknown(config: FitConfig, held: Mapping[str, Tensor], resolution: int) -> SVBRDF:
    """A material of which only the maps held fixed are known: the others want a gradient."""
    maps = dict(held)
    for name, channels in CHANNELS[config.bsdf].items():
        if name not in held:
            own = 1 if config.grey_specular and name == "specular" else channels
            maps[name] = torch.ones(1, 1, own).requires_grad_().expand(resolution, resolution, channels)
    return SVBRDF(config.bsdf, maps)
