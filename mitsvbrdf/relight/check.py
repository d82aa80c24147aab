"""Whether the path tracer shows what the maps say: ``novel`` frames against the float64 renderer."""

from __future__ import annotations

from types import ModuleType

import torch
from torch import Tensor

from ..io.entry import entry
from ..material.maps import SVBRDF
from ..measure.z_test import ZTest, z_test
from ..render.analytic import AnalyticRenderer
from ..views import Views
from .stage import Stage, make_stage

PASSES, PASS_SAMPLES = 16, 64  # independent pictures, and the samples a pixel of each
# Points along a texel's side at which the reference is evaluated, but no more along the patch's.
POINTS_ALONG_TEXEL, POINTS_ALONG_PATCH = 8, 2048


@entry()
def check_novel(mi: ModuleType, svbrdf: SVBRDF, views: Views | None = None, *, frame: int = 0,
                frames: int = 1, seed: int = 0, reference: AnalyticRenderer | None = None) -> ZTest:
    """Path trace a frame of ``novel``, a pixel for each texel, and test it against the analytic renderer.

    A pixel averages over its texel, across which the maps are constant but directions and distances change;
    the reference is averaged over a grid of points in each texel. Both have the Fresnel curve of a real
    refractive index.

    Args:
        mi: the ``mitsuba`` module.
        svbrdf: the material.
        views: the first camera is used; left out: as :func:`make_stage`.
        frame: which, of ``frames`` with the light in a circle around the lens.
        seed: the first of the random numbers.
        reference: what it is held against; left out: float64 with everything.

    Returns:
        The Z-test over all pixels, and over the mean of each channel.
    """
    side = svbrdf.resolution
    stage = make_stage(mi, svbrdf, "novel", environment="none", size=(side, side), frames=frames, views=views)
    scene = stage.at(mi, frame)
    passes = torch.stack([torch.from_numpy(mi.render(scene, seed=seed + k, spp=PASS_SAMPLES).numpy())
                          for k in range(PASSES)])
    return z_test(passes.mean(dim=0), passes, _reference(svbrdf, stage, frame,
                                                         reference or AnalyticRenderer(torch.float64)))


def _reference(svbrdf: SVBRDF, stage: Stage, frame: int, renderer: AnalyticRenderer) -> Tensor:
    side = svbrdf.resolution
    finer = min(max(POINTS_ALONG_PATCH // side, 2), POINTS_ALONG_TEXEL)
    fine = svbrdf.map(lambda each: each.repeat_interleave(finer, dim=0).repeat_interleave(finer, dim=1))
    assert stage.views is not None  # novel has them
    image = renderer.render(fine, stage.views.pick([frame]))[0]
    return image.reshape(side, finer, side, finer, 3).mean(dim=(1, 3))
