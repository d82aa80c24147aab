"""Levenberg-Marquardt for every texel at once, through Mitsuba's BSDF plugins.

A rectified photo shows texel (i, j) in pixel (i, j), so a fit without ties between texels is one small least-squares problem a
texel: a few unknowns, three values a photo. One thread solves it: values and slopes of all photos by forward derivatives of
the plugin, the normal equations and their Cholesky factor stay in its registers, and nothing but the photos is read in the
loop. After Levenberg 1944, Marquardt 1963 (damping in proportion to the diagonal) and Bertsekas 1982 (an unknown at its bound
that wants out is left out of the step of the others).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..maps import CHANNELS, COLOURS, SVBRDF, Bsdf
from ..views import Views
from .bsdf import needed_maps
from .llvm import mitsuba_module
from .needs import Needs, scene_needs
from .rectified import register, shading_axes, to_shading
from .texels import HeldPlugin, row, texel_position

CLIPPED = 0.995  # photo values from here on are cut highlights: they only say "at least this bright"
EASED, STIFFENED = 0.3, 4.0  # what an accepted and a refused step make of the damping
DAMPING = 1e-6, 1e6  # its range
TINY = 1e-12  # added to the diagonal, where neither photos nor prior say anything
PIVOT = 1e-7  # a pivot is at least this share of its diagonal: below it are rounding errors


@dataclass(frozen=True)
class Solved:
    """The texels after some iterations, float32.

    Args:
        x: the unknowns, U x R x R.
        damping: R x R, for the next call.
        data: the photos' part of the cost, R x R; infinite where a texel's start was not finite.
        prior: the prior's part of it, R x R.
        variance: of the unknowns, U x R x R: the diagonal of (J^T W J + precision)^-1 at ``x``; None if not asked for.
    """

    x: Tensor
    damping: Tensor
    data: Tensor
    prior: Tensor
    variance: Tensor | None = None


class TexelSolver:
    """The unknowns of each texel of a map, and Levenberg-Marquardt for them.

    The unknowns, in this order, are those of the maps of ``bsdf`` that are not held: colours channel by channel as
    linear^(1/2.2), metallic and roughness as they are, and the two slopes n_x / n_z and n_y / n_z of the normal.
    :attr:`unknowns` counts them by map.

    Args:
        bsdf: the parameter set.
        held: maps that are not unknown, name -> R x R x C, linear.
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
        self.device = "cuda" if variant.startswith("cuda") else "cpu"
        counts = CHANNELS[bsdf] | {"normal": 2} | ({"specular": 1} if grey_specular else {})
        self.unknowns = {name: counts[name] for name in CHANNELS[bsdf] if name not in self.held}
        self._kernels: dict[tuple, object] = {}

    def numbers(self, svbrdf: SVBRDF) -> Tensor:
        """The unknowns of a material, U x R x R; of a coloured specular map that is one number, the mean."""
        planes = []
        for name, count in self.unknowns.items():
            value = svbrdf[name]
            if name == "normal":
                value = value[..., :2] / value[..., 2:]
            elif name in COLOURS:
                value = color.encode(value.mean(dim=-1, keepdim=True) if count < value.shape[-1] else value)
            planes += value.unbind(-1)
        return torch.stack(planes)

    def svbrdf(self, x: Tensor) -> SVBRDF:
        """The material of unknowns U x R x R and the maps held; an expanded map where specular is one number."""
        maps = dict(self.held)
        for name, value in zip(self.unknowns, x.permute(1, 2, 0).split(list(self.unknowns.values()), dim=-1)):
            if name == "normal":
                value = F.normalize(torch.cat((value, torch.ones_like(value[..., :1])), dim=-1), dim=-1)
            elif name in COLOURS:
                value = color.decode(value)
            maps[name] = value.expand(*value.shape[:2], CHANNELS[self.bsdf][name])
        return SVBRDF(self.bsdf, {name: maps[name] for name in CHANNELS[self.bsdf]})

    def solve(self, x: Tensor, damping: Tensor, photos: Tensor, views: Views, transfer: color.Transfer, *,
              bounds: tuple[Tensor, Tensor], mean: Tensor, precision: Tensor, noise: float, robust: float | None = None,
              weights: Tensor | None = None, iterations: int = 5, variances: bool = False) -> Solved:
        """Take up to ``iterations`` Levenberg-Marquardt steps in every texel; none that raises its cost.

        The cost is sum_vc w_v rho(e_vc) / noise^2 + sum_u precision_u (x_u - mean_u)^2, with e the error in display values;
        of a clipped photo pixel (0.995 and above) only a rendering that is too dark counts.

        Args:
            x: where to start, U x R x R, within the bounds.
            damping: R x R, relative to the diagonal of the normal equations; 0.01 is a fair start.
            photos: N x R x R x 3, display values.
            views: N views.
            transfer: how display values encode light.
            bounds: lowest and highest value of each unknown, U numbers each.
            mean: of the prior, U x R x R.
            precision: of the prior (1 / variance), U x R x R; 0 for none.
            noise: standard deviation of display values.
            robust: s of Cauchy's rho(e) = s^2 log(1 + e^2 / s^2), in display values; left out: e^2.
            weights: of each photo's pixels, N x R x R; left out: 1.
            iterations: steps to take.
            variances: whether to work them out too.
        """
        mi, dr = mitsuba_module(self.variant), _drjit()
        side, views = x.shape[-1], views.in_patch_sides().to(torch.float64)
        needs, maps = self._needs(views, side)
        key = (needs, side, views.falloff, transfer, tuple(maps), robust is None, weights is None, variances)
        if key not in self._kernels:
            self._kernels[key] = self._kernel(*key)

        def flat(value: Tensor, dtype: torch.dtype = torch.float32):
            return value.detach().to(dtype).to(self.device).contiguous().reshape(-1)

        Float, Float64 = mi.Float, dr.float64_array_t(mi.Float)

        def planes(value: Tensor) -> list:
            return [Float(flat(plane)) for plane in value]

        numbers = dr.opaque(Float, 1 / noise**2), dr.opaque(Float, robust or 1.0)
        found = self._kernels[key](
            planes(x), planes(mean), planes(precision), Float(flat(damping)), Float(flat(photos)),
            [Float64(flat(v, torch.float64)) for v in (views.camera, views.light, views.intensity)],
            {name: Float(flat(value)) for name, value in maps.items()}, Float(flat(weights)) if weights is not None else None,
            [[dr.opaque(Float, float(v)) for v in bound] for bound in bounds], numbers,
            dr.opaque(mi.UInt32, len(views)), dr.opaque(mi.UInt32, iterations))
        dr.eval(found)
        dr.sync_thread()

        def back(values):
            return torch.stack([v.torch() for v in values]).reshape(-1, side, side).to(x.device)

        moved, damping, data, prior, variance = found
        return Solved(back(moved), *(back([v])[0] for v in (damping, data, prior)), back(variance) if variances else None)

    def _needs(self, views: Views, side: int) -> tuple[Needs, dict[str, Tensor]]:
        """What the scene needs, and the held maps that are read."""
        def unknown(count: int, channels: int) -> Tensor:
            return torch.ones(count, requires_grad=True).expand(side, side, channels)

        free = {name: unknown(3 if name == "normal" else count, CHANNELS[self.bsdf][name])
                for name, count in self.unknowns.items()}
        material = SVBRDF(self.bsdf, free | self.held)
        needs = scene_needs(material, views, "mitsuba")
        return needs, {name: value for name, value in needed_maps(material, needs).items() if name in self.held}

    def _kernel(self, needs: Needs, side: int, falloff: str, transfer: str, fixed: tuple[str, ...], squares: bool,
                unweighted: bool, variances: bool):
        mi, dr = self.mi, _drjit()
        Float, Vector, texels = mi.Float, dr.float64_array_t(mi.Vector3f), side * side
        shader = HeldPlugin(mi, self.bsdf, needs)
        columns = self._columns()
        count = sum(self.unknowns.values())
        pairs = _pairs(columns)

        def empty():
            """Sums to be: a cost, its slopes and its curvature. Each is an object of its own, since loops write into them."""
            one, *rest = (dr.zeros(Float, texels) for _ in range(1 + count + len(pairs)))
            return one, rest[:count], dict(zip(pairs, rest[count:]))

        def linearised(x, problem):
            """Cost at x of the photos, and J^T W e and J^T W J there."""
            photos, positions, held, weights, (precision, scale), views = problem
            index = dr.arange(mi.UInt32, texels)
            place = texel_position(mi, index, side)
            maps, stretch = self._maps(x, held)
            axes = turn = None
            if "normal" in self.unknowns:
                slopes = maps.pop("normal")
                normal = Vector(slopes[0], slopes[1], 1)
                axes = shading_axes(normal)
                length = dr.norm(normal)
                turn = [(Float(axes[0][k] / length), Float(axes[1][k] / length)) for k in range(2)]
            elif needs.normal_map:
                axes = shading_axes(Vector(maps["normal"]))

            def local(direction):
                return mi.Vector3f(to_shading(axes, direction) if axes else direction)

            def add_view(view, cost, slope, curve):
                camera, light, intensity = (row(mi, numbers, view) for numbers in positions)
                to_light = light - place
                distance2 = dr.squared_norm(to_light)
                wi, wo = local(dr.normalize(camera - place)), local(to_light / dr.sqrt(distance2))
                if falloff == "none":
                    distance2 = dr.squared_norm(light)
                irradiance = mi.Color3f(intensity / distance2)
                lit = (wi.z > 0) & (wo.z > 0)

                seeds = {name: type(maps[name])(maps[name]) for name in self.unknowns if name != "normal"}
                directions = [mi.Vector3f(wi), mi.Vector3f(wo)]
                dr.enable_grad(seeds, directions)
                shader.hold(maps | seeds)
                shown = _encode(dr, shader.eval(*directions) * irradiance, transfer)
                photo = dr.gather(mi.Color3f, photos, view * texels + index)
                error = dr.detach(shown) - photo
                weight = dr.select((photo >= CLIPPED) & (error > 0), 0, precision)
                if not unweighted:
                    weight = weight * dr.gather(Float, weights, view * texels + index)
                if squares:
                    cost = cost + dr.sum(weight * dr.square(error))
                else:
                    ratio = dr.square(error / scale)
                    cost = cost + dr.sum(weight * dr.square(scale) * dr.log(1 + ratio))
                    weight = weight / (1 + ratio)

                jacobian = []
                for name, axis, _ in columns:
                    if name == "normal":
                        a, b = turn[axis]
                        for direction in directions:
                            d = dr.detach(direction)
                            dr.set_grad(direction, mi.Vector3f(-a * d.z, -b * d.z, a * d.x + b * d.y))
                    else:
                        dr.set_grad(seeds[name], 1)
                    found = dr.forward_to(shown, flags=dr.ADFlag.ClearVertices)
                    jacobian.append(dr.select(lit, found, 0))
                    dr.clear_grad(shown)
                    dr.clear_grad([seeds, directions])
                slope, curve = list(slope), dict(curve)
                for k, (_, _, places) in enumerate(columns):
                    weighted = weight * jacobian[k]
                    for c in range(3):
                        slope[places[c]] = slope[places[c]] + weighted[c] * error[c]
                        for m in range(k + 1):
                            pair = _key(places[c], columns[m][2][c])
                            curve[pair] = curve[pair] + weighted[c] * jacobian[m][c]
                return view + 1, cost, slope, curve

            _, cost, slope, curve = dr.while_loop(
                (dr.zeros(mi.UInt32, texels), *empty()),
                lambda view, *_: view < views, add_view, label="views")
            shader.release()
            # Slopes so far are those by what the plugin takes; a factor each makes them those by the unknowns.
            return cost, [s * f for s, f in zip(slope, stretch)], {
                pair: value * stretch[pair_ints(pair)[0]] * stretch[pair_ints(pair)[1]] for pair, value in curve.items()}

        def solve(start, mean, precision, damping, photos, positions, held, weights, bounds, numbers, views, iterations):
            problem = photos, positions, held, weights, numbers, views

            def iterate(k, trial, x, damping, data, prior, slope, curve):
                trial_data, trial_slope, trial_curve = linearised(trial, problem)
                trial_prior = sum(p * dr.square(t - m) for p, t, m in zip(precision, trial, mean))
                better = trial_data + trial_prior < data + prior  # False for what is not finite
                damping = dr.select(k == 0, damping, dr.clip(damping * dr.select(better, EASED, STIFFENED), *DAMPING))
                data, prior = dr.select(better, trial_data, data), dr.select(better, trial_prior, prior)
                x = [dr.select(better, new, old) for new, old in zip(trial, x)]
                slope = [dr.select(better, new, old) for new, old in zip(trial_slope, slope)]
                curve = {pair: dr.select(better, trial_curve[pair], old) for pair, old in curve.items()}

                down = [-(s + p * (v - m)) for s, p, v, m in zip(slope, precision, x, mean)]
                stuck = [(v <= low) & (d < 0) | (v >= high) & (d > 0) for v, d, low, high in zip(x, down, *bounds)]
                step = _solved(dr, _whole(curve, precision), damping, down, stuck)
                trial = [dr.clip(v + s, low, high) for v, s, low, high in zip(x, step, *bounds)]
                return k + 1, trial, x, damping, data, prior, slope, curve

            prior, slope, curve = empty()
            state = (dr.zeros(mi.UInt32, texels), [Float(v) for v in start], start, damping,
                     dr.full(Float, dr.inf, texels), prior, slope, curve)
            _, _, x, damping, data, prior, _, curve = dr.while_loop(
                state, lambda k, *_: k <= iterations, iterate, label="iterations")
            return x, damping, data, prior, _variances(dr, _whole(curve, precision), count) if variances else None

        return dr.freeze(solve, state_fn=lambda *_, **__: shader._plugin)

    def _columns(self) -> list[tuple[str, int, tuple[int, int, int]]]:
        """The derivatives a view takes: map, axis of a slope, and whose unknown it is for red, green and blue.

        A channel of the radiance knows its own channel of a colour alone, so one derivative serves all three.
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
        """The maps of unknowns and held maps, as the plugin takes them (normal: two slopes), and their slopes by x."""
        mi, dr = self.mi, _drjit()
        maps = {name: value if len(value) % 3 else dr.unravel(mi.Color3f, value) for name, value in held.items()}
        stretch, at = [], 0
        for name, count in self.unknowns.items():
            part = x[at:at + count]
            if name in COLOURS:
                part, by = zip(*(_decode(dr, v) for v in part))
                stretch += by
            else:
                stretch += [self.mi.Float(1)] * count
            maps[name] = mi.Color3f(*part) if count == 3 else part[0] if count == 1 else list(part)
            at += count
        return maps, stretch


def _drjit():
    import drjit
    return drjit


def _key(i: int, j: int) -> str:
    return f"{max(i, j)} {min(i, j)}"


def pair_ints(pair: str) -> tuple[int, int]:
    i, j = pair.split()
    return int(i), int(j)


def _pairs(columns: list) -> list[str]:
    """The entries of the lower triangle of J^T J that are not always 0."""
    return sorted({_key(first[2][c], second[2][c]) for first in columns for second in columns for c in range(3)})


def _whole(curve: dict, precision: list) -> dict[tuple[int, int], object]:
    """The photos' curvature and the prior's."""
    whole = {pair_ints(pair): value for pair, value in curve.items()}
    return whole | {(u, u): whole[u, u] + p for u, p in enumerate(precision)}


def _cholesky(dr, matrix: dict, size: int) -> dict:
    """The lower factor of a matrix given by its entries (i, j), i >= j, those left out being 0; its diagonal inverted."""
    lower: dict = {}
    for j in range(size):
        pivot = matrix[j, j]
        for k in range(j):
            if (j, k) in lower:
                pivot = pivot - dr.square(lower[j, k])
        lower[j, j] = dr.rsqrt(dr.maximum(pivot, PIVOT * matrix[j, j]))
        for i in range(j + 1, size):
            entry = matrix.get((i, j))
            for k in range(j):
                if (i, k) in lower and (j, k) in lower:
                    product = lower[i, k] * lower[j, k]
                    entry = -product if entry is None else entry - product
            if entry is not None:
                lower[i, j] = entry * lower[j, j]
    return lower


def _solved(dr, matrix: dict, damping, right: list, stuck: list) -> list:
    """The damped step; unknowns that are stuck stay, and the others take the step that is best without them."""
    size = len(right)
    system = {(i, j): value * (1 + damping) + TINY if i == j else dr.select(stuck[i] | stuck[j], 0, value)
              for (i, j), value in matrix.items()}
    lower = _cholesky(dr, system, size)
    step = [dr.select(s, 0, r) for s, r in zip(stuck, right)]
    for i in range(size):
        for k in range(i):
            if (i, k) in lower:
                step[i] = step[i] - lower[i, k] * step[k]
        step[i] = step[i] * lower[i, i]
    for i in reversed(range(size)):
        for k in range(i + 1, size):
            if (k, i) in lower:
                step[i] = step[i] - lower[k, i] * step[k]
        step[i] = step[i] * lower[i, i]
    return step


def _variances(dr, matrix: dict, size: int) -> list:
    """The diagonal of the inverse: of each column of the lower factor's inverse, the sum of squares."""
    lower = _cholesky(dr, {(i, j): value + TINY if i == j else value for (i, j), value in matrix.items()}, size)
    found = []
    for u in range(size):
        column = {u: lower[u, u]}
        for i in range(u + 1, size):
            terms = [lower[i, k] * column[k] for k in column if (i, k) in lower]
            if terms:
                column[i] = -sum(terms[1:], terms[0]) * lower[i, i]
        squares = [dr.square(value) for value in column.values()]
        found.append(sum(squares[1:], squares[0]))
    return found


def _decode(dr, value):
    """:func:`mitsvbrdf.color.decode` of gamma 2.2, and its slope."""
    toe = color.TOE ** (1 / 2.2)
    curved = dr.maximum(value, toe) ** 1.2
    straight = value <= toe
    return (dr.select(straight, value * (color.TOE / toe), curved * value),
            dr.select(straight, color.TOE / toe, 2.2 * curved))


def _encode(dr, linear, transfer: str):
    """:func:`mitsvbrdf.color.encode`."""
    if transfer == "linear":
        return linear
    if transfer == "srgb":
        return dr.select(linear <= 0.0031308, 12.92 * linear, 1.055 * dr.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)
    toe = color.TOE ** (1 / 2.2)
    return dr.select(linear <= color.TOE, linear * (toe / color.TOE), dr.maximum(linear, color.TOE) ** (1 / 2.2))
