"""Renderers with one protocol: maps and views in, linear unclamped radiance out.

========================  ==========================================================================
``analytic``              the formulas in torch, float32
``analytic64``            the same in float64: the reference for the others
``mitsuba``               Mitsuba's BSDF plugins evaluated at the texels: no rays, no texture look-ups
``mitsuba-scene``         the traced Mitsuba scene: rectangle, point light, the camera of a rectified photo
========================  ==========================================================================
"""

from typing import Literal, Protocol, get_args

import torch
from torch import Tensor

from ..errors import ConfigError
from ..kinds import kinds_checked
from ..material.maps import SVBRDF
from ..views import Views
from .needs import Needs

RendererName = Literal["mitsuba", "mitsuba-scene", "analytic", "analytic64"]
RENDERERS: tuple[RendererName, ...] = ("mitsuba", "mitsuba-scene", "analytic")  # compared with analytic64


class Renderer(Protocol):
    """What every renderer offers. Renderers can be copied and pickled; a copy compiles its kernels anew."""

    @property
    def name(self) -> str:
        """The name that :func:`make_renderer` takes."""
        ...

    @property
    def variant(self) -> str | None:
        """The Mitsuba variant in use; None if the renderer does not use Mitsuba."""
        ...

    def render(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """Linear radiance of the patch as each view sees it, rectified: N x R x R x 3, row 0 at the top.

        Differentiable with respect to the maps; ``analytic`` and ``mitsuba`` also with respect to camera,
        light and intensity.

        Raises:
            NotFiniteError: a value of a map or a number of a view is NaN or infinite.
            ConfigError: a gradient or a size that the renderer does not support.
        """
        ...


@kinds_checked
def make_renderer(name: str = "mitsuba", variant: str = "llvm_ad_rgb",
                  needs: Needs | None = None) -> Renderer:
    """The renderer of this name; Mitsuba is loaded only for the two that need it.

    Args:
        name: ``mitsuba``, ``mitsuba-scene``, ``analytic`` or ``analytic64`` (in float64).
        variant: the Mitsuba variant, ``llvm_ad_rgb`` or ``cuda_ad_rgb``.
        needs: what to compute; default: what each scene needs. Set it to measure what an omission saves.

    Raises:
        ConfigError: unknown name.
        BackendError: Mitsuba or libLLVM is missing; the message says what to install.
    """
    if name not in get_args(RendererName):
        raise ConfigError(f"a renderer of {get_args(RendererName)}", repr(name), "choose one of these")
    if name == "mitsuba":
        from .texels import TexelRenderer
        return TexelRenderer(variant, needs)
    if name == "mitsuba-scene":
        from .scene import SceneRenderer
        return SceneRenderer(variant, needs)
    from .analytic import AnalyticRenderer
    return AnalyticRenderer(torch.float64 if name == "analytic64" else torch.float32, needs)


__all__ = ["RENDERERS", "Renderer", "RendererName", "make_renderer"]
