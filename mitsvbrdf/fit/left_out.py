"""What a fit needs to compute, and what it leaves out: known from capture, renderer and settings before it starts."""

from __future__ import annotations

from ..render.needs import scene_needs
from ..views import Views
from . import losses
from .fixed_maps import described, unknown_but
from .task import FitTask


def left_out(task: FitTask, views: Views | None = None) -> list[tuple[str, str]]:
    """What a fit does not compute, as (what, why): the renderer's list and the method's.

    Args:
        task: photos, renderer and settings.
        views: as fitted; left out: as calibrated. A flash offset found later can call for the Fresnel curve.
    """
    config = task.config
    material = unknown_but(task.fixed, config.bsdf, task.capture.resolution, config.grey_specular)
    items = list(scene_needs(material, views or task.capture.views, task.renderer.name).left_out)
    items += [(f"gradient of {name}", why) for name, why in described(config.fix).items()]
    if "diffuse" in task.fixed:
        items.append(("guessed diffuse map", "diffuse held fixed"))
    items += [(losses.NAMES[name], why) for name, why in task.unused.items()]
    if config.wants_flash_offset is not None and task.why_no_flash_offset:
        items.append(("flash offset", task.why_no_flash_offset))
    return items
