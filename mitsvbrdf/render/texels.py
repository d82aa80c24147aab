"""Mitsuba's BSDF plugins at known texels: no rays, no film, no texture look-ups.

Each pixel of a rectified photo is one texel of the maps. If gradients are needed, one thread computes one
texel: it keeps the texel's maps in registers, evaluates the plugin for each view, and adds up its own
gradient. There is no scatter between threads, so gradients are identical in every run. Without gradients, one
thread draws one pixel.

Directions are computed in float64, in the texel's own shading frame, and rounded once, to the plugin's
float32. In float32, the half vector of a narrow highlight would keep few digits perpendicular to the normal.
Gradient errors against float64 at roughness 0.1 with random normals: 8e-6 -> 3e-7, for a sixth more time.
"""

import gc
import math
import weakref
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any, SupportsFloat

import torch
from torch import Tensor

from .bsdf import plugin, slot_values
from .exclusive import Drawing, MitsubaRenderer
from .needs import Needs
from .plugins import shading_axes, to_shading

TILE = 2**20  # texels that are drawn at once
UNROLLED = 9  # views in one kernel


class TexelRenderer(MitsubaRenderer):
    """Evaluates Mitsuba's own plugin code at the texels."""

    name = "mitsuba"

    def views_at_once(self, side: int, gradients: bool) -> int:
        """How many views one kernel draws. It unrolls views with gradients; more need several launches."""
        return UNROLLED if gradients else max(UNROLLED, TILE // side**2)

    def _pictures(self, drawing: Drawing, side: int, geometry: list[Tensor], maps: list[Tensor]) -> Tensor:
        """Draw large maps in strips of rows if no gradient is needed: intermediate values stay small."""
        places = torch.arange(side**2, dtype=torch.int32, device=self.device).reshape(side, side)
        inputs = [*geometry, *maps]
        if side**2 <= TILE or torch.is_grad_enabled() and any(each.requires_grad for each in inputs):
            return drawing(places, *inputs)
        images = geometry[0].new_empty(len(geometry[0]), side, side, 3, dtype=torch.float32)
        for first in range(0, side, TILE // side):
            rows = slice(first, first + TILE // side)
            images[:, rows] = drawing(places[rows], *geometry, *(each[rows] for each in maps))
        return images

    def _wrap(self, bsdf: str, needs: Needs, side: int, falloff: str,
              names: tuple[str, ...]) -> Callable[..., list[Tensor]]:
        import drjit as dr

        mi = self.mi
        Vector = dr.float64_array_t(mi.Vector3f)
        shader = HeldPlugin(mi, bsdf, needs)

        @dr.wrap(source="torch", target="drjit")
        def evaluate(texels: Any, cameras: Any, lights: Any, intensities: Any, *tensors: Any) -> list:
            fixed = not any(map(dr.grad_enabled, (cameras, lights, intensities, *tensors)))
            count, size = cameras.shape[0], math.prod(texels.shape)
            pixel = dr.arange(mi.UInt32, size * (count if fixed else 1))
            texel = pixel % size

            def values(tensor: Any) -> Any:
                kind = mi.Float if tensor.shape[2] == 1 else mi.Color3f
                return dr.gather(kind, tensor.array, texel) if fixed else (
                    mi.Float(tensor.array) if kind is mi.Float else dr.unravel(kind, tensor.array))

            maps = {n: values(t) for n, t in zip(names, tensors)}  # one value a thread
            shader.hold(maps)
            place = texel_position(mi, dr.gather(mi.UInt32, mi.UInt32(texels.array), texel), side)
            axes = shading_axes(Vector(maps["normal"])) if needs.normal_map else None
            images = []
            for k in (pixel // size,) if fixed else range(count):
                camera, light, intensity = (row(mi, rows.array, k) for rows in (cameras, lights, intensities))
                to_camera, to_light, irradiance = view_geometry(mi, place, axes, camera, light, intensity,
                                                                falloff)
                radiance = shader.eval(to_camera, to_light) * irradiance
                images.append(mi.TensorXf(dr.ravel(radiance), (count if fixed else 1, *texels.shape, 3)))
            shader.release()
            return images

        return evaluate


class HeldPlugin:
    """A Mitsuba plugin in its own shading frame; each thread evaluates it with the values of its own texel.

    Its textures return these values at any position. :attr:`plugin` is Mitsuba's object. The caller applies
    the normal map.
    """

    def __init__(self, mi: ModuleType, bsdf: str, needs: Needs) -> None:
        self.mi, self.bsdf, self.needs = mi, bsdf, replace(needs, normal_map=False)
        held: dict[str, object] = {}  # slot name -> this texel's value
        self._held = held
        Texture: Any = mi.Texture

        class Held(Texture):
            """A texture that returns the thread's own value at any position."""

            def __init__(self, props: Any) -> None:
                super().__init__(props)
                self.slot = props["slot"]

            # 0 if no value is set: Dr.Jit may trace this texture along with another renderer's.
            def eval(self, si: Any, active: Any = True) -> Any:
                return mi.Color3f(held.get(self.slot, 0))

            def eval_1(self, si: Any, active: Any = True) -> Any:
                return mi.Float(held.get(self.slot, 0))

            eval_3 = eval

            def to_string(self) -> str:
                return f"Held[{self.slot}]"

        name = f"held_texel_{id(held)}"
        mi.register_texture(name, Held)
        self.plugin = mi.load_dict(plugin(bsdf, self.needs, lambda slot: {"type": name, "slot": slot}))
        self._context = mi.BSDFContext()

    def hold(self, maps: dict) -> None:
        """Keep these maps (Dr.Jit values, linear) for the next evaluations, until :meth:`release`."""
        self._held.update(slot_values(self.bsdf, maps, self.needs))

    def release(self) -> None:
        """Forget the maps."""
        self._held.clear()

    def eval(self, to_camera: Any, to_light: Any) -> Any:
        """BSDF times n.l for directions (Vector3f) in the shading frame."""
        import drjit as dr

        si = dr.zeros(self.mi.SurfaceInteraction3f)
        si.n = self.mi.Normal3f(0, 0, 1)
        si.sh_frame = self.mi.Frame3f(si.n)
        si.wi = to_camera
        return self.plugin.eval(self._context, si, to_light)


def texel_position(mi: ModuleType, index: Any, side: Any) -> Any:
    """Centre of texel ``index`` (UInt32, row by row) on the patch of side 1: a float64 vector.

    ``side`` is in texels, a number or UInt32.
    """
    import drjit as dr

    Vector = dr.float64_array_t(mi.Vector3f)
    row = index // side
    position = (Vector(index - row * side, row, 0) + 0.5) / Vector(side) - 0.5
    return Vector(position.x, -position.y, 0)


def along(value: Any, directions: list) -> list:
    """Slopes of a Dr.Jit value along directions, each a list of (variable, tangent); also in symbolic loops.

    The variables must have gradients enabled. Their gradients are cleared.
    """
    import drjit as dr

    slopes = []
    for direction in directions:
        for variable, tangent in direction:
            dr.set_grad(variable, tangent)
        slopes.append(dr.forward_to(value, flags=dr.ADFlag.ClearVertices))
        dr.clear_grad([value, *(variable for variable, _ in direction)])
    return slopes


def frozen(function: Callable, shader: HeldPlugin) -> Callable:
    """Freeze a function of Dr.Jit arrays, so that it is traced once. It may evaluate the shader's plugin.

    Python's garbage collector is off in each call: if it freed an array in torch's memory while Dr.Jit 1.5.0
    records, the process would abort ("enqueue_host_func(): this function cannot be recorded").
    """
    import drjit as dr

    held: Any = weakref.ref(shader)  # Dr.Jit makes a class for each function; it refers to itself
    traced = dr.freeze(function, state_fn=lambda *_: held().plugin)

    def call(*args: Any) -> Any:
        collects = gc.isenabled()
        gc.disable()
        try:
            return traced(*args)
        finally:
            if collects:
                gc.enable()

    return call


def from_torch(mi: ModuleType, tensor: Tensor) -> Any:
    """A tensor as a flat Dr.Jit array (Float, Float64 or UInt32), in the same memory if possible."""
    import drjit as dr

    kinds = {torch.float64: dr.float64_array_t(mi.Float), torch.int32: mi.UInt32}
    tensor = tensor.detach().to("cuda" if mi.variant().startswith("cuda") else "cpu",
                                tensor.dtype if tensor.dtype in kinds else torch.float32).contiguous()
    if tensor.is_cuda:
        torch.cuda.synchronize()  # Dr.Jit has a stream of its own
    return kinds.get(tensor.dtype, mi.Float)(tensor.reshape(-1))


def to_torch(values: list) -> Tensor:
    """One tensor from nested lists of Dr.Jit arrays of one length; this length is its last dimension."""
    import drjit as dr

    dr.eval(values)
    dr.sync_thread()

    def stacked(value: Any) -> Tensor:
        return torch.stack([stacked(v) for v in value]) if isinstance(value, list) else value.torch()

    return stacked(values)


def view_geometry(mi: ModuleType, place: Any, axes: Any, camera: Any, light: Any, intensity: Any,
                  falloff: str) -> tuple[Any, Any, Any]:
    """Directions from texels to camera and to light, in the shading frame, and the factor I / d^2."""
    import drjit as dr

    def local(direction: Any) -> Any:
        return mi.Vector3f(to_shading(axes, direction) if axes else direction)

    reach = light - place
    distance2 = dr.squared_norm(reach)
    to_camera, to_light = local(dr.normalize(camera - place)), local(reach / dr.sqrt(distance2))
    if falloff == "none":
        distance2 = dr.squared_norm(light)
    return to_camera, to_light, mi.Color3f(intensity / distance2)


def row(mi: ModuleType, array: Any, k: Any) -> Any:
    """Row k of N x 3 float64 numbers, as values that may change without compiling a new kernel."""
    import drjit as dr

    return dr.float64_array_t(mi.Vector3f)(
        *(dr.gather(dr.float64_array_t(mi.Float), array, mi.UInt32(3 * k + axis)) for axis in range(3)))


def opaque(mi: ModuleType, value: SupportsFloat) -> Any:
    """A number that may change without a new kernel."""
    import drjit as dr

    return dr.opaque(mi.UInt32, value) if isinstance(value, int) else dr.opaque(mi.Float, float(value))
