"""What a scene needs to be rendered exactly, and what is omitted because the scene does not need it."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..material.maps import SVBRDF
from ..views import Views

# Up to this half angle theta between camera and light, the unpolarised Fresnel reflectance differs from F0 by
# at most 4e-7, relative. The difference is 0.5 theta^4 for F0 = 0.04 (2.3e-7), and highest for F0 -> 0:
# 0.85 theta^4 (4e-7).
CONSTANT_FRESNEL_DEGREES = 1.5


class Omitted(NamedTuple):
    """Something that is not computed, and why."""

    what: str
    why: str


@dataclass(frozen=True)
class Needs:
    """What to compute, by default everything; :func:`scene_needs` drops what changes no pixel or gradient."""

    diffuse_lobe: bool = True  # of roughconductor materials
    specular_lobe: bool = True  # of roughconductor materials
    coloured_specular: bool = True  # three specular channels instead of one that serves all
    metallic: bool = True  # the metallic map of principled materials
    normal_map: bool = True  # shading frames that differ from the plane's
    fresnel_curve: bool = True  # reflectance that depends on the angle, instead of F0
    # these three in the traced scene only: rays that test whether light reaches the patch
    shadow_rays: bool = True
    path_depth: bool = True  # light that arrives after a bounce
    environment: bool = True  # light from an environment
    omitted: tuple[Omitted, ...] = field(default=(), compare=False)  # what is not computed

    @property
    def lobes(self) -> int:
        """How many lobes of a ``roughconductor`` material are summed: 1 or 2."""
        return self.diffuse_lobe + self.specular_lobe


def scene_needs(svbrdf: SVBRDF, views: Views, renderer: str) -> Needs:
    """Decide from material, views and renderer what to compute for a point-lit plane.

    A lobe, a colour or a normal map is omitted if it changes no pixel and its map needs no gradient: a map of
    0 can have a gradient. A grey specular map that is expanded from one channel (``Tensor.expand``) may need
    one: the gradient belongs to the channel, not to the expanded tensor.

    ``analytic64``, the reference of comparisons, omits the Fresnel curve only if each camera is at the
    place of its light.
    """
    of_material = material_needs(svbrdf)
    angle = half_angle_bound(views)
    curve = (svbrdf.bsdf == "roughconductor"
             and angle > (0 if renderer == "analytic64" else CONSTANT_FRESNEL_DEGREES))
    omitted = list(of_material.omitted)
    if svbrdf.bsdf == "roughconductor" and of_material.specular_lobe and not curve:
        together = "in one place: F = F0"
        near = f"at most {angle:.2g} degrees from the half vector: F = F0 within 4e-7"
        omitted.append(Omitted("Fresnel curve", f"camera and light {near if angle > 1e-6 else together}"))
    omitted.append(Omitted("interreflection and path depth", "a plane does not see itself"))
    omitted.append(Omitted("shadow rays", "nothing stands between a plane and a point light above it"))
    omitted.append(Omitted("environment", "the flash is the only light"))
    if renderer != "mitsuba-scene":
        omitted.append(Omitted("ray tracing", "the texel behind each pixel of a rectified photo is known"))
    if renderer == "mitsuba":
        omitted.append(Omitted("texture look-ups",
                               "pixel = texel: each thread has its own texel's maps in registers"))
    if views.falloff == "none":
        omitted.append(Omitted("light falloff", "the views have falloff none"))
    return replace(of_material, fresnel_curve=curve and of_material.specular_lobe, shadow_rays=False,
                   path_depth=False, environment=False, omitted=tuple(omitted))


def material_needs(svbrdf: SVBRDF) -> Needs:
    """What to compute for these maps with any cameras and lights."""
    unneeded, omitted = set[str](), list[Omitted]()

    def omit(flag: str, what: str, why: str) -> None:
        unneeded.add(flag)
        omitted.append(Omitted(what, why))

    if svbrdf.bsdf == "principled":
        unneeded.add("fresnel_curve")
        if _is_zero(svbrdf["metallic"]):
            omit("metallic", "metallic map", "it is 0 and held fixed")
    else:
        unneeded.add("metallic")
        if _is_zero(svbrdf["specular"]) and not svbrdf["roughness"].requires_grad:
            unneeded |= {"coloured_specular", "fresnel_curve"}
            omit("specular_lobe", "specular lobe", "the specular map is 0 and held fixed")
        else:
            if _is_zero(svbrdf["diffuse"]):
                omit("diffuse_lobe", "diffuse lobe", "the diffuse map is 0 and held fixed")
            if _is_grey(svbrdf["specular"]):
                omit("coloured_specular", "colour of the specular map", "its three channels are one")
    if _is_flat(svbrdf["normal"]):
        omit("normal_map", "normal map", "it is flat and held fixed")
    return replace(Needs(), **dict.fromkeys(unneeded, False), omitted=tuple(omitted))


def refuse_not_finite(svbrdf: SVBRDF, views: Views) -> None:
    """Raise NotFiniteError for NaN and infinity, which Mitsuba would draw as plausible light.

    One sum of each tensor detects both, in some 0.1 ms. A sum may overflow: then each value is checked.
    """
    numbers = (*svbrdf.maps.values(), views.camera, views.light, views.intensity)
    if not bool(torch.stack([t.detach().sum().double() for t in numbers]).isfinite().all()):
        svbrdf.check_finite()
        views.check_finite()


def half_angle_bound(views: Views) -> float:
    """Upper bound in degrees of the angle between half vector and light, over all views and points.

    A segment of length d, here from camera to light, looks largest from the side: at distance r it spans at
    most 2 atan(d / (2 r)). The segment's distance from the patch is at least that of its middle minus d / 2,
    and at least the height of its lower end.
    """
    v = views.in_patch_sides().to(torch.float64)
    camera, light = v.camera.detach(), v.light.detach()
    middle, half = (camera + light) / 2, (camera - light).norm(dim=-1) / 2
    outside = torch.cat(((middle[:, :2].abs() - 0.5).clamp_min(0), middle[:, 2:]), dim=-1)
    nearest = torch.maximum(outside.norm(dim=-1) - half, torch.minimum(camera[:, 2], light[:, 2]))
    return float(torch.rad2deg(torch.atan2(half, nearest)).max())


def _is_zero(value: Tensor) -> bool:
    return not value.requires_grad and not bool(value.any())


def _is_grey(value: Tensor) -> bool:
    expanded = value.stride(-1) == 0 and not (value.is_leaf and value.requires_grad)
    return expanded or not value.requires_grad and bool((value == value[..., :1]).all())


def _is_flat(normal: Tensor) -> bool:
    return not normal.requires_grad and not bool(normal[..., :2].any())
