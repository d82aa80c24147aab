"""How far a texel's answer (the fit) may be from the truth: by its own photos, and with look-alikes.

The photos determine each number of a texel up to a distribution (:mod:`.posterior`). Its deviation d is
measured from the answer: at least 68 % of the distribution are within d of the answer, at least 98 % within
3 d. For a normal distribution around the answer, d is the standard deviation. An answer at the edge of the
distribution has a large d. Errors that all photos share, such as in light power, are not included.

A texel does not count as determined if its photos contradict its answer, even if its look-alikes confirm it.

Maps above 64 px have a distribution for every k-th texel only. Each texel's deviation is then the one by the
curvature of its errors, times a ratio: deviation by distribution / by curvature, at nearby k-th texels.

The numbers are the ones in which errors are counted (docs/conventions.md). Each has a range of 1. A number
that no photo determines has the deviation of a uniform distribution, 1 / sqrt(12).
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
FULL = 1024  # most texels a side with a deviation of their own
ONE, THREE = 0.6827, 0.98  # least probability within one and within three deviations
Deviations = dict[str, Tensor]


def deviations(svbrdf: SVBRDF, views: Views, task: FitTask,
               basis: Tensor | None = None) -> tuple[Deviations, Deviations]:
    """Two dicts, map name to deviations r x r x C (r <= 1024): by own photos, and with look-alikes.

    Every k-th texel has deviations, k = R / 1024 rounded up; C is 2 for a normal (x and y). ``basis``:
    appearance of the basis materials whose texels share numbers, K x 5. Without it or shared numbers, the
    second dict is empty. BackendError: Mitsuba, the variant or libLLVM is missing.
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
    """A slice of every k-th of ``side`` texels, at most ``most`` of them."""
    step = step_of(side, most)
    return slice(step // 2, None, step)


def _spread(found: Deviations, here: Deviations, there: Deviations) -> Deviations:
    """Deviations ``there`` (by curvature) times the resized ratio of ``found`` to ``here`` (by curvature)."""
    more = {name: (value / here[name]).square() for name, value in found.items()}
    return {name: (resized(more[name], len(there[name])).sqrt() * there[name]).clamp_max(UNKNOWN)
            for name in found}


def _by_curvature(svbrdf: SVBRDF, capture: Capture, own: OwnPhotos, solver: TexelSolver,
                  every: slice) -> tuple[Deviations, Tensor, Tensor]:
    """For every k-th texel: deviations by curvature, whether photos contradict the answer, number of values.

    The noise of a pixel is that of equally bright pixels of ``own``.
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
    """The deviations of each map, from the distributions of its numbers (``mixture``)."""
    answer, side = own.answer.flatten(1).T, own.answer.shape[-1]
    spread = half_width(mixture, answer, own.names, ONE).maximum(
        half_width(mixture, answer, own.names, THREE) / 3)
    return _by_map(own, spread.reshape(side, side, -1), answer.reshape(side, side, -1))


def _by_map(own: OwnPhotos, spread: Tensor, answer: Tensor) -> Deviations:
    """The deviations of each map, from those of U numbers (``spread``) at ``answer``, both r x r x U."""
    found = {}
    for name, of in own.solver.unknowns.slices.items():
        value = spread[..., of]
        if name == "normal":  # slopes n_x / n_z and n_y / n_z: the derivative of (n_x + 1) / 2 by them
            square = answer[..., of].square()
            value = value / 2 * (1 + square.flip(-1)) / (1 + square.sum(dim=-1, keepdim=True)) ** 1.5
        found[name] = value.clamp_max(UNKNOWN)
    return found


def seen_by(views: Views, side: int, step: int) -> Views:
    """Views of a patch that consists of every step-th texel of one with ``side`` texels a side."""
    views = views.in_patch_sides()
    count = len(range(step // 2, side, step))
    scale, middle = count * step / side, (step // 2 + 0.5 + (count - 1) * step / 2) / side - 0.5
    moved = views.camera.new_tensor([middle, -middle, 0.0])
    light = (views.light - moved) / scale
    power = (light.norm(dim=1) / views.light.norm(dim=1)).square() if views.falloff == "none" else scale**-2
    return replace(views, camera=(views.camera - moved) / scale, light=light,
                   intensity=(views.intensity.T * power).T)


def shown_texels(capture: Capture) -> Tensor:
    """A mask of the texels with a deviation, r x r: True if some photo shows the texel unmasked."""
    every = _every(capture.resolution, FULL)
    shown = torch.ones(1, capture.resolution, capture.resolution, dtype=torch.bool)
    return (shown if capture.measured is None else capture.measured)[:, every, every].any(dim=0)


def confidence(alone: Mapping[str, Tensor], alike: Mapping[str, Tensor],
               shown: Tensor) -> dict[str, dict[str, float]]:
    """For each map: ``median_sd``, ``determined_share`` (of sd below 0.1), median ``with_look_alikes``.

    Only texels in the mask ``shown``, r x r, count. The last one is missing if nothing is shared.
    """
    found = {}
    for name, value in alone.items():
        texels = of_texels(value)[shown]
        found[name] = {"median_sd": float(texels.median()),
                       "determined_share": float((texels < DETERMINED).float().mean())}
        found[name] |= {"with_look_alikes": float(of_texels(alike[name])[shown].median())} if alike else {}
    return found


def of_texels(value: Tensor) -> Tensor:
    """The deviation of each texel, r x r: the root mean square over its channels."""
    return value.square().mean(dim=-1).sqrt()
