"""Mitsuba's BSDF plugins at known texels, through ``dr.wrap``: no rays, no film, no texture look-ups.

The pixel of a rectified photo and the texel it shows are the same, so one thread serves one texel: it holds
the texel's maps in registers, evaluates the plugin for each view, and adds up its own gradient. There is no
scatter between threads, so gradients are the same bits in every run.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

from torch import Tensor

from .exclusive import MitsubaRenderer
from .needs import Needs
from .plugins import shading_axes
from .texel_plugin import HeldPlugin, row, texel_position, view_geometry


class TexelRenderer(MitsubaRenderer):
    """Evaluates Mitsuba's own plugin code at the texels."""

    name = "mitsuba"
    views_at_once = 9  # evaluations unrolled in one kernel; more views take several launches

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
