"""A picture of a material at a glance: a sphere that wears it, in the studio."""

from __future__ import annotations

from types import ModuleType

import torch
from torch import Tensor

from ..io.entry import entry
from ..material.maps import SVBRDF
from ..render.exclusive import using_mitsuba
from .passes import shown
from .stage import make_stage

SAMPLES = 64


def mirrored(svbrdf: SVBRDF) -> SVBRDF:
    """The material beside its mirror images, 2 R x 2 R: all edges meet, those to the next repetition too."""
    def both(name: str, value: Tensor, axis: int, turned: int) -> Tensor:
        image = value.flip(axis)
        if name == "normal":
            image = image * (1 - 2 * torch.eye(3, dtype=value.dtype)[turned])
        return torch.cat((value, image), dim=axis)

    return SVBRDF(svbrdf.bsdf, {name: both(name, both(name, value, 1, 0), 0, 1)
                                for name, value in svbrdf.maps.items()})


@entry()
def sphere(svbrdf: SVBRDF, size: int = 512, variant: str = "llvm_ad_rgb") -> Tensor:
    """The sphere as display values, size x size x 3; maps and mirror images cover it without a seam.

    Args:
        size: of the picture in pixels.

    Raises:
        BackendError: Mitsuba, the variant or libLLVM is missing.
    """
    half = svbrdf.resolution // 2  # a whole patch faces the camera
    covering = mirrored(svbrdf).map(lambda value: value.roll((half, half), (0, 1)))
    with using_mitsuba(variant) as mi:
        return shown(_picture(mi, covering, size), 0.0)


def _picture(mi: ModuleType, covering: SVBRDF, size: int) -> Tensor:
    """Linear radiance, size x size x 3; nothing of Mitsuba's is left behind."""
    stage = make_stage(mi, covering, "sphere", size=(size, size), tiling=1)
    return torch.tensor(mi.render(stage.at(mi), spp=SAMPLES, seed=0).numpy())
