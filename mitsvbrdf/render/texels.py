"""Mitsuba's BSDF plugins at known texels, through ``dr.wrap``: no rays, no film, no texture look-ups.

The pixel of a rectified photo and the texel it shows are the same, so one thread serves one texel: it holds the
texel's maps in registers, evaluates the plugin for each view, and adds up its own gradient. There is no scatter between
threads, so gradients are the same bits in every run.

Directions are worked out in float64, in the texel's own shading frame, and rounded once, to what the plugin takes. In
float32 the half vector of a narrow highlight keeps few of its digits across the normal; measured at roughness 0.1 with random
normals, gradients against float64: 8e-6 -> 3e-7, for a sixth more time.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..maps import SVBRDF
from ..views import Views
from .bsdf import needed_maps, plugin, slot_values
from .llvm import mitsuba_module
from .needs import Needs, scene_needs
from .rectified import register, shading_axes, to_shading

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

    def _wrap(self, bsdf: str, needs: Needs, side: int, falloff: str, names: tuple[str, ...]):
        import drjit as dr

        mi = self.mi
        Vector = dr.float64_array_t(mi.Vector3f)
        shader = HeldPlugin(mi, bsdf, needs)

        @dr.wrap(source="torch", target="drjit")
        def evaluate(cameras, lights, intensities, *tensors):
            maps = {n: _columns(mi, dr, t) for n, t in zip(names, tensors)}
            shader.hold(maps)
            position = texel_position(mi, dr.arange(mi.UInt32, side * side), side)
            axes = shading_axes(Vector(maps["normal"])) if needs.normal_map else None

            def local(direction):
                return mi.Vector3f(to_shading(axes, direction) if axes else direction)

            images = []
            for k in range(cameras.shape[0]):
                camera, light, intensity = (row(mi, rows.array, k) for rows in (cameras, lights, intensities))
                to_light = light - position
                distance2 = dr.squared_norm(to_light)
                value = shader.eval(local(dr.normalize(camera - position)), local(to_light / dr.sqrt(distance2)))
                if falloff == "none":
                    distance2 = dr.squared_norm(light)
                radiance = value * mi.Color3f(intensity / distance2)
                images.append(mi.TensorXf(dr.ravel(radiance), (side, side, 3)))
            shader.release()
            return images

        return evaluate


class HeldPlugin:
    """A Mitsuba plugin in its own shading frame, with the maps' values of the texel that a thread holds.

    Its textures answer with these values, whatever the position.

    Args:
        mi: the ``mitsuba`` module with the variant to use.
        bsdf: ``roughconductor`` or ``principled``.
        needs: what to compute; the normal map is the caller's.
    """

    def __init__(self, mi, bsdf: str, needs: Needs) -> None:
        self.mi, self.bsdf, self.needs = mi, bsdf, replace(needs, normal_map=False)
        held: dict[str, object] = {}  # slot name -> this texel's value
        self._held = held

        class Held(mi.Texture):
            """A texture that answers with the value the thread holds, whatever the position."""

            def __init__(self, props):
                super().__init__(props)
                self.slot = props["slot"]

            # Nothing is held while another renderer is at work: Dr.Jit may then trace this texture along with its own.
            def eval(self, si, active=True):
                return mi.Color3f(held.get(self.slot, 0))

            def eval_1(self, si, active=True):
                return mi.Float(held.get(self.slot, 0))

            eval_3 = eval

            def to_string(self):
                return f"Held[{self.slot}]"

        name = f"held_texel_{id(held)}"
        mi.register_texture(name, Held)
        self._plugin = mi.load_dict(plugin(bsdf, self.needs, lambda slot: {"type": name, "slot": slot}))
        self._context = mi.BSDFContext()

    def hold(self, maps: dict) -> None:
        """Take these maps (Dr.Jit values, linear) for the evaluations to come; the plugin keeps them until released."""
        self._held.update(slot_values(self.bsdf, maps, self.needs))

    def release(self) -> None:
        """Forget the maps."""
        self._held.clear()

    def eval(self, to_camera, to_light):
        """BSDF times n.l for directions (Vector3f) in the shading frame."""
        import drjit as dr

        si = dr.zeros(self.mi.SurfaceInteraction3f)
        si.n = self.mi.Normal3f(0, 0, 1)
        si.sh_frame = self.mi.Frame3f(si.n)
        si.wi = to_camera
        return self._plugin.eval(self._context, si, to_light)


def texel_position(mi, index, side: int):
    """Centre of texel ``index`` (UInt32, row by row) on the patch of side 1: a float64 vector."""
    import drjit as dr

    Vector = dr.float64_array_t(mi.Vector3f)
    row = index // side
    position = (Vector(index - row * side, row, 0) + 0.5) / side - 0.5
    return Vector(position.x, -position.y, 0)


def _columns(mi, dr, tensor):
    """An R x R x C tensor as one value a texel: Float for one channel, Color3f for three."""
    return mi.Float(tensor.array) if tensor.shape[2] == 1 else dr.unravel(mi.Color3f, tensor.array)


def row(mi, array, k):
    """Row k of N x 3 float64 numbers, as values that may change without compiling a new kernel."""
    import drjit as dr

    return dr.float64_array_t(mi.Vector3f)(*(dr.gather(dr.float64_array_t(mi.Float), array, mi.UInt32(3 * k + axis))
                                             for axis in range(3)))
