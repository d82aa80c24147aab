"""The traced Mitsuba scene through ``dr.wrap``: rectangle, point light, and the camera of a rectified photo.

With one unjittered sample a pixel and a box filter every ray hits its texel's centre, so the image has no
noise. More samples are jittered over the pixel: they estimate its average, as a sensor sees it, with noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from ..errors import ConfigError
from ..io.entry import entry
from ..material.maps import SVBRDF
from ..views import Views
from .bsdf import needed_maps, plugin, slot_values
from .exclusive import Drawing, using_mitsuba
from .needs import Needs, refuse_not_finite, scene_needs
from .plugins import CAMERA, INTEGRATOR, NORMAL_MAP, register

GREY = ("alpha", "metallic", "roughness")
SAMPLES = tuple(4**k for k in range(6))  # what the stratified sampler takes without rounding


class SceneRenderer:
    """Traces rays from the camera to the patch and on to the light; see :class:`mitsvbrdf.render.Renderer`.

    Args:
        variant: ``llvm_ad_rgb`` or ``cuda_ad_rgb``.
        needs: what to compute; left out: what the scene needs.
        samples: rays a pixel, 1, 4, 16, 64, ...; one goes to the texel's centre, more are stratified and
            jittered, the same in every picture.

    Raises:
        BackendError: Mitsuba, the variant or libLLVM is missing.
        ConfigError: another number of samples.
    """

    name = "mitsuba-scene"

    def __init__(self, variant: str = "llvm_ad_rgb", needs: Needs | None = None, samples: int = 1) -> None:
        if samples not in SAMPLES:
            raise ConfigError(f"samples a pixel of {list(SAMPLES)}", str(samples), "choose one of these")
        self.variant, self.needs, self.samples = variant, needs, samples
        with using_mitsuba(variant) as self.mi:
            register(self.mi)
        self.device = "cuda" if variant.startswith("cuda") else "cpu"
        self._drawings: dict[tuple, Drawing] = {}

    def __reduce__(self) -> tuple:
        return SceneRenderer, (self.variant, self.needs, self.samples)

    @entry()
    def render(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """Linear radiance N x R x R x 3, float32; gradients to the maps.

        Raises:
            ConfigError: camera or light asks for a gradient, which emitters and sensors called by a ray do
                not carry.
        """
        refuse_not_finite(svbrdf, views)
        if any(t.requires_grad for t in (views.camera, views.light, views.intensity)):
            raise ConfigError("views held fixed", "a gradient asked of camera, light or intensity",
                              "use the renderer 'mitsuba' or 'analytic' to fit these")
        needs = self.needs or scene_needs(svbrdf, views, self.name)
        maps = needed_maps(svbrdf, needs)
        key = (svbrdf.bsdf, needs, svbrdf.resolution, tuple(maps))
        with using_mitsuba(self.variant):
            if key not in self._drawings:
                self._drawings[key] = Drawing(self.variant, self._wrap(*key), replayed=True)
        views = views.in_patch_sides()
        geometry = [t.to(torch.float64).to(self.device).contiguous()
                    for t in (views.camera, views.light, views.intensity)]
        images = self._drawings[key](*geometry, *(t.to(self.device, torch.float32).contiguous()
                                                  for t in maps.values()))
        if views.falloff == "none":
            images = images * _falloff_undone(views, svbrdf.resolution).to(images)
        return images.to(svbrdf["normal"].device)

    def _wrap(self, bsdf: str, needs: Needs, resolution: int,
              names: tuple[str, ...]) -> Callable[..., list[Tensor]]:
        import drjit as dr

        mi = self.mi
        textures: dict[str, Any] = {}
        grey = GREY if needs.coloured_specular else (*GREY, "f0", f"specular_x{needs.lobes}")
        flat = replace(needs, normal_map=False)

        def texture(slot: str) -> Any:
            return textures.setdefault(slot, _blank_texture(mi, resolution, 1 if slot in grey else 3))

        material = plugin(bsdf, flat, texture)
        if needs.normal_map:
            material = {"type": NORMAL_MAP, "normals": texture("normal"), "shading": material}
        scene = mi.load_dict(patch_scene(mi, resolution, needs, material, self.samples))
        held = {slot: mi.traverse(texture) for slot, texture in textures.items()}
        params = mi.traverse(scene)
        sensor, integrator, samples = scene.sensors()[0], scene.integrator(), self.samples

        Float64, Vector64 = dr.float64_array_t(mi.Float), dr.float64_array_t(mi.Vector3f)

        def at(rows: Any, k: int) -> Any:
            return Vector64(*(dr.gather(Float64, rows.array, mi.UInt32(3 * k + axis)) for axis in range(3)))

        @dr.wrap(source="torch", target="drjit")
        def trace(camera: Any, light: Any, intensity: Any, *tensors: Any) -> list:
            maps = dict(zip(names, tensors))
            slots = slot_values(bsdf, maps, flat) | ({"normal": maps["normal"]} if needs.normal_map else {})
            for slot, value in slots.items():
                held[slot]["data"] = value[::-1]  # texture row 0 is v = 0, the bottom
                held[slot].update()
            images = []
            for k in range(camera.shape[0]):
                sensor.position = at(camera, k)
                params["light.position"] = mi.Point3f(at(light, k))
                params["light.intensity.value"] = mi.Color3f(at(intensity, k))
                params.update()
                images.append(integrator.render(scene, sensor, seed=0, spp=samples))
            return images

        return trace


def _blank_texture(mi: ModuleType, resolution: int, channels: int) -> Any:
    """A bitmap texture to be filled, read at texel centres without filtering."""
    import drjit as dr

    data = mi.TensorXf(dr.full(mi.Float, 0.5, resolution * resolution * channels),
                       (resolution, resolution, channels))
    return mi.load_dict({"type": "bitmap", "data": data, "raw": True, "filter_type": "nearest",
                         "wrap_mode": "clamp"})


def patch_scene(mi: ModuleType, resolution: int, needs: Needs, bsdf: dict, samples: int = 1) -> dict:
    """The Mitsuba scene of a patch of side 1 under one point light, in R x R pixels."""
    environment = {"environment": {"type": "constant", "radiance": {"type": "rgb", "value": 0.0},
                                   "sampling_weight": 0.0}}
    return {
        "type": "scene",
        "integrator": {"type": INTEGRATOR, "shadow_rays": needs.shadow_rays, "bounces": int(needs.path_depth),
                       "environment": needs.environment},
        "sensor": {"type": CAMERA,
                   "film": {"type": "hdrfilm", "width": resolution, "height": resolution,
                            "pixel_format": "rgb",
                            "component_format": "float32", "rfilter": {"type": "box"}},
                   "sampler": {"type": "stratified", "sample_count": samples, "jitter": samples > 1}},
        "light": {"type": "point", "position": [0.0, 0.0, 1.0], "intensity": {"type": "rgb", "value": 1.0}},
        "patch": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(0.5),
                  "bsdf": bsdf},
    } | (environment if needs.environment else {})


def _falloff_undone(views: Views, resolution: int) -> Tensor:
    """d^2 of each texel over d^2 of the patch centre, N x R x R x 1: undoes the falloff 1/d^2."""
    from ..views import texel_positions

    to_light = views.light[:, None, None] - texel_positions(resolution).to(views.light)
    return (to_light**2).sum(-1, keepdim=True) / (views.light**2).sum(-1)[:, None, None, None]
