"""What a fit needs to compute, and what it leaves out: known from capture, renderer and settings before it starts."""

from __future__ import annotations

import torch

from ..material.maps import CHANNELS, SVBRDF
from ..render.needs import scene_needs
from ..views import Views
from . import losses
from .fixed_maps import described
from .task import FitTask


def left_out(task: FitTask, views: Views | None = None) -> list[tuple[str, str]]:
    """What a fit does not compute, as (what, why): the renderer's list and the method's.

    Args:
        task: photos, renderer and settings.
        views: as fitted; left out: as calibrated. A flash offset found later can call for the Fresnel curve.
    """
    items = list(scene_needs(_unknown(task), views or task.capture.views, task.renderer.name).left_out)
    items += [(f"gradient of {name}", why) for name, why in described(task.config.fix).items()]
    if "diffuse" in task.fixed:
        items.append(("guessed diffuse map", "diffuse held fixed"))
    items += [(losses.NAMES[name], why) for name, why in task.unused.items()]
    if task.config.wants_flash_offset is not None and task.why_no_flash_offset:
        items.append(("flash offset", task.why_no_flash_offset))
    return items


def _unknown(task: FitTask) -> SVBRDF:
    """A material of which only the fixed maps are known: the others want a gradient."""
    config, side, maps = task.config, task.capture.resolution, dict(task.fixed)
    for name, channels in CHANNELS[config.bsdf].items():
        if name not in task.fixed:
            own = 1 if config.grey_specular and name == "specular" else channels
            maps[name] = torch.ones(1, 1, own).requires_grad_().expand(side, side, channels)
    return SVBRDF(config.bsdf, maps)
