"""How far each texel may be from the answer, by its own photos, and with look-alikes.

The deviation d of a number is measured from the answer that the fit gives, wherever that lies in what the
photos leave open (:mod:`.posterior`). Within d of the answer lie 68 % of it, and within 3 d at least 98 %:
of a normal distribution around the answer, d is the standard deviation. An answer at the edge of what the
photos leave open has a wide one. What is wrong for all photos alike, such as the light power, is not in it.

A texel whose photos refuse its answer is not determined, whatever its look-alikes are.

The valley is followed for every k-th texel. Each texel has what the curvature of its own photos says, times
what the valley adds to that nearby.

Numbers are those in which errors are counted (docs/conventions.md). Each has a range of 1; of one that no
photo tells, the deviation is that of a uniform number, 1 / sqrt(12).
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from .. import color
from ..capture import Capture
from ..material.maps import SVBRDF
from ..material.resample import resized
from ..views import Views
from .hierarchical.sharing import appearance_of, membership
from .hierarchical.solver import Observations, TexelSolver
from .hierarchical.texel_prior import SHARED
from .posterior import GRID, Mixture, OwnPhotos, half_width, lifted, refused, step_of, vague, with_look_alikes
from .task import FitTask

UNKNOWN = 1 / math.sqrt(12)
DETERMINED = 0.1  # a texel counts as determined when its deviation is below this
FULL = 1024  # texels a side that have a deviation of their own, at most
ONE, THREE = 0.6827, 0.98  # what one and three deviations hold, at least
Deviations = dict[str, Tensor]


def deviations(svbrdf: SVBRDF, views: Views, task: FitTask,
               basis: Tensor | None = None) -> tuple[Deviations, Deviations]:
    """Deviations of the fitted maps by own photos, and with look-alikes: by name r x r x C, r <= 1024.

    They are those of every k-th texel, k = R / 1024 rounded up; C is 2 of a normal (x and y). The basis is
    the appearance of the basis materials whose texels share numbers, K x 5; where none do, the latter have no
    map. BackendError: Mitsuba, the variant or libLLVM is missing.
    """
    side, capture, fixed = svbrdf.resolution, task.capture, dict(task.fixed)
    every = _every(side, GRID)

    def some(value: Tensor) -> Tensor:
        return value[..., every, every, :].contiguous()

    measured = capture.measured
    sampled = capture.but(photos=color.shown(some(capture.stored)), views=seen_by(views, side, every.step),
                          measured=None if measured is None else some(measured[..., None])[..., 0])
    own = OwnPhotos(svbrdf.map(some), sampled, task.renderer,
                    {name: some(value) for name, value in fixed.items()}, task.config.grey_specular)
    mixture, shared = own.mixture(), own.solver.unknowns.of(*SHARED)
    alone, alike, wrong, values = _stated(own, mixture), Deviations(), own.refused, own.values
    if basis is not None and len(shared):
        member = membership(appearance_of(sampled, some(task.guess)), basis, task.config.similarity)
        alike = _stated(own, with_look_alikes(mixture, shared, member, len(capture), own.answer.flatten(1).T))
    if step_of(side, FULL) < every.step:
        solver = TexelSolver(svbrdf.bsdf, fixed, own.solver.grey_specular, own.solver.variant)
        (here, *_), (there, wrong, values) = (
            _by_curvature(svbrdf, capture.but(views=views), own, solver, texels)
            for texels in (every, _every(side, FULL)))
        alone, alike = (_spread(found, here, there) for found in (alone, alike))
    least = (wrong * DETERMINED)[..., None]
    unseen = least.where(values[..., None] > 0, UNKNOWN)
    return ({name: value.maximum(unseen) for name, value in alone.items()},
            {name: value.maximum(least) for name, value in alike.items()})


def _every(side: int, most: int) -> slice:
    """Every k-th of ``side`` texels, ``most`` of them or fewer."""
    step = step_of(side, most)
    return slice(step // 2, None, step)


def _spread(found: Deviations, here: Deviations, there: Deviations) -> Deviations:
    """Deviations where the curvature says ``there``; ``found`` are those where it says ``here``."""
    more = {name: (value / here[name]).square() for name, value in found.items()}
    return {name: (resized(more[name], len(there[name])).sqrt() * there[name]).clamp_max(UNKNOWN)
            for name in found}


def _by_curvature(svbrdf: SVBRDF, capture: Capture, own: OwnPhotos, solver: TexelSolver,
                  every: slice) -> tuple[Deviations, Tensor, Tensor]:
    """Deviations of every k-th texel by the curvature alone; whether photos refuse its answer; their values.

    The noise of its pixels is that of as bright ones of ``own``.
    """
    side, measured = capture.resolution, capture.measured
    x = solver.numbers(svbrdf.map(lambda value: value[every, every]))
    x = x.clamp(own.low[:, None, None], own.high[:, None, None]).contiguous()
    measured = None if measured is None else measured[:, every, every]
    photos = Observations(capture.stored, capture.views, capture.transfer, 1.0).of_texels(
        torch.arange(side**2).reshape(side, side)[every, every])
    usable = (color.shown(photos.photos) < color.CLIPPED).sum(dim=-1)
    values = (usable if measured is None else measured * usable).sum(dim=0)
    weights, free = own.noise.weights(photos.photos, measured), torch.zeros_like(x)
    missed = solver.solve(replace(photos, weights=weights), x, torch.ones_like(x[0]), x, free, own.low,
                          own.high, 0).data
    noise2 = (missed + len(x)) / values.clamp_min(len(x))
    variance = solver.variances(replace(photos, weights=weights / noise2), lifted(x, own.names),
                                vague(own.names)[:, None, None].expand_as(x))
    return _by_map(own, variance.sqrt().movedim(0, -1), x.movedim(0, -1)), refused(missed, values), values


def _stated(own: OwnPhotos, mixture: Mixture) -> Deviations:
    """The deviations of each map from what its numbers may be."""
    answer, side = own.answer.flatten(1).T, own.answer.shape[-1]
    spread = half_width(mixture, answer, own.names, ONE).maximum(
        half_width(mixture, answer, own.names, THREE) / 3)
    return _by_map(own, spread.reshape(side, side, -1), answer.reshape(side, side, -1))


def _by_map(own: OwnPhotos, spread: Tensor, answer: Tensor) -> Deviations:
    """The deviations of each map from those of its numbers at the answer, both r x r x U."""
    found = {}
    for name, of in own.solver.unknowns.slices.items():
        value = spread[..., of]
        if name == "normal":  # slopes n_x / n_z and n_y / n_z: the slope of (n_x + 1) / 2 by them
            square = answer[..., of].square()
            value = value / 2 * (1 + square.flip(-1)) / (1 + square.sum(dim=-1, keepdim=True)) ** 1.5
        found[name] = value.clamp_max(UNKNOWN)
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
