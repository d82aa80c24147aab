"""The readable twin: the same two BSDFs in plain torch, in any float dtype. It illustrates, checks and needs no Mitsuba.

Cook-Torrance as the paper (III.E): f = rho_d / pi + D(alpha, n.h) G(n.l, n.v) F / (4 n.l n.v), GGX D, separable Smith
G. Radiance L = f (n.l) I / d^2. F is F0 where camera and light coincide (h = l, so it is exact); elsewhere the
unpolarised Fresnel reflectance of the refractive index that has F0 at normal incidence, which is what Mitsuba's
``roughconductor`` computes (the paper's Schlick curve is not among its options).
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ..maps import SVBRDF
from ..views import Views, texel_positions
from .bsdf import MIN_ALPHA_PRINCIPLED, index_from_f0
from .needs import scene_needs


class AnalyticRenderer:
    """Renders with torch; see :class:`mitsvbrdf.render.Renderer`.

    Args:
        dtype: float32 or float64 (the truth).
    """

    variant = None

    def __init__(self, dtype: torch.dtype = torch.float32) -> None:
        self.dtype = dtype
        self.name = "analytic64" if dtype == torch.float64 else "analytic"

    def render(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """Linear radiance N x R x R x 3 of this renderer's dtype; gradients to maps, camera, light and intensity."""
        curve = scene_needs(svbrdf.bsdf, views, self.name).fresnel_curve
        maps = {name: value.to(self.dtype) for name, value in svbrdf.maps.items()}
        views = views.in_patch_sides().to(self.dtype)
        position = texel_positions(svbrdf.resolution, self.dtype)
        normal = F.normalize(maps["normal"], dim=-1)

        to_camera = views.camera[:, None, None] - position
        to_light = views.light[:, None, None] - position
        v = F.normalize(to_camera, dim=-1)
        l = F.normalize(to_light, dim=-1)  # noqa: E741  (the field's symbol)
        h = F.normalize(l + v, dim=-1)
        n_l, n_v = _dot(normal, l), _dot(normal, v)
        lit = (n_l > 0) & (n_v > 0)
        # Where the surface turns away the result is 0; a harmless 1 keeps the gradient of the rest finite.
        n_l, n_v = torch.where(lit, n_l, 1.0), torch.where(lit, n_v, 1.0)

        if svbrdf.bsdf == "roughconductor":
            alpha = maps["roughness"] ** 2
            fresnel = _fresnel(index_from_f0(maps["specular"]), _dot(h, l)) if curve else maps["specular"]
            value = maps["diffuse"] / torch.pi * n_l + _specular(alpha, normal, h, n_l, n_v) * fresnel
        else:
            value = _principled(maps, normal, l, h, n_l, n_v)

        distance2 = _dot(to_light, to_light) if views.falloff == "inverse-square" else _dot(
            views.light, views.light)[:, None, None]
        return torch.where(lit, value, 0.0) * views.intensity[:, None, None] / distance2


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(dim=-1, keepdim=True)


def _specular(alpha: Tensor, normal: Tensor, h: Tensor, n_l: Tensor, n_v: Tensor) -> Tensor:
    """D G / (4 n.v), that is the specular BRDF over F, times n.l."""
    a2 = alpha**2
    n_h = _dot(normal, h)
    across = torch.linalg.cross(normal.expand_as(h), h)
    # a2 c^2 + (1 - c^2) with 1 - c^2 as |n x h|^2: c^2 (a2 - 1) + 1 would cancel near the highlight.
    d = a2 / (torch.pi * (a2 * n_h**2 + _dot(across, across)) ** 2)
    return d * _smith(a2, n_l) * _smith(a2, n_v) / (4 * n_v)


def _smith(a2: Tensor, cosine: Tensor) -> Tensor:
    """GGX masking of one direction (Walter et al. 2007, eq. 34)."""
    return 2 * cosine / (cosine + torch.sqrt(a2 + (1 - a2) * cosine**2))


def _fresnel(eta: Tensor, cosine: Tensor) -> Tensor:
    """Unpolarised reflectance of a real refractive index eta >= 1 at this cosine."""
    cosine_t = torch.sqrt(1 - (1 - cosine**2) / eta**2)
    s = (cosine - eta * cosine_t) / (cosine + eta * cosine_t)
    p = (eta * cosine - cosine_t) / (eta * cosine + cosine_t)
    return (s**2 + p**2) / 2


def _principled(maps: dict[str, Tensor], normal: Tensor, l: Tensor, h: Tensor, n_l: Tensor, n_v: Tensor) -> Tensor:  # noqa: E741
    """Mitsuba's ``principled`` with base colour, metallic and roughness, times n.l (Burley 2012 and 2015)."""
    base, metallic, roughness = maps["base_color"], maps["metallic"], maps["roughness"]
    alpha = (roughness**2).clamp_min(MIN_ALPHA_PRINCIPLED)
    h_l = _dot(h, l)
    metal = base + (1 - base) * (1 - h_l) ** 5
    glass = _fresnel(torch.tensor(1.5, dtype=base.dtype), h_l)
    specular = _specular(alpha, normal, h, n_l, n_v) * (metallic * metal + (1 - metallic) * glass)

    w_l, w_v = (1 - n_l) ** 5, (1 - n_v) ** 5
    retro = 2 * roughness * h_l**2
    burley = (1 - w_l / 2) * (1 - w_v / 2) + retro * (w_l + w_v + w_l * w_v * (retro - 1))
    return (1 - metallic) * base / torch.pi * n_l * burley + specular
