"""Whether a material is matte and needs no specular lobe; decided for photos that follow the model.

The photos are first fitted without a lobe, until every texel has converged. Two tests follow.

* Does a lobe explain more than noise? It adds four unknowns per texel (three of specular, one roughness), so
  a fit with a lobe always has smaller errors. The F-test of nested models (Fisher 1922) compares the gain
  with that of any four unknowns in pure noise. A shiny spot would be lost in a sum over all texels. So single
  texels, blocks of 2, 4, 8, ... texels a side and all texels are tested, each so strictly that a matte
  material rarely fails any test by noise (Bonferroni).
* Would the photos show even a weak lobe? All texels get the same weak lobe, at each of several roughnesses.
  It has no unknowns, so likelihoods are compared (Wald 1945). With each of these lobes, the photos together
  must be so much less likely that a mistake is rare, and no block may be so much more likely. Thus a material
  is not called matte if the photos cannot distinguish a lobe from the diffuse colour, such as a broad lobe
  in noise.

Each texel has its own noise: in display values, sensor noise is larger in dark texels than in bright ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from ...color import QUANTIZATION_NOISE
from ...material.maps import CHANNELS
from ...material.resample import enlarged
from ..start import robust_start
from ..task import FitTask
from .scales import Scale, Scales
from .solver import Observations, TexelSolver
from .stages import Stage
from .starts import other_starts, stepped
from .texel_prior import LEAST_PRECISION, TexelEstimate, TexelPrior

# BSDF -> the maps of the lobe that may be omitted
LOBE = {"roughconductor": ("specular", "roughness")}
RARE = 0.05  # probability that noise alone decides a test, or any of all tests of one kind
WEAK = 0.01  # specular of a weak lobe, linear: half that of water, the lowest of common dielectrics
WIDTHS = tuple(k / 10 for k in range(1, 11))  # roughnesses of the weak lobe
STARTS = (0.15, 0.5, 0.85)  # roughnesses from which a fit with a lobe starts, beside those found
STEPS, ROUNDS = 12, 2  # Levenberg-Marquardt steps, and rounds of half as many from other starts


class Search(NamedTuple):
    """A search for some unknowns: the photos and solvers of each size, and the prior."""

    scales: Scales
    prior: TexelPrior

    @staticmethod
    def of(scales: Scales) -> Search:
        """A search for all unknowns that are not held fixed."""
        return Search(scales, TexelPrior(scales.of(Stage.ALONE).solver.unknowns, scales.config))


def may_be_omitted(task: FitTask) -> bool:
    """Whether the lobe may be omitted: none of its maps is fixed, and diffuse or normal is fitted."""
    lobe = LOBE.get(task.config.bsdf, ())
    others = {"diffuse", "normal"} - set(task.fixed)
    return bool(lobe and others) and not set(lobe) & set(task.fixed)


def decision_work(scales: Scales) -> int:
    """Largest work of :func:`explained_without` in texels times steps; a texel has four other starts."""
    coarse, fine = (scales.of(stage).texels for stage in (Stage.ALONE, Stage.FINE))
    both = (2 + len(STARTS)) * STEPS + 2 * ROUNDS * 4 * (STEPS // 2)
    return (both + len(WIDTHS) * STEPS) * coarse + (both * fine if fine > coarse else 0)


def without_lobe(search: Search) -> Search:
    """The search without a lobe: specular is fixed at 0, roughness at the mean of the robust start."""
    coarse, config, side = search.scales.of(Stage.ALONE), search.prior.config, search.scales.captures[
        Stage.FINE].resolution
    start = robust_start(coarse.capture, coarse.guess, config.bsdf, coarse.solver.fixed)
    return Search.of(search.scales.holding(**_lobe(0.0, float(start["roughness"].mean()), side)))


def _lobe(specular: float, roughness: float, side: int) -> dict[str, Tensor]:
    return {name: torch.full((1,), value).expand(side, side, CHANNELS["roughconductor"][name])
            for name, value in (("specular", specular), ("roughness", roughness))}


def explained_without(
        answer: TexelEstimate, search: Search, lobeless: Search, noise: Tensor,
        observations: Callable[[Scale, TexelEstimate], Observations]) -> tuple[Scale, TexelEstimate] | None:
    """Full-size scale and answer without a lobe; None if the photos may need a lobe.

    Args:
        answer: of the first stage, with a lobe in each texel.
        lobeless: of :func:`without_lobe`.
        noise: RMSE of the answer, in display values.
    """
    x, own = answer.x, torch.empty(0)
    sizes = {search.scales.of(stage).capture.resolution: stage for stage in (Stage.FINE, Stage.ALONE)}
    for side, stage in sorted(sizes.items()):
        scale, other = search.scales.of(stage), lobeless.scales.of(stage)
        photos = replace(observations(scale, answer), robust=None,
                         noise=max(float(noise), QUANTIZATION_NOISE))
        x = x if x.shape[-1] == side else enlarged(x, side)
        own = enlarged(own, side) if len(own) else other.solver.numbers(scale.solver.svbrdf(x))
        own, left = least_errors(other.solver, photos, lobeless.prior, [own], ROUNDS)
        values = scale.capture.usable.sum(dim=(0, 3)).double()
        counts = len(own), len(x)
        _, less = least_errors(scale.solver, photos, search.prior, [x], steps=0)
        if needed(left, less, values, *counts):
            return None
        if stage == Stage.ALONE and shown_if_weak(other, photos, lobeless.prior, own, left, values):
            return None
        wide = [x.index_fill(0, search.prior.unknowns.of("roughness"), width) for width in STARTS]
        _, less = least_errors(scale.solver, photos, search.prior, [x, *wide], ROUNDS)
        if needed(left, less, values, *counts):
            return None
    return lobeless.scales.of(Stage.FINE), lobeless.prior.vague(own)


def least_errors(solver: TexelSolver, photos: Observations, prior: TexelPrior, starts: list[Tensor],
                 rounds: int = 0, steps: int = STEPS, turn: int = 0) -> tuple[Tensor, Tensor]:
    """The unknowns U x R x R that explain each texel's photos best, and their squared errors R x R.

    Args:
        photos: their noise does not matter much.
        starts: to try, U x R x R each.
        rounds: in which texels also try :func:`~mitsvbrdf.fit.hierarchical.starts.other_starts`.
        steps: from each start.
        turn: number of the first of these rounds.
    """
    x = prior.bounded(starts[0]).contiguous()
    answer = TexelEstimate(x, x, torch.full_like(x, LEAST_PRECISION), torch.zeros(0))
    errors = torch.full_like(x[0], torch.inf)

    def tried(start: TexelEstimate, count: int) -> tuple[Tensor, Tensor]:
        found = stepped(solver, photos, start._replace(x=prior.bounded(start.x).contiguous()), prior, count)
        return torch.where(found.data < errors, found.x, x), found.data.minimum(errors)

    for start in starts:
        x, errors = tried(answer._replace(x=start), steps)
    for later in range(rounds):
        for other in other_starts(prior, turn + later):
            x, errors = tried(other(answer._replace(x=x), slice(0, len(x[0]))), steps // 2)
    return x, errors.double() * photos.noise**2


def blocks(*planes: Tensor) -> Iterator[list[Tensor]]:
    """Sums of planes, R x R each, over blocks of 1, 2, 4, ... texels a side, and over all texels."""
    side, size = planes[0].shape[-1], 1
    while True:
        yield [F.avg_pool2d(plane[None].double(), size, ceil_mode=True, divisor_override=1)[0]
               for plane in planes]
        if size == side:
            return
        size = min(2 * size, side)


def needed(left: Tensor, less: Tensor, values: Tensor, few: int, many: int) -> bool:
    """Whether more unknowns lower a block's squared errors more than by noise; True if values are too few.

    Args:
        left: squared errors of each texel without them, R x R.
        less: with them, R x R.
        values: number of values in the photos of each texel that are not clipped, R x R.
        few: unknowns of a texel without them.
        many: with them.
    """
    from scipy.special import fdtri

    less = less.minimum(left)
    rest = less.maximum((values - many) * QUANTIZATION_NOISE**2)  # photos are no more exact than 8 bits
    tests = list(blocks(left - less, rest, values - many, torch.ones_like(values)))
    if tests[-1][2] <= 0:
        return True
    count = sum(saved.numel() for saved, *_ in tests)
    for saved, rest, free, texels in tests:
        further, free = (many - few) * texels, free.clamp_min(1)
        limit = torch.from_numpy(fdtri(further.numpy(), free.numpy(), 1 - RARE / count))
        if (saved * free > limit * further * rest).any():
            return True
    return False


def shown_if_weak(scale: Scale, photos: Observations, prior: TexelPrior, x: Tensor, left: Tensor,
                  values: Tensor) -> bool:
    """Whether a weak lobe is likely, or could not be detected in the photos.

    Args:
        scale: of the search without a lobe.
        x: the unknowns that explain the photos best, U x R x R.
        left: their squared errors, R x R.
        values: number of values in the photos of each texel that are not clipped, R x R.
    """
    side, free, step = x.shape[-1], (values - len(x)).clamp_min(0), values.clamp_min(
        1) * QUANTIZATION_NOISE**2
    count = len(WIDTHS) * sum(sums.numel() for (sums,) in blocks(left))
    solver = TexelSolver(scale.solver.bsdf, scale.solver.fixed, variant=scale.solver.variant)
    for width in WIDTHS:
        solver.fixed.update(_lobe(WEAK, width, side))
        _, other = least_errors(solver, photos, prior, [x])
        # -2 log of the likelihood ratio, with each texel's own noise; no photo is more exact than 8 bits
        unlikelier = free * ((other + step) / (left + step)).log()
        *parts, whole = (sums for (sums,) in blocks(unlikelier))
        if not float(whole) >= 2 * math.log(1 / RARE) or any((sums < -2 * math.log(count / RARE)).any()
                                                             for sums in parts):
            return True
    return False
