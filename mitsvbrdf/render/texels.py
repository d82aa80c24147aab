"""Mitsuba's BSDF plugins at known texels, through ``dr.wrap``: no rays, no film, no texture look-ups.

The pixel of a rectified photo and the texel it shows are the same, so one thread serves one texel: it holds the
texel's maps in registers, evaluates the plugin for each view, and adds up its own gradient. There is no scatter between
threads, so gradients are the same bits in every run.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..maps import SVBRDF
from ..views import Views
from .bsdf import needed_maps
from .llvm import mitsuba_module
from .needs import Needs, scene_needs
from .rectified import register, shading_axes
from .threads import HeldPlugin, along, from_torch, frozen, row, seen, texel_position, to_torch

VIEWS_PER_KERNEL = 9  # evaluations unrolled in one kernel; more views take several launches of at most this many


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
        self.mi = mitsuba_module(variant)
        register(self.mi)
        self.device = "cuda" if variant.startswith("cuda") else "cpu"
        self._wrapped: dict[tuple, object] = {}

    def render(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """Linear radiance N x R x R x 3, float32; gradients to maps, camera, light and intensity."""
        mitsuba_module(self.variant)  # somebody may have set another variant since
        needs = self.needs or scene_needs(svbrdf, views, self.name)
        maps = needed_maps(svbrdf, needs)
        key = (svbrdf.bsdf, needs, svbrdf.resolution, views.falloff, tuple(maps))
        if key not in self._wrapped:
            self._wrapped[key] = self._wrap(*key)
        views = views.in_patch_sides()
        tensors = [t.to(torch.float32).to(self.device).contiguous() for t in maps.values()]
        # Plain tensors, so that they cross dr.wrap, each with its gradient if it wants one.
        geometry = [t.to(torch.float64).to(self.device).split(VIEWS_PER_KERNEL)
                    for t in (views.camera, views.light, views.intensity)]
        images = []
        for camera, light, intensity in zip(*geometry):
            images += self._wrapped[key](camera.contiguous(), light.contiguous(), intensity.contiguous(), *tensors)
        return torch.stack(images).to(svbrdf["normal"].device)

    def position_slopes(self, svbrdf: SVBRDF, views: Views) -> tuple[Tensor, Tensor]:
        """Linear radiance and its slopes by where camera and light stand, by forward derivatives.

        All N views are worked on at once, so memory grows with N R^2: meant for small maps, to refine a calibration.

        Returns:
            N x R x R x 3, and N x R x R x 3 x 6: by x, y, z of the camera, then of the light, per unit of the views' lengths.
        """
        mi = mitsuba_module(self.variant)
        needs = self.needs or scene_needs(svbrdf, views, self.name)
        maps = needed_maps(svbrdf.detach(), needs)
        side, sides, names = svbrdf.resolution, views.in_patch_sides(), tuple(maps)
        key = ("positions", svbrdf.bsdf, needs, side, views.falloff, len(views), *((n, m.shape[2]) for n, m in maps.items()))
        if key not in self._wrapped:
            self._wrapped[key] = self._by_position(svbrdf.bsdf, needs, side, views.falloff, len(views), names)
        found = self._wrapped[key]([from_torch(mi, m) for m in maps.values()],
                                   [from_torch(mi, v.double()) for v in (sides.camera, sides.light, sides.intensity)])
        radiance, *slopes = to_torch(found).reshape(7, 3, len(views), side, side).permute(0, 2, 3, 4, 1)
        device = svbrdf["normal"].device
        return radiance.contiguous().to(device), torch.stack(slopes, dim=-1).to(device) / views.size

    def _by_position(self, bsdf: str, needs: Needs, side: int, falloff: str, count: int, names: tuple[str, ...]):
        import drjit as dr

        mi = self.mi
        Vector, texels = dr.float64_array_t(mi.Vector3f), side * side
        shader = HeldPlugin(mi, bsdf, needs)

        def evaluate(tensors, positions):
            index = dr.arange(mi.UInt32, count * texels)
            view, texel = index // texels, index % texels
            maps = {name: dr.gather(mi.Float if len(t) == texels else mi.Color3f, t, texel) for name, t in zip(names, tensors)}
            axes = shading_axes(Vector(maps["normal"])) if needs.normal_map else None
            camera, light, intensity = (row(mi, rows, view) for rows in positions)
            dr.enable_grad(camera, light)
            shader.hold(maps)
            to_camera, to_light, irradiance = seen(mi, texel_position(mi, texel, side), axes, camera, light, intensity, falloff)
            radiance = shader.eval(to_camera, to_light) * irradiance
            shader.release()
            lit = (to_camera.z > 0) & (to_light.z > 0)
            slopes = [dr.select(lit, slope, 0) for slope in
                      along(radiance, [[(end, Vector(*axis))] for end in (camera, light) for axis in torch.eye(3).tolist()])]
            return [list(value) for value in (dr.detach(radiance), *slopes)]

        return frozen(evaluate, shader)

    def _wrap(self, bsdf: str, needs: Needs, side: int, falloff: str, names: tuple[str, ...]):
        import drjit as dr

        mi = self.mi
        Vector = dr.float64_array_t(mi.Vector3f)
        shader = HeldPlugin(mi, bsdf, needs)

        @dr.wrap(source="torch", target="drjit")
        def evaluate(cameras, lights, intensities, *tensors):
            maps = {n: _columns(mi, dr, t) for n, t in zip(names, tensors)}
            shader.hold(maps)
            place = texel_position(mi, dr.arange(mi.UInt32, side * side), side)
            axes = shading_axes(Vector(maps["normal"])) if needs.normal_map else None
            images = []
            for k in range(cameras.shape[0]):
                view = [row(mi, rows.array, k) for rows in (cameras, lights, intensities)]
                to_camera, to_light, irradiance = seen(mi, place, axes, *view, falloff)
                radiance = shader.eval(to_camera, to_light) * irradiance
                images.append(mi.TensorXf(dr.ravel(radiance), (side, side, 3)))
            shader.release()
            return images

        return evaluate


def _columns(mi, dr, tensor):
    """An R x R x C tensor as one value a texel: Float for one channel, Color3f for three."""
    return mi.Float(tensor.array) if tensor.shape[2] == 1 else dr.unravel(mi.Color3f, tensor.array)
