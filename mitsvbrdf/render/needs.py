"""What a scene needs to be rendered exactly, and what was left out because it needs not."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
import torch.nn.functional as F
from torch import Tensor

from ..maps import SVBRDF
from ..views import Views

# Up to this half angle between camera and light the unpolarised Fresnel reflectance stays within 1e-6 of F0, relative:
# it grows with the fourth power, by 0.5 theta^4 for F0 = 0.04 (3e-7) and at most by 0.85 theta^4 for F0 -> 0 (8e-7).
CONSTANT_FRESNEL_DEGREES = 1.8


@dataclass(frozen=True)
class Needs:
    """What to compute. As it stands, everything; :func:`scene_needs` takes away what changes no pixel and no gradient.

    Args:
        diffuse_lobe: of ``roughconductor`` materials.
        specular_lobe: of ``roughconductor`` materials.
        coloured_specular: three specular channels instead of one that serves all.
        metallic: the metallic map of ``principled`` materials.
        normal_map: shading frames that differ from the plane's.
        fresnel_curve: reflectance that follows the angle, instead of F0.
        shadow_rays: traced scene only, as the next two: whether light reaches the patch is asked, not known.
        path_depth: light that arrives after a bounce.
        environment: light from an environment.
        left_out: (what, why) of each thing that is not computed.
    """

    diffuse_lobe: bool = True
    specular_lobe: bool = True
    coloured_specular: bool = True
    metallic: bool = True
    normal_map: bool = True
    fresnel_curve: bool = True
    shadow_rays: bool = True
    path_depth: bool = True
    environment: bool = True
    left_out: tuple[tuple[str, str], ...] = field(default=(), compare=False)

    @property
    def lobes(self) -> int:
        """How many lobes of a ``roughconductor`` material are summed: 1 or 2."""
        return self.diffuse_lobe + self.specular_lobe


def scene_needs(svbrdf: SVBRDF, views: Views, renderer: str) -> Needs:
    """Decide from material, views and renderer what a point-lit plane does not need.

    A lobe, a colour or a normal map is left out where the map's values say that it changes nothing, unless the map wants a
    gradient: one at 0 has a slope. A grey specular map may want one if it is a single channel expanded to three
    (``Tensor.expand``).

    Args:
        svbrdf: the material.
        views: camera and light positions.
        renderer: name of the renderer in use.
    """
    angle = largest_half_angle(views)
    curve = svbrdf.bsdf == "roughconductor" and angle > CONSTANT_FRESNEL_DEGREES
    diffuse = specular = coloured = metallic = True
    left_out = []
    if svbrdf.bsdf == "roughconductor":
        specular = not _is_zero(svbrdf["specular"])
        diffuse = not specular or not _is_zero(svbrdf["diffuse"])
        coloured = specular and not _is_grey(svbrdf["specular"])
        metallic = False
        if not specular:
            left_out.append(("specular lobe", "the specular map is 0 and held fixed"))
        if not diffuse:
            left_out.append(("diffuse lobe", "the diffuse map is 0 and held fixed"))
        if specular and not coloured:
            left_out.append(("colour of the specular map", "its three channels are one"))
        if specular and not curve:
            together = "in one place: F = F0"
            near = f"at most {angle:.2g} degrees from the half vector: F = F0 within 1e-6"
            left_out.append(("Fresnel curve", f"camera and light {near if angle > 1e-6 else together}"))
    else:
        metallic = not _is_zero(svbrdf["metallic"])
        if not metallic:
            left_out.append(("metallic map", "it is 0 and held fixed"))
    normal_map = not _is_flat(svbrdf["normal"])
    if not normal_map:
        left_out.append(("normal map", "it is flat and held fixed"))
    left_out.append(("interreflection and path depth", "a plane does not see itself"))
    left_out.append(("shadow rays", "nothing stands between a plane and a point light above it"))
    left_out.append(("environment", "the flash is the only light"))
    if renderer != "mitsuba-scene":
        left_out.append(("ray tracing", "the texel behind each pixel of a rectified photo is known"))
    if renderer == "mitsuba":
        left_out.append(("texture look-ups", "pixel = texel: each thread has its own texel's maps in registers"))
    if views.falloff == "none":
        left_out.append(("light falloff", "asked for by --falloff none"))
    return Needs(diffuse, specular, coloured, metallic, normal_map, curve and specular, False, False, False,
                 tuple(left_out))


def largest_half_angle(views: Views) -> float:
    """Largest angle in degrees between the half vector and the light, over views; on each the nearest patch point."""
    v = views.in_patch_sides().to(torch.float64)
    camera, light = v.camera.detach(), v.light.detach()
    spots = ((camera + light) / 2).clamp(-0.5, 0.5) * torch.tensor([1.0, 1.0, 0.0])
    camera, light = F.normalize(camera - spots, dim=-1), F.normalize(light - spots, dim=-1)
    half = F.normalize(camera + light, dim=-1)
    sine = torch.linalg.cross(half, light).norm(dim=-1)
    return float(torch.rad2deg(torch.asin(sine.clamp(0, 1))).max())


def _is_zero(value: Tensor) -> bool:
    return not value.requires_grad and not bool(value.any())


def _is_grey(value: Tensor) -> bool:
    return value.stride(-1) == 0 or not value.requires_grad and bool((value == value[..., :1]).all())


def _is_flat(normal: Tensor) -> bool:
    return not normal.requires_grad and not bool(normal[..., :2].any())
