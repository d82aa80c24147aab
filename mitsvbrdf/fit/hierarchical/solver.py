"""Levenberg-Marquardt for every texel at once, through Mitsuba's BSDF plugins.

A rectified photo shows texel (i, j) in pixel (i, j), so a fit without ties between texels is one small least-squares problem a
texel: a few unknowns, three values a photo. One thread solves it: values and slopes of all photos by forward derivatives of
the plugin, the normal equations and their Cholesky factor stay in its registers, and nothing but the photos is read in the
loop. After Levenberg 1944, Marquardt 1963 (damping in proportion to the diagonal) and Bertsekas 1982 (an unknown at its bound
that wants out is left out of the step of the others).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import color
from ...color import CLIPPED
from ...material.maps import CHANNELS, COLOURS, SVBRDF, Bsdf
from ...render.bsdf import needed_maps
from ...render.llvm import mitsuba_module
from ...render.needs import Needs, scene_needs
from ...render.plugins import register, shading_axes
from ...render.texel_plugin import HeldPlugin, along, from_torch, frozen, row, texel_position, to_torch, view_geometry
from ...views import Views
from . import cholesky
from .kernel import (
    DAMPING,
    EASED,
    ROUNDING,
    STIFFENED,
    STILL,
    Functions,
    opaque,
    pair_of,
    pairs_of,
    traced_decode,
    traced_encode,
    turned,
)


@dataclass(frozen=True)
class Observations:
    """The photos and how an error in them counts: the data cost of a texel is sum_vc w rho(e) / noise^2.

    e is rendering minus photo in display values; of a clipped photo value (0.995 and above) only a rendering that is too
    dark counts.

    Args:
        photos: N x R x R x 3, display values.
        views: N views.
        transfer: how display values encode light.
        noise: standard deviation of a display value.
        robust: s of the pseudo-Huber rho(e) = 2 s^2 (sqrt(1 + e^2 / s^2) - 1), in display values (Charbonnier et al. 1994);
            None for e^2. It never stops growing: a highlight that a start misses is an outlier, not to be given up as one.
        weights: w of each photo's pixels, N x R x R; None for 1.
    """

    photos: Tensor
    views: Views
    transfer: color.Transfer
    noise: float
    robust: float | None = None
    weights: Tensor | None = None


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
    """The unknowns of each texel of a material, and Levenberg-Marquardt for them.

    The unknowns are those of the maps that are not held, in the order of :data:`mitsvbrdf.maps.CHANNELS`: colours channel by
    channel as linear^(1/2.2), metallic and roughness as they are, of the normal the slopes n_x / n_z and n_y / n_z.
    :attr:`unknowns` counts them by map; U is their sum.

    Args:
        bsdf: the parameter set.
        held: maps that are known, name -> R x R x C, linear.
        grey_specular: one specular number a texel instead of three.
        variant: ``llvm_ad_rgb`` or ``cuda_ad_rgb``.

    Raises:
        BackendError: Mitsuba, the variant or libLLVM is missing.
    """

    def __init__(self, bsdf: Bsdf, held: Mapping[str, Tensor] | None = None, grey_specular: bool = False,
                 variant: str = "llvm_ad_rgb") -> None:
        self.bsdf, self.held, self.variant = bsdf, dict(held or {}), variant
        self.mi = mitsuba_module(variant)
        register(self.mi)
        counts = CHANNELS[bsdf] | {"normal": 2} | ({"specular": 1} if grey_specular else {})
        self.unknowns = {name: counts[name] for name in CHANNELS[bsdf] if name not in self.held}
        self._kernels: dict[tuple, Functions] = {}

    def numbers(self, svbrdf: SVBRDF) -> Tensor:
        """The unknowns of a material, U x R x R; where specular is one number, of its mean over the channels."""
        planes: list[Tensor] = []
        for name, count in self.unknowns.items():
            value = svbrdf[name]
            if name == "normal":
                value = value[..., :2] / value[..., 2:]
            elif name in COLOURS:
                value = color.encode(value.mean(dim=-1, keepdim=True) if count < value.shape[-1] else value)
            planes += value.unbind(-1)
        return torch.stack(planes)

    def svbrdf(self, x: Tensor) -> SVBRDF:
        """The material of unknowns U x R x R, with the maps held; an expanded specular map where it is one number."""
        maps = dict(self.held)
        for name, value in zip(self.unknowns, x.permute(1, 2, 0).split(list(self.unknowns.values()), dim=-1)):
            if name == "normal":
                value = F.normalize(torch.cat((value, torch.ones_like(value[..., :1])), dim=-1), dim=-1)
            elif name in COLOURS:
                value = color.decode(value)
            maps[name] = value.expand(*value.shape[:2], CHANNELS[self.bsdf][name])
        return SVBRDF(self.bsdf, {name: maps[name] for name in CHANNELS[self.bsdf]})

    def solve(self, evidence: Observations, x: Tensor, damping: Tensor, mean: Tensor, precision: Tensor, low: Tensor, high: Tensor,
              iterations: int = 5) -> Solved:
        """Take up to ``iterations`` Levenberg-Marquardt steps in every texel, none that raises its cost.

        The cost is that of the evidence and sum_u precision_u (x_u - mean_u)^2, both without a factor 1/2. Steps to where it is
        not finite are refused.

        Args:
            evidence: the photos.
            x: where to start, U x R x R, within the bounds.
            damping: R x R, relative to the diagonal of the normal equations; 0.01 is a fair start.
            mean: of the prior, U x R x R.
            precision: of the prior (1 / variance), U x R x R; 0 for none.
            low: lowest value of each unknown, U numbers.
            high: the highest.
            iterations: steps to take.
        """
        mi, side = mitsuba_module(self.variant), x.shape[-1]
        found = self._traced(evidence, side).steps(
            self._problem(evidence, side), self._planes(x), *self._planes(damping[None]), self._planes(mean),
            self._planes(precision), [opaque(mi, v) for v in low], [opaque(mi, v) for v in high], opaque(mi, iterations))
        moved, (damping, data, prior) = (to_torch(part).reshape(-1, side, side).to(x.device) for part in found)
        return Solved(moved, damping, data, prior)

    def variances(self, evidence: Observations, x: Tensor, precision: Tensor) -> Tensor:
        """The diagonal of (J^T W J + precision)^-1 at x, U x R x R float32: the unknowns' variances, given the photos.

        Args:
            evidence: the photos.
            x: the unknowns, U x R x R.
            precision: of the prior, U x R x R, above 0 where the photos alone do not determine an unknown.
        """
        return self.posterior(evidence, x, precision)[0]

    def posterior(self, evidence: Observations, x: Tensor, precision: Tensor) -> tuple[Tensor, Tensor]:
        """:meth:`variances`, and the log determinant of J^T W J + precision, R x R."""
        found = to_torch(self._traced(evidence, x.shape[-1]).posterior(
            self._problem(evidence, x.shape[-1]), self._planes(x), self._planes(precision)))
        found = found.reshape(-1, *x.shape[1:]).to(x.device)
        return found[:-1], found[-1]

    def normal_equations(self, evidence: Observations, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Data cost R x R, J^T W e U x R x R and J^T W J U x U x R x R at x, float32.

        J are the slopes of the errors by the unknowns, W the weights: w / noise^2, 0 where a clipped value says nothing, times
        1 / sqrt(1 + e^2 / s^2) if robust.
        """
        side, count = x.shape[-1], len(x)
        found = self._traced(evidence, side).equations(self._problem(evidence, side), self._planes(x))
        (cost,), slope, curve = (to_torch(part).reshape(-1, side, side).to(x.device) for part in found)
        dense = curve.new_zeros(count, count, side, side)
        for (i, j), value in zip(pairs_of(self._columns()), curve):
            dense[i, j] = dense[j, i] = value
        return cost, slope, dense

    def _planes(self, values: Tensor) -> list:
        return [from_torch(self.mi, plane) for plane in values.detach().float()]

    def _known(self, views: Views, side: int) -> tuple[Needs, dict[str, Tensor]]:
        """What the scene needs, and the held maps that are read."""
        def unknown(name: str, count: int) -> Tensor:
            channels = CHANNELS[self.bsdf][name]
            return torch.ones(channels if count > 1 else 1, requires_grad=True).expand(side, side, channels)

        material = SVBRDF(self.bsdf, {name: unknown(name, count) for name, count in self.unknowns.items()} | self.held)
        needs = replace(scene_needs(material, views, "mitsuba"), left_out=())
        return needs, {name: value for name, value in needed_maps(material, needs).items() if name in self.held}

    def _problem(self, evidence: Observations, side: int) -> dict:
        """The numbers of the evidence and of the maps held, as Dr.Jit arrays."""
        mi, views = mitsuba_module(self.variant), evidence.views.in_patch_sides().to(torch.float64)
        _, held = self._known(evidence.views, side)
        problem = {"photos": from_torch(mi, evidence.photos.float()), "count": opaque(mi, len(views)),
                   "weight": opaque(mi, evidence.noise**-2.0),
                   "views": [from_torch(mi, v) for v in (views.camera, views.light, views.intensity)],
                   "held": {name: self._planes(value.permute(2, 0, 1)) for name, value in held.items()}}
        if evidence.robust is not None:
            problem["scale"] = opaque(mi, float(evidence.robust))
        if evidence.weights is not None:
            problem["weights"] = from_torch(mi, evidence.weights.float())
        return problem

    def _traced(self, evidence: Observations, side: int) -> Functions:
        needs, _ = self._known(evidence.views, side)
        key = needs, side, evidence.views.falloff, evidence.transfer
        if key not in self._kernels:
            self._kernels[key] = self._trace(*key)
        return self._kernels[key]

    def _trace(self, needs: Needs, side: int, falloff: str, transfer: str) -> Functions:
        import drjit as dr

        mi, texels, size = self.mi, side * side, sum(self.unknowns.values())
        Float, Vector = mi.Float, dr.float64_array_t(mi.Vector3f)
        columns = self._columns()
        pairs = pairs_of(columns)
        shader = HeldPlugin(mi, self.bsdf, needs)

        def zeros(count, kind=Float):  # each an object of its own, since loops write into their state
            return [dr.zeros(kind, texels) for _ in range(count)]

        def whole(curve, precision):
            matrix = dict(zip(pairs, curve))
            return matrix | {(u, u): matrix[u, u] + p for u, p in enumerate(precision)}

        def linearised(problem, x, kind=Float):
            """At x, the data cost, J^T W e, and J^T W J by :func:`_pairs`, summed in this kind of float."""
            index = dr.arange(mi.UInt32, texels)
            place = texel_position(mi, index, side)
            maps, stretch = self._maps(x, problem["held"])
            axes, turns = None, []
            if "normal" in self.unknowns:
                normal = Vector(*maps["normal"], 1)
                axes = shading_axes(normal)
                # With slope k, the normal turns towards the tangents by these angles, and directions the other way.
                turns = [tuple(Float(axis[k] / dr.norm(normal)) for axis in axes[:2]) for k in range(2)]
            elif needs.normal_map:
                axes = shading_axes(Vector(maps["normal"]))

            def add_view(view, cost, slope, curve):
                position = [row(mi, rows, view) for rows in problem["views"]]
                *directions, irradiance = view_geometry(mi, place, axes, *position, falloff)
                lit = (directions[0].z > 0) & (directions[1].z > 0)
                free = {name: type(maps[name])(maps[name]) for name in self.unknowns if name != "normal"}
                dr.enable_grad(free, directions)
                shader.hold(maps | free)
                shown = traced_encode(shader.eval(*directions) * irradiance, transfer)

                photo = dr.gather(mi.Color3f, problem["photos"], view * texels + index)
                error = dr.detach(shown) - photo
                weight = dr.select((photo >= CLIPPED) & (error > 0), 0, problem["weight"])
                if "weights" in problem:
                    weight = weight * dr.gather(Float, problem["weights"], view * texels + index)
                rho = dr.square(error)
                if "scale" in problem:
                    excess = dr.sqrt(1 + rho / dr.square(problem["scale"]))
                    rho = 2 * rho / (1 + excess)
                cost = cost + kind(dr.sum(weight * rho))
                if "scale" in problem:
                    weight = weight / excess

                seeds = [[(free[name], 1)] if name in free else
                         [(d, turned(dr.detach(d), *turns[axis])) for d in directions] for name, axis, _ in columns]
                jacobian = [[kind(dr.select(lit, slope, 0)) for slope in column] for column in along(shown, seeds)]
                slope, curve = list(slope), dict(zip(pairs, curve))
                for m, (*_, places) in enumerate(columns):
                    for c in range(3):
                        weighted = kind(weight[c]) * jacobian[m][c]
                        slope[places[c]] = slope[places[c]] + weighted * error[c]
                        for n, (*_, others) in enumerate(columns[:m + 1]):
                            pair = pair_of(places[c], others[c])
                            curve[pair] = curve[pair] + weighted * jacobian[n][c]
                return view + 1, cost, slope, list(curve.values())

            _, cost, slope, curve = dr.while_loop(
                (dr.zeros(mi.UInt32, texels), *zeros(1, kind), zeros(size, kind), zeros(len(pairs), kind)),
                lambda view, *_: view < problem["count"], add_view, label="views")
            shader.release()
            # The slopes were by what the plugin takes; these factors make them slopes by the unknowns.
            return (cost, [value * by for value, by in zip(slope, stretch)],
                    [value * stretch[i] * stretch[j] for (i, j), value in zip(pairs, curve)])

        def steps(problem, start, damping, mean, precision, low, high, iterations):
            def iterate(k, trial, x, damping, data, prior, slope, curve):
                trial_prior = sum(p * dr.square(t - m) for p, t, m in zip(precision, trial, mean))
                trial_data, trial_slope, trial_curve = linearised(problem, trial)
                better = trial_data + trial_prior <= (data + prior) * (1 + ROUNDING)  # False for what is no number
                better &= dr.isfinite(trial_data + trial_prior)

                def kept(new, old):
                    return [kept(*pair) for pair in zip(new, old)] if isinstance(new, list) else dr.select(better, new, old)

                arrived = reduce(dr.maximum, [dr.abs(t - v) for t, v in zip(trial, x)]) <= STILL
                by = dr.select(better, EASED, dr.select(arrived, 1, STIFFENED))
                damping = dr.select(k == 0, damping, dr.clip(damping * by, *DAMPING))
                x, data, prior, slope, curve = kept([trial, trial_data, trial_prior, trial_slope, trial_curve],
                                                    [x, data, prior, slope, curve])

                down = [p * (m - v) - s for s, p, v, m in zip(slope, precision, x, mean)]
                stuck = [(v <= least) & (d < 0) | (v >= most) & (d > 0) for v, d, least, most in zip(x, down, low, high)]
                system = {(i, j): value * (1 + damping) if i == j else dr.select(stuck[i] | stuck[j], 0, value)
                          for (i, j), value in whole(curve, precision).items()}
                step = cholesky.solved(cholesky.factor(system, size), [dr.select(s, 0, d) for s, d in zip(stuck, down)])
                trial = [dr.clip(v + s, least, most) for v, s, least, most in zip(x, step, low, high)]
                return k + 1, trial, x, damping, data, prior, slope, curve

            state = (dr.zeros(mi.UInt32, texels), [Float(v) for v in start], start, damping, dr.full(Float, dr.inf, texels),
                     *zeros(1), zeros(size), zeros(len(pairs)))
            _, _, x, damping, data, prior, *_ = dr.while_loop(state, lambda k, *_: k <= iterations, iterate, label="iterations")
            return [x, [damping, data, prior]]

        def posterior(problem, x, precision):
            # What a highlight says is 1e6 times what a prior says, and more: in float32 its rounding would drown the prior.
            *_, curve = linearised(problem, x, dr.float64_array_t(Float))
            lower = cholesky.factor(whole(curve, precision), size)
            found = [*cholesky.inverse_diagonal(lower, size), cholesky.log_determinant(lower, size)]
            return [Float(v) for v in found]

        def equations(problem, x):
            cost, slope, curve = linearised(problem, x)
            return [[cost], slope, curve]

        return Functions(*(frozen(function, shader) for function in (steps, posterior, equations)))

    def _columns(self) -> list[tuple[str, int, tuple[int, int, int]]]:
        """The slopes that are taken: map, which of a normal's two, and whose unknown it is for red, green and blue.

        A channel of the radiance knows its own channel of a colour alone, so one forward pass serves all three.
        """
        columns, at = [], 0
        for name, count in self.unknowns.items():
            if name == "normal":
                columns += [(name, axis, (at + axis,) * 3) for axis in range(2)]
            else:
                columns.append((name, 0, (at, at + 1, at + 2) if count == 3 else (at,) * 3))
            at += count
        return columns

    def _maps(self, x: list, held: dict) -> tuple[dict, list]:
        """The maps as the plugin takes them (an unknown normal: its slopes), and the slope of each by its unknown."""
        mi, maps, stretch, at = self.mi, {}, [], 0
        for name, planes in held.items():
            maps[name] = mi.Color3f(*planes) if len(planes) == 3 else planes[0]
        for name, count in self.unknowns.items():
            planes, by = x[at:at + count], [1.0] * count
            if name in COLOURS:
                planes, by = zip(*(traced_decode(v) for v in planes))
            maps[name] = planes if name == "normal" else mi.Color3f(*planes) if count == 3 else planes[0]
            stretch += by
            at += count
        return maps, stretch
