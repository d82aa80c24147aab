"""A picture of a material at a glance: a sphere that wears it, in the studio."""

from __future__ import annotations

import torch
from torch import Tensor

from ..material.maps import SVBRDF
from ..render.llvm import mitsuba_module
from .passes import shown
from .stage import make_stage

SAMPLES = 64


def sphere(svbrdf: SVBRDF, size: int = 512, tiling: int = 2, variant: str = "llvm_ad_rgb") -> Tensor:
    """The sphere as display values, size x size x 3.

    Args:
        svbrdf: the material.
        size: of the picture in pixels.
        tiling: how often the maps are repeated along a side.
        variant: Mitsuba variant.

    Raises:
        BackendError: Mitsuba, the variant or libLLVM is missing.
    """
    mi = mitsuba_module(variant)
    stage = make_stage(mi, svbrdf, "sphere", size=(size, size), tiling=tiling)
    picture = mi.render(stage.at(mi), spp=SAMPLES, seed=0)
    return shown(torch.tensor(picture.numpy()), 0.0)
