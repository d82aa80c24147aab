"""Mitsuba's BSDF plugins at known texels, through ``dr.wrap``: no rays, no film, no texture look-ups.

The pixel of a rectified photo and the texel it shows are the same, so one thread serves one texel: it holds the
texel's maps in registers, evaluates the plugin for each view, and adds up its own gradient. There is no scatter between
threads, so gradients are the same bits in every run.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..maps import CHANNELS, SVBRDF
from ..views import Views
from .bsdf import plugin, slot_values
from .llvm import mitsuba_module
from .needs import scene_needs

VIEWS_PER_KERNEL = 9  # evaluations unrolled in one kernel; more views take several launches of at most this many


class TexelRenderer:
    """Evaluates Mitsuba's own plugin code at the texels; see :class:`mitsvbrdf.render.Renderer`.

    Args:
        variant: ``llvm_ad_rgb`` or ``cuda_ad_rgb``.

    Raises:
        BackendError: Mitsuba, the variant or libLLVM is missing.
    """

    name = "mitsuba"

    def __init__(self, variant: str = "llvm_ad_rgb") -> None:
        self.variant = variant
        self.mi = mitsuba_module(variant)
        self.device = "cuda" if variant.startswith("cuda") else "cpu"
        self._wrapped: dict[tuple, object] = {}

    def render(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """Linear radiance N x R x R x 3, float32; gradients to maps, camera, light and intensity."""
        mitsuba_module(self.variant)  # somebody may have set another variant since
        curve = scene_needs(svbrdf.bsdf, views, self.name).fresnel_curve
        key = (svbrdf.bsdf, curve, views.falloff)
        if key not in self._wrapped:
            self._wrapped[key] = self._wrap(*key)
        views = views.in_patch_sides()
        place = {"dtype": torch.float32, "device": self.device}
        maps = [svbrdf[name].to(**place).contiguous() for name in CHANNELS[svbrdf.bsdf]]
        # Plain tensors, so that they cross dr.wrap, each with its gradient if it wants one.
        geometry = [t.to(**place).split(VIEWS_PER_KERNEL) for t in (views.camera, views.light, views.intensity)]
        images = []
        for camera, light, intensity in zip(*geometry):
            images += self._wrapped[key](camera.contiguous(), light.contiguous(), intensity.contiguous(), *maps)
        return torch.stack(images).to(svbrdf["normal"].device)

    def _wrap(self, bsdf: str, curve: bool, falloff: str):
        import drjit as dr

        mi = self.mi
        held: dict[str, object] = {}  # slot name -> this texel's value

        class Held(mi.Texture):
            """A texture that answers with the value the thread holds, whatever the position."""

            def __init__(self, props):
                super().__init__(props)
                self.slot = props["slot"]

            # Nothing is held while another renderer is at work: Dr.Jit may then trace this texture along with its own.
            def eval(self, si, active=True):
                return held.get(self.slot, mi.Color3f(0))

            def eval_1(self, si, active=True):
                return held.get(self.slot, mi.Float(0))

            eval_3 = eval

            def to_string(self):
                return f"Held[{self.slot}]"

        name = f"held_texel_{bsdf}_{int(curve)}_{falloff}_{id(held)}"
        mi.register_texture(name, Held)
        shader = mi.load_dict(plugin(bsdf, curve, lambda slot: {"type": name, "slot": slot}))
        context = mi.BSDFContext()

        @dr.wrap(source="torch", target="drjit")
        def evaluate(cameras, lights, intensities, *tensors):
            side = tensors[0].shape[0]
            maps = {n: _columns(mi, dr, t) for n, t in zip(CHANNELS[bsdf], tensors)}
            held.update(slot_values(bsdf, maps, curve))
            index = dr.arange(mi.UInt32, side * side)
            row = index // side
            position = mi.Point3f((mi.Float(index - row * side) + 0.5) / side - 0.5, 0.5 - (mi.Float(row) + 0.5) / side, 0)
            images = []
            for k in range(cameras.shape[0]):
                camera, light, intensity = (_row(mi, dr, rows, k) for rows in (cameras, lights, intensities))
                si = dr.zeros(mi.SurfaceInteraction3f, side * side)
                si.p = position
                si.n = mi.Normal3f(0, 0, 1)
                si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
                si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
                si.wi = dr.normalize(camera - position)
                to_light = light - position
                distance2 = dr.squared_norm(to_light)
                value = shader.eval(context, si, to_light * dr.rsqrt(distance2))
                if falloff == "none":
                    distance2 = dr.squared_norm(light)
                radiance = value * mi.Color3f(intensity) / distance2
                images.append(mi.TensorXf(dr.ravel(radiance), (side, side, 3)))
            held.clear()
            return images

        return evaluate


def _columns(mi, dr, tensor):
    """An R x R x C tensor as one value a texel: Float for one channel, Color3f for three."""
    return mi.Float(tensor.array) if tensor.shape[2] == 1 else dr.unravel(mi.Color3f, tensor.array)


def _row(mi, dr, tensor, k):
    """Row k of an N x 3 tensor, as values that may change without compiling a new kernel."""
    return mi.Vector3f(*(dr.gather(mi.Float, tensor.array, mi.UInt32(3 * k + axis)) for axis in range(3)))
