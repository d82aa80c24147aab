"""How far each texel may be from the answer, by its own photos, and with look-alikes.

The deviation d of a number is measured from the answer that the fit gives, wherever that lies in what the
photos leave open (:mod:`.posterior`). Within d of the answer lie 68 % of it, and within 3 d at least 98 %:
of a normal distribution around the answer, d is the standard deviation. An answer at the edge of what the
photos leave open has a wide one. What is wrong for all photos alike, such as the light power, is not in it.

Numbers are those in which errors are counted (docs/conventions.md). Each has a range of 1; of one that no
photo tells, the deviation is that of a uniform number, 1 / sqrt(12).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from .. import color
from ..material.maps import SVBRDF
from ..views import Views
from .hierarchical.sharing import appearance_of, membership
from .hierarchical.texel_prior import SHARED
from .posterior import Mixture, OwnPhotos, half_width, step_of, with_look_alikes
from .task import FitTask

UNKNOWN = 1 / math.sqrt(12)
DETERMINED = 0.1  # a texel counts as determined when its deviation is below this
ONE, THREE = 0.6827, 0.98  # what one and three deviations hold, at least
Deviations = dict[str, Tensor]


def deviations(svbrdf: SVBRDF, views: Views, task: FitTask,
               basis: Tensor | None = None) -> tuple[Deviations, Deviations]:
    """Deviations of the fitted maps by own photos, and with look-alikes: by name r x r x C, r <= 64, float32.

    Without look-alikes the latter have no map.

    They are those of every k-th texel, k = R / 64 rounded up; C is 2 of a normal (x and y).

    Args:
        svbrdf, views: as fitted.
        task: the photos and the fixed maps.
        basis: appearance of the basis materials whose texels share numbers, K x 5; None where none do.

    Raises:
        BackendError: Mitsuba, the variant or libLLVM is missing.
    """
    side, capture = svbrdf.resolution, task.capture
    step = step_of(side)
    every = slice(step // 2, None, step)

    def some(value: Tensor) -> Tensor:
        return value[..., every, every, :].contiguous()

    measured = capture.measured
    capture = capture.but(photos=color.shown(some(capture.stored)), views=seen_by(views, side, step),
                      measured=None if measured is None else some(measured[..., None])[..., 0])
    own = OwnPhotos(svbrdf.map(some), capture, task.renderer,
                    {name: some(value) for name, value in task.fixed.items()}, task.config.grey_specular)
    mixture, shared = own.mixture(), own.solver.unknowns.of(*SHARED)
    alone = {name: torch.where(own.refused[..., None], value.clamp_min(DETERMINED), value)
             for name, value in _stated(own, mixture).items()}
    if basis is None or not len(shared):
        return alone, {}
    member = membership(appearance_of(capture, some(task.guess)), basis, task.config.similarity)
    return alone, _stated(own, with_look_alikes(mixture, shared, member, len(capture),
                                                own.answer.flatten(1).T))


def _stated(own: OwnPhotos, mixture: Mixture) -> Deviations:
    """The deviations of each map from what its numbers may be."""
    answer, names, side = own.answer.flatten(1).T, own.names, own.answer.shape[-1]
    spread = half_width(mixture, answer, names, ONE).maximum(half_width(mixture, answer, names, THREE) / 3)
    found = {}
    for name, of in own.solver.unknowns.slices.items():
        value = spread[:, of]
        if name == "normal":  # slopes n_x / n_z and n_y / n_z: the slope of (n_x + 1) / 2 by them
            square = answer[:, of].square()
            value = value / 2 * (1 + square.flip(1)) / (1 + square.sum(dim=1, keepdim=True)) ** 1.5
        found[name] = value.clamp_max(UNKNOWN).reshape(side, side, -1)
    return found


def seen_by(views: Views, side: int, step: int) -> Views:
    """Views as every step-th texel of a patch of ``side`` texels sees them, as if these were all of it."""
    views = views.in_patch_sides()
    count = len(range(step // 2, side, step))
    scale, middle = count * step / side, (step // 2 + 0.5 + (count - 1) * step / 2) / side - 0.5
    moved = views.camera.new_tensor([middle, -middle, 0.0])
    light = (views.light - moved) / scale
    power = (light.norm(dim=1) / views.light.norm(dim=1)).square() if views.falloff == "none" else scale**-2
    return replace(views, camera=(views.camera - moved) / scale, light=light,
                   intensity=(views.intensity.T * power).T)


def confidence(alone: Mapping[str, Tensor], alike: Mapping[str, Tensor]) -> dict[str, dict[str, float]]:
    """By map ``median_sd``, ``determined_share`` (below 0.1); the median ``with_look_alikes`` if known."""
    found = {}
    for name, value in alone.items():
        texels = of_texels(value)
        found[name] = {"median_sd": float(texels.median()),
                       "determined_share": float((texels < DETERMINED).float().mean())}
        found[name] |= {"with_look_alikes": float(of_texels(alike[name]).median())} if alike else {}
    return found


def of_texels(value: Tensor) -> Tensor:
    """The deviation of each texel, r x r: the root mean square over its channels."""
    return value.square().mean(dim=-1).sqrt()
