"""The two BSDFs in plain torch, in any float dtype, without Mitsuba.

Cook-Torrance as in the paper (III.E): f = rho_d / pi + D(alpha, n.h) G(n.l, n.v) F / (4 n.l n.v), GGX D,
separable Smith G. Radiance L = f (n.l) I / d^2. If camera and light coincide, F is exactly F0 (h = l). Else F
is the unpolarised Fresnel reflectance of the refractive index that has F0 at normal incidence, as in
Mitsuba's ``roughconductor`` (which does not offer the paper's Schlick curve).

On valid input, no formula and no derivative cancels, overflows or divides by zero in float32.
docs/results/lab-notes.md lists the errors of simpler forms.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from ..io.entry import entry
from ..material.maps import DIELECTRIC_F0, SVBRDF
from ..views import Views, texel_positions
from .bsdf import F0_RANGE, MIN_ALPHA_PRINCIPLED, needed_maps
from .needs import Needs, refuse_not_finite, scene_needs

MIN_ALPHA = {"roughconductor": 1e-4, "principled": MIN_ALPHA_PRINCIPLED}  # lowest GGX alpha in Mitsuba


class AnalyticRenderer:
    """A :class:`mitsvbrdf.render.Renderer` in torch. It computes ``needs``, by default what a scene needs."""

    variant = None

    def __init__(self, dtype: torch.dtype = torch.float32, needs: Needs | None = None) -> None:
        self.dtype, self.needs = dtype, needs
        self.name = "analytic64" if dtype == torch.float64 else "analytic"

    @entry()
    def render(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """Linear radiance N x R x R x 3 of this dtype; gradients to maps, camera, light and intensity."""
        refuse_not_finite(svbrdf, views)
        needs = self.needs or scene_needs(svbrdf, views, self.name)
        maps = {name: value.to(self.dtype) for name, value in needed_maps(svbrdf, needs).items()}
        cosines, irradiance = _geometry(maps.get("normal"), views, svbrdf.resolution)
        lit = (cosines.n_l > 0) & (cosines.n_v > 0)
        # Where the surface faces away, the result is 0. A cosine of 1 there keeps all gradients finite.
        cosines = cosines._replace(n_l=torch.where(lit, cosines.n_l, 1.0),
                                   n_v=torch.where(lit, cosines.n_v, 1.0))
        c = Cosines(*(x.to(self.dtype) for x in cosines))

        if svbrdf.bsdf == "roughconductor":
            value = maps["diffuse"] / torch.pi * c.n_l if needs.diffuse_lobe else 0.0
            if needs.specular_lobe:
                f0 = maps["specular"]
                fresnel = _fresnel(f0, c.h_l) if needs.fresnel_curve else f0
                value = value + _specular(_alpha(svbrdf.bsdf, maps["roughness"]), c) * fresnel
        else:
            value = _principled(maps, c)

        return torch.where(lit, value, 0.0) * irradiance.to(self.dtype)


class Cosines(NamedTuple):
    """Cosines between normal n, light l, camera v and half vector h, each N x R x R x 1.

    ``across2`` is |n x h|^2, the squared sine of the angle whose cosine is ``n_h``.
    """

    n_l: Tensor
    n_v: Tensor
    n_h: Tensor
    across2: Tensor
    h_l: Tensor


def _geometry(normal: Tensor | None, views: Views, resolution: int) -> tuple[Cosines, Tensor]:
    """Cosines and I / d^2, always in float64. ``normal`` None: n is the plane's normal.

    l + v cancels if light and camera are low on opposite sides: 100 patch sides away and 0.01 above the
    plane, float32 keeps one digit of h. n x h cancels near every highlight: at roughness 0.1, float32
    gradients have errors of 3e-6. The d^2 of a light 1e20 units away overflows float32.
    """
    views = views.in_patch_sides().to(torch.float64)
    position = texel_positions(resolution)
    n = (torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64) if normal is None
         else F.normalize(normal.double(), dim=-1))
    to_camera = views.camera[:, None, None] - position
    to_light = views.light[:, None, None] - position
    v, l = F.normalize(to_camera, dim=-1), F.normalize(to_light, dim=-1)  # noqa: E741  (as in the field)
    h = F.normalize(l + v, dim=-1)
    across = torch.linalg.cross(n.expand_as(h), h)
    reach = to_light if views.falloff == "inverse-square" else views.light[:, None, None]
    return (Cosines(_dot(n, l), _dot(n, v), _dot(n, h), _dot(across, across), _dot(h, l)),
            views.intensity[:, None, None] / _dot(reach, reach))


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(dim=-1, keepdim=True)


def _alpha(bsdf: str, roughness: Tensor) -> Tensor:
    """GGX alpha, at least :data:`MIN_ALPHA`; its gradient is 0 there and below, as in Mitsuba."""
    alpha, least = roughness**2, MIN_ALPHA[bsdf]
    return torch.where(alpha > least, alpha, least)


def _specular(alpha: Tensor, c: Cosines) -> Tensor:
    """D G / (4 n.v): the specular BRDF divided by F, times n.l."""
    a2 = alpha**2
    # a2 c^2 + (1 - c^2) with 1 - c^2 as |n x h|^2: c^2 (a2 - 1) + 1 would cancel near the highlight.
    d = a2 / (torch.pi * (a2 * c.n_h**2 + c.across2) ** 2)
    # G has a factor 4 n.l n.v. Here it is cancelled against the denominator's, so 0 / 0 cannot occur.
    return d * c.n_l / (_smith(a2, c.n_l) * _smith(a2, c.n_v))


def _smith(a2: Tensor, cosine: Tensor) -> Tensor:
    """2 cos / G1 of GGX masking, one direction (Walter et al. 2007, eq. 34)."""
    return cosine + torch.sqrt(a2 + (1 - a2) * cosine**2)


def _fresnel(f0: Tensor, cosine: Tensor) -> Tensor:
    """Unpolarised reflectance at cosine c, for the real refractive index (1 + s) / (1 - s) with s = sqrt F0.

    Let a = 1 - s, b = 1 + s and g = sqrt(4 s + a^2 c^2). Both amplitudes, r_s = (a c - g) / (a c + g) and
    r_p = (b^2 c - a g) / (b^2 c + a g), have a factor 4 s. It is taken out here, so no nearly equal numbers
    are subtracted, even at F0 = 0 or 1. Computed from the index, F had an error of 6e-8 / F0. Outside
    F0_RANGE, F is proportional to F0, as in the scenes for Mitsuba, which needs the index.
    """
    low, high = F0_RANGE
    # at both ends the slope of ``cut`` is 0, in any precision
    cut = torch.where(f0 > low, torch.where(f0 < high, f0, high), low)
    s = cut.sqrt()
    a, b2 = (1 - cut) / (1 + s), (1 + s) ** 2
    ac = a * cosine
    g = torch.sqrt(4 * s + ac**2)
    s_wave = 1 / (ac + g) ** 2
    p_wave = (2 * cosine**2 * (1 + cut) - a**2) / (b2 * cosine + a * g) ** 2
    return 8 * f0 * (s_wave**2 + p_wave**2)


def _principled(maps: dict[str, Tensor], c: Cosines) -> Tensor:
    """Mitsuba's ``principled`` with base colour, metallic and roughness, times n.l (Burley 2012 and 2015)."""
    base, metallic, roughness = maps["base_color"], maps.get("metallic", 0.0), maps["roughness"]
    metal = base + (1 - base) * (1 - c.h_l) ** 5
    glass = _fresnel(base.new_tensor(DIELECTRIC_F0), c.h_l)
    specular = _specular(_alpha("principled", roughness), c) * (metallic * metal + (1 - metallic) * glass)

    w_l, w_v = (1 - c.n_l) ** 5, (1 - c.n_v) ** 5
    retro = 2 * roughness * c.h_l**2
    burley = (1 - w_l / 2) * (1 - w_v / 2) + retro * (w_l + w_v + w_l * w_v * (retro - 1))
    return (1 - metallic) * base / torch.pi * c.n_l * burley + specular
