"""What a scene needs to be rendered exactly, and what was left out because it needs not."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F

from ..views import Views

# Up to this half angle between camera and light the unpolarised Fresnel reflectance stays within 1e-6 of F0, relative:
# it grows with the fourth power, by 0.5 theta^4 for F0 = 0.04 (3e-7) and at most by 0.85 theta^4 for F0 -> 0 (8e-7).
CONSTANT_FRESNEL_DEGREES = 1.8


@dataclass(frozen=True)
class Needs:
    """What to compute.

    Args:
        fresnel_curve: whether reflectance has to follow the angle; else it is F0.
        left_out: (what, why) of each thing that is not computed.
    """

    fresnel_curve: bool
    left_out: tuple[tuple[str, str], ...] = ()


def scene_needs(bsdf: str, views: Views, renderer: str) -> Needs:
    """Decide from material, views and renderer what a point-lit plane does not need.

    Args:
        bsdf: the parameter set.
        views: camera and light positions.
        renderer: the renderer's name.
    """
    angle = largest_half_angle(views)
    curve = bsdf == "roughconductor" and angle > CONSTANT_FRESNEL_DEGREES
    left_out = []
    if bsdf == "roughconductor" and not curve:
        left_out.append(("Fresnel curve", f"camera and light at most {angle:.2g} degrees from the half vector: F = F0 "
                                          "within 1e-6"))
    left_out.append(("interreflection and path depth", "a plane does not see itself"))
    left_out.append(("shadow rays", "nothing stands between a plane and a point light above it"))
    if renderer != "mitsuba-scene":
        left_out.append(("ray tracing", "the texel behind each pixel of a rectified photo is known"))
    if renderer == "mitsuba":
        left_out.append(("texture look-ups", "pixel = texel: each thread has its own texel's maps in registers"))
    if views.falloff == "none":
        left_out.append(("light falloff", "asked for by --falloff none"))
    return Needs(curve, tuple(left_out))


def largest_half_angle(views: Views) -> float:
    """Largest angle in degrees between the half vector and the light, over views; on each the nearest patch point."""
    v = views.in_patch_sides().to(torch.float64)
    camera, light = v.camera.detach(), v.light.detach()
    spots = ((camera + light) / 2).clamp(-0.5, 0.5) * torch.tensor([1.0, 1.0, 0.0])
    camera, light = F.normalize(camera - spots, dim=-1), F.normalize(light - spots, dim=-1)
    half = F.normalize(camera + light, dim=-1)
    sine = torch.linalg.cross(half, light).norm(dim=-1)
    return float(torch.rad2deg(torch.asin(sine.clamp(0, 1))).max())
