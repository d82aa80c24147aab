"""Mitsuba's BSDF plugins at known texels, through ``dr.wrap``: no rays, no film, no texture look-ups.

The pixel of a rectified photo and the texel it shows are the same, so one thread serves one texel: it holds
the texel's maps in registers, evaluates the plugin for each view, and adds up its own gradient. There is no
scatter between threads, so gradients are the same bits in every run.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from ..io.entry import entry
from ..material.maps import SVBRDF
from ..views import Views
from .bsdf import needed_maps
from .exclusive import Drawing, using_mitsuba
from .needs import Needs, refuse_not_finite, scene_needs
from .plugins import register, shading_axes
from .texel_plugin import HeldPlugin, row, texel_position, view_geometry

# evaluations unrolled in one kernel; more views take several launches of at most this many
VIEWS_PER_KERNEL = 9


class TexelRenderer:
    """Evaluates Mitsuba's own plugin code at the texels; see :class:`mitsvbrdf.render.Renderer`.

    Args:
        variant: ``llvm_ad_rgb`` or ``cuda_ad_rgb``.
        needs: what to compute; left out: what the scene needs.

    Raises:
        BackendError: Mitsuba, the variant or libLLVM is missing.
    """

    name = "mitsuba"

    def __init__(self, variant: str = "llvm_ad_rgb", needs: Needs | None = None) -> None:
        self.variant, self.needs = variant, needs
        with using_mitsuba(variant) as self.mi:
            register(self.mi)
        self.device = "cuda" if variant.startswith("cuda") else "cpu"
        self._drawings: dict[tuple, Drawing] = {}

    def __reduce__(self) -> tuple:
        return TexelRenderer, (self.variant, self.needs)

    @entry()
    def render(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """Linear radiance N x R x R x 3, float32; gradients to maps, camera, light and intensity."""
        refuse_not_finite(svbrdf, views)
        needs = self.needs or scene_needs(svbrdf, views, self.name)
        maps = needed_maps(svbrdf, needs)
        key = (svbrdf.bsdf, needs, svbrdf.resolution, views.falloff, tuple(maps))
        with using_mitsuba(self.variant):
            if key not in self._drawings:
                self._drawings[key] = Drawing(self.variant, self._wrap(*key), replayed=False)
        views = views.in_patch_sides()
        tensors = [t.to(torch.float32).to(self.device).contiguous() for t in maps.values()]
        # Plain tensors, so that they cross dr.wrap, each with its gradient if it wants one.
        geometry = [t.to(torch.float64).to(self.device).split(VIEWS_PER_KERNEL)
                    for t in (views.camera, views.light, views.intensity)]
        images = [self._drawings[key](*(part.contiguous() for part in parts), *tensors)
                  for parts in zip(*geometry)]
        return (images[0] if len(images) == 1 else torch.cat(images)).to(svbrdf["normal"].device)

    def _wrap(self, bsdf: str, needs: Needs, side: int, falloff: str,
              names: tuple[str, ...]) -> Callable[..., list[Tensor]]:
        import drjit as dr

        mi = self.mi
        Vector = dr.float64_array_t(mi.Vector3f)
        shader = HeldPlugin(mi, bsdf, needs)

        @dr.wrap(source="torch", target="drjit")
        def evaluate(cameras: Any, lights: Any, intensities: Any, *tensors: Any) -> list:
            maps = {n: _columns(mi, dr, t) for n, t in zip(names, tensors)}
            shader.hold(maps)
            place = texel_position(mi, dr.arange(mi.UInt32, side * side), side)
            axes = shading_axes(Vector(maps["normal"])) if needs.normal_map else None
            images = []
            for k in range(cameras.shape[0]):
                camera, light, intensity = (row(mi, rows.array, k) for rows in (cameras, lights, intensities))
                to_camera, to_light, irradiance = view_geometry(mi, place, axes, camera, light, intensity,
                                                                falloff)
                radiance = shader.eval(to_camera, to_light) * irradiance
                images.append(mi.TensorXf(dr.ravel(radiance), (side, side, 3)))
            shader.release()
            return images

        return evaluate


def _columns(mi: ModuleType, dr: ModuleType, tensor: Any) -> Any:
    """An R x R x C tensor as one value a texel: Float for one channel, Color3f for three."""
    return mi.Float(tensor.array) if tensor.shape[2] == 1 else dr.unravel(mi.Color3f, tensor.array)
