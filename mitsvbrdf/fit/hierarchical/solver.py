"""Levenberg-Marquardt for every texel at once, through Mitsuba's BSDF plugins.

A rectified photo shows a texel in one pixel. So a fit without ties between texels is one small least-squares
problem per texel: a few unknowns, three values per photo. One thread solves it. Derivatives are forward
derivatives of the plugin. The normal equations stay in registers; the loop reads only photos, weights and
views. After Levenberg 1944, Marquardt 1963 (damping in proportion to the diagonal) and Bertsekas 1982 (an
unknown at its bound is left out of a step that would move it out of its range).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import color
from ...material.maps import CHANNELS, COLOURS, SVBRDF, Bsdf
from ...render.bsdf import needed_maps
from ...render.exclusive import Kept, using_mitsuba
from ...render.needs import Needs, scene_needs
from ...render.plugins import register
from ...render.texels import from_torch, opaque, to_torch
from ...views import Views, strips
from ..fixed_maps import unknown_but
from .kernel import Kernel, tile_rows, tiles
from .sensor_noise import noise_at
from .unknowns import Unknowns, columns_of, pairs_of


@dataclass(frozen=True)
class Observations:
    """The photos and their weights. The data cost of a texel is w rho(e) / noise^2, summed over its values.

    e is rendering minus photo in display values. At a clipped photo value (0.995 and above), e counts only if
    the rendering is too dark.

    Args:
        photos: N x R x R x 3, display values; or 8 or 16 bits (:func:`mitsvbrdf.color.shown`).
        transfer: how display values encode light.
        noise: standard deviation of a display value.
        robust: s of the pseudo-Huber rho(e) = 2 s^2 (sqrt(1 + e^2 / s^2) - 1), in display values (Charbonnier
            et al. 1994); None for e^2. rho grows without limit: a highlight that a start misses is an
            outlier, but the fit must still move towards it.
        weights: w of each photo's pixels, N x R x R; None for 1.
        sensor: noise at each brightness (:mod:`.sensor_noise`), which changes w; None: the same everywhere.
        texels: for each pixel, the place (row-major index) of its texel in the material; None: all texels.
        side: texels a side of the material; 0: that of the photos.
    """

    photos: Tensor
    views: Views
    transfer: color.Transfer
    noise: float
    robust: float | None = None
    weights: Tensor | None = None
    sensor: Tensor | None = None
    texels: Tensor | None = None
    side: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "side", self.side or self.photos.shape[2])

    def places(self, rows: slice) -> Tensor:
        """Places (row-major indices) of the texels in some rows of the pixels."""
        if self.texels is not None:
            return self.texels[rows]
        return torch.arange(rows.start * self.side, rows.stop * self.side).reshape(-1, self.side)

    def of_rows(self, rows: slice) -> Observations:
        """The observations of some rows of the pixels."""
        return replace(self._of(lambda planes: planes[:, rows]), texels=self.places(rows))

    def of_texels(self, texels: Tensor) -> Observations:
        """The observations of the texels at some places; ``texels`` is n x n."""
        return replace(self._of(lambda planes: planes.flatten(1, 2)[:, texels]), texels=texels)

    def read(self) -> tuple[Tensor, Tensor | None]:
        """Display values and weights (None for 1) of the pixels, float32."""
        photos, weights = color.shown(self.photos).float(), self.weights
        weights = None if weights is None else weights.float()
        if self.sensor is not None:
            told = (self.noise / noise_at(photos.mean(dim=-1), self.sensor)).square()
            weights = told if weights is None else weights * told
        return photos, weights

    def pick(self, rows: Sequence[int]) -> Observations:
        """The observations with only the photos at these positions."""
        return replace(self._of(lambda planes: planes[rows].contiguous()), views=self.views.pick(rows))

    def _of(self, part: Callable[[Tensor], Tensor]) -> Observations:
        weights = None if self.weights is None else part(self.weights)
        return replace(self, photos=part(self.photos), weights=weights)

    def without(self, row: int) -> Observations:
        """The observations without the photo at position ``row``."""
        return self.pick([k for k in range(len(self.photos)) if k != row])


@dataclass(frozen=True)
class Solved:
    """The texels after some iterations, float32.

    Args:
        x: the unknowns, U x R x R.
        damping: R x R, for the next call.
        data: the photos' part of the cost, R x R; infinite where a texel's start gave no finite cost.
        prior: the prior's part, R x R.
    """

    x: Tensor
    damping: Tensor
    data: Tensor
    prior: Tensor


class TexelSolver:
    """Levenberg-Marquardt for the unknowns of each texel of a material.

    The unknowns are those of the maps that are not fixed, in the order of
    :data:`mitsvbrdf.material.maps.CHANNELS`: colours channel by channel as linear^(1/2.2), metallic and
    roughness as they are, the normal as slopes n_x / n_z and n_y / n_z. :attr:`unknowns` has the number of
    unknowns of each map and their positions; U is the number of all unknowns.

    Args:
        fixed: maps that are known, name -> R x R x C, linear.
        grey_specular: one specular number a texel instead of three.
        variant: ``llvm_ad_rgb`` or ``cuda_ad_rgb``.

    Raises:
        BackendError: Mitsuba, the variant or libLLVM is missing.
    """

    def __init__(self, bsdf: Bsdf, fixed: Mapping[str, Tensor] | None = None, grey_specular: bool = False,
                 variant: str = "llvm_ad_rgb") -> None:
        self.bsdf, self.fixed = bsdf, dict(fixed or {})
        self.variant, self.grey_specular = variant, grey_specular
        with using_mitsuba(variant) as self.mi:
            register(variant)
        counts = CHANNELS[bsdf] | {"normal": 2} | ({"specular": 1} if grey_specular else {})
        self.unknowns = Unknowns(**{name: (counts[name],) for name in CHANNELS[bsdf]
                                    if name not in self.fixed})
        self._kernels: dict[tuple, Kept[Kernel]] = {}

    def numbers(self, svbrdf: SVBRDF) -> Tensor:
        """The unknowns of a material, U x R x R; a grey specular is the mean over the channels."""
        planes: list[Tensor] = []
        for name, (count,) in self.unknowns.shapes.items():
            value = svbrdf[name]
            if name == "normal":
                value = value[..., :2] / value[..., 2:]
            elif name in COLOURS:
                value = color.encode(value.mean(dim=-1, keepdim=True) if count < value.shape[-1] else value)
            planes += value.unbind(-1)
        return torch.stack(planes)

    def svbrdf(self, x: Tensor) -> SVBRDF:
        """The material of unknowns U x R x R, with the fixed maps; a grey specular map is expanded."""
        side = x.shape[-1]
        maps = {name: self.fixed[name] if name in self.fixed else x.new_empty(side, side, count)
                for name, count in CHANNELS[self.bsdf].items()}
        for rows in strips(side):
            for name, of in self.unknowns.slices.items():
                value = x[of, rows].permute(1, 2, 0)
                if name == "normal":
                    value = F.normalize(torch.cat((value, torch.ones_like(value[..., :1])), dim=-1), dim=-1)
                maps[name][rows] = color.decode(value) if name in COLOURS else value
        return SVBRDF(self.bsdf, maps)

    def roughness(self, x: Tensor) -> Tensor:
        """The roughness map, R x R, of unknowns U x R x R."""
        known = self.fixed.get("roughness")
        return x[self.unknowns.slices["roughness"]][0] if known is None else known[..., 0]

    def solve(self, observations: Observations, x: Tensor, damping: Tensor, mean: Tensor, precision: Tensor,
              low: Tensor, high: Tensor, iterations: int = 5) -> Solved:
        """Take up to ``iterations`` Levenberg-Marquardt steps in every texel.

        The cost is that of the observations plus sum_u precision_u (x_u - mean_u)^2, both without a factor
        1/2. Steps that raise a texel's cost, or make it not finite, are refused.

        Args:
            x: the start, U x R x R, within the bounds ``low`` and ``high`` (U numbers each).
            damping: R x R, relative to the diagonal of the normal equations; 0.01 is a good first value.
            mean, precision: of the prior, U x R x R. A precision (1 / variance) of 0 is no prior.
        """
        with using_mitsuba(self.variant) as mi:
            bounds = *([opaque(mi, v) for v in bound] for bound in (low, high)), opaque(mi, iterations)
            moved, (damping, data, prior) = self._tiled(
                observations, lambda kernel, problem, x, damping, mean, precision: kernel.steps(
                    problem, x, damping[0], mean, precision, *bounds), x, damping[None], mean, precision)
        return Solved(moved, damping, data, prior)

    def variances(self, observations: Observations, x: Tensor, precision: Tensor) -> Tensor:
        """The unknowns' variances given the photos: the diagonal of (J^T W J + precision)^-1, U x R x R.

        The prior's precision must be above 0 if the photos alone do not determine an unknown.
        """
        return self.posterior(observations, x, precision)[0]

    def posterior(self, observations: Observations, x: Tensor, precision: Tensor) -> tuple[Tensor, Tensor]:
        """The :meth:`variances`, and the log determinant of J^T W J + precision, R x R."""
        with using_mitsuba(self.variant):
            (found,) = self._tiled(observations, lambda kernel, *args: kernel.posterior(*args), x, precision)
        return found[:-1], found[-1]

    def normal_equations(self, observations: Observations, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Data cost (R x R), J^T W e (U x R x R) and J^T W J (U x U x R x R) at x, float32.

        J: derivatives of the errors with respect to the unknowns. W: w / noise^2, times 1 / sqrt(1 + e^2 /
        s^2) if robust; 0 if the photo is clipped and the rendering is brighter.
        """
        with using_mitsuba(self.variant):
            (cost,), slope, curve = self._tiled(observations,
                                                lambda kernel, *args: kernel.equations(*args), x)
        dense = curve.new_zeros(len(x), len(x), *x.shape[1:])
        for (i, j), value in zip(pairs_of(columns_of(self.unknowns)), curve):
            dense[i, j] = dense[j, i] = value
        return cost, slope, dense

    def _tiled(self, observations: Observations, run: Callable[..., Sequence[list]],
               *planes: Tensor) -> list[Tensor]:
        """The kernel's results for planes ? x R x R, computed by :func:`.kernel.tiles`: each ? x R x R.

        Planes and observations have the same texels. Results are copies: no Dr.Jit array outlives the call.
        """
        (count, side), found = planes[0].shape[1:], list[Tensor]()
        needs, fixed = self._known(observations.views, observations.side)
        kernel, problem = self._kernel(observations, needs, planes[0]), self._problem(observations)
        for of in tiles(side, count):
            (photos, weights), texels = observations.of_rows(of).read(), observations.places(of).flatten()
            here = problem | {"texels": from_torch(self.mi, texels.int()),
                              "photos": from_torch(self.mi, photos),
                              "fixed": {name: self._planes(value.flatten(1)[:, texels])
                                        for name, value in fixed.items()}}
            if weights is not None:
                here["weights"] = from_torch(self.mi, weights)
            here_planes = apart([plane[:, of] for plane in planes])
            parts = [to_torch(part).reshape(-1, len(photos[0]), side).to(planes[0].device)
                     for part in run(kernel, here, *map(self._planes, here_planes))]
            if len(photos[0]) == count:
                return parts
            found = found or [part.new_empty(len(part), count, side) for part in parts]
            for whole, part in zip(found, parts):
                whole[:, of] = part
        return found

    def _planes(self, values: Tensor) -> list:
        return [from_torch(self.mi, plane) for plane in apart(values.detach().float().unbind())]

    def _known(self, views: Views, side: int) -> tuple[Needs, dict[str, Tensor]]:
        """The needs of the scene, and the fixed maps that it reads: a dict, name -> C x R x R."""
        material = unknown_but(self.fixed, self.bsdf, side, self.grey_specular)
        needs = replace(scene_needs(material, views, "mitsuba"), omitted=())
        return needs, {name: value.permute(2, 0, 1) for name, value in needed_maps(material, needs).items()
                       if name in self.fixed}

    def _problem(self, observations: Observations) -> dict:
        """The parts of a kernel's ``problem`` that all tiles share, as Dr.Jit arrays."""
        mi, views = self.mi, observations.views.in_patch_sides().to(torch.float64)
        problem = {"count": opaque(mi, len(views)), "side": opaque(mi, observations.side),
                   "weight": opaque(mi, observations.noise**-2.0),
                   "views": [from_torch(mi, v) for v in (views.camera, views.light, views.intensity)]}
        if curve := color.parts(observations.transfer)[1]:
            problem["curve"] = [opaque(mi, v) for v in curve]
        if observations.robust is not None:
            problem["scale"] = opaque(mi, float(observations.robust))
        return problem

    def _kernel(self, observations: Observations, needs: Needs, x: Tensor) -> Kernel:
        plain, texels = color.parts(observations.transfer)[0], tile_rows(x.shape[-1]) * x.shape[-1]
        key = needs, texels, observations.views.falloff, plain
        if key not in self._kernels:
            self._kernels[key] = Kept(Kernel(self.mi, self.bsdf, self.unknowns, *key))
        return self._kernels[key].content


def apart(values: Sequence[Tensor]) -> list[Tensor]:
    """The values, each in its own memory: Dr.Jit treats values that share memory as one variable.

    If a frozen function was called with one variable for two arguments, later calls also use one for both.
    """
    places = [value.data_ptr() for value in values]
    return [value.clone() if places[k] in places[:k] else value for k, value in enumerate(values)]
