"""The traced Mitsuba scene through ``dr.wrap``: rectangle, point light, and the camera of a rectified photo.

There is one unjittered sample a pixel and a box filter: every ray hits its texel's centre, so the image has
no noise.
"""

import math
from collections.abc import Callable
from types import ModuleType
from typing import Any

from torch import Tensor

from ..errors import ConfigError
from ..io.entry import entry
from ..material.maps import SVBRDF
from ..views import Views, texel_positions
from .bsdf import plugin, slot_values
from .exclusive import MitsubaRenderer
from .needs import Needs
from .plugins import CAMERA, INTEGRATOR
from .texels import row

GREY = ("alpha", "metallic", "roughness")


class SceneRenderer(MitsubaRenderer):
    """Traces rays from the camera to the patch and on to the light."""

    name = "mitsuba-scene"
    replayed = True

    @entry()
    def render(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """Linear radiance N x R x R x 3, float32; gradients to the maps, but not to camera and light:
        emitters and sensors called by a ray have none. ConfigError: such a gradient, or only one texel.
        """
        if any(t.requires_grad for t in (views.camera, views.light, views.intensity)):
            raise ConfigError("views held fixed", "a gradient asked of camera, light or intensity",
                              "use the renderer 'mitsuba' or 'analytic' to fit these")
        if svbrdf.resolution < 2:  # Mitsuba cannot update a smaller texture
            raise ConfigError("2 x 2 texels or more", "1 x 1", "use the renderer 'mitsuba' or 'analytic'")
        images = super().render(svbrdf, views)
        if views.falloff == "inverse-square":
            return images
        # d^2 of each texel over d^2 of the patch centre undoes the falloff 1/d^2
        light = views.in_patch_sides().light
        to_light = light[:, None, None] - texel_positions(svbrdf.resolution).to(light)
        undone = (to_light**2).sum(-1, keepdim=True) / (light**2).sum(-1)[:, None, None, None]
        return images * undone.to(images)

    def _wrap(self, bsdf: str, needs: Needs, side: int, falloff: str,
              names: tuple[str, ...]) -> Callable[..., list[Tensor]]:
        import drjit as dr

        mi = self.mi
        textures: dict[str, Any] = {}
        grey = GREY if needs.coloured_specular else (*GREY, "f0", f"specular_x{needs.lobes}")

        def texture(slot: str) -> Any:  # filled later; read at texel centres without filtering
            shape = side, side, 1 if slot in grey else 3
            data = mi.TensorXf(dr.full(mi.Float, 0.5, math.prod(shape)), shape)
            return textures.setdefault(slot, mi.load_dict({
                "type": "bitmap", "data": data, "raw": True, "filter_type": "nearest", "wrap_mode": "clamp"}))

        scene = mi.load_dict(patch_scene(mi, side, needs, plugin(bsdf, needs, texture)))
        held = {slot: mi.traverse(texture) for slot, texture in textures.items()}
        params = mi.traverse(scene)
        sensor, integrator = scene.sensors()[0], scene.integrator()

        @dr.wrap(source="torch", target="drjit")
        def trace(cameras: Any, lights: Any, intensities: Any, *tensors: Any) -> list:
            for slot, value in slot_values(bsdf, dict(zip(names, tensors)), needs).items():
                held[slot]["data"] = value[::-1]  # texture row 0 is v = 0, the bottom
                held[slot].update()
            images = []
            for k in range(cameras.shape[0]):
                sensor.position, light, intensity = (row(mi, rows.array, k)
                                                     for rows in (cameras, lights, intensities))
                params["light.position"] = mi.Point3f(light)
                params["light.intensity.value"] = mi.Color3f(intensity)
                params.update()
                images.append(integrator.render(scene, sensor, seed=0, spp=1))
            return images

        return trace


def patch_scene(mi: ModuleType, resolution: int, needs: Needs, bsdf: dict) -> dict:
    """The Mitsuba scene of a patch of side 1 under one point light, in R x R pixels."""
    environment = {"environment": {"type": "constant", "radiance": {"type": "rgb", "value": 0.0},
                                   "sampling_weight": 0.0}}
    return {
        "type": "scene",
        "integrator": {"type": INTEGRATOR, "shadow_rays": needs.shadow_rays, "bounces": int(needs.path_depth),
                       "environment": needs.environment},
        "sensor": {"type": CAMERA,
                   "film": {"type": "hdrfilm", "width": resolution, "height": resolution,
                            "pixel_format": "rgb", "component_format": "float32", "rfilter": {"type": "box"}},
                   "sampler": {"type": "stratified", "sample_count": 1, "jitter": False}},
        "light": {"type": "point", "position": [0.0, 0.0, 1.0], "intensity": {"type": "rgb", "value": 1.0}},
        "patch": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(0.5), "bsdf": bsdf},
    } | (environment if needs.environment else {})
