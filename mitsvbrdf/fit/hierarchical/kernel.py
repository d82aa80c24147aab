"""The kernel of the texel solver, written for one texel; Dr.Jit runs one thread for each.

Dr.Jit traces the kernel: a list has one value for each unknown, and each value is an array over all texels of
a tile.
"""

import weakref
from collections.abc import Sequence
from functools import reduce
from types import ModuleType
from typing import Any

from ... import color
from ...color import CLIPPED
from ...material.maps import COLOURS, Bsdf
from ...render.needs import Needs
from ...render.plugins import shading_axes
from ...render.texels import HeldPlugin, along, frozen, row, texel_position, view_geometry
from ...views import Falloff
from . import cholesky
from .unknowns import Unknowns, columns_of, pair_of, pairs_of

EASED, STIFFENED = 0.3, 4.0  # factors of the damping after an accepted and after a refused step
DAMPING_RANGE = 1e-6, 1e6
ROUNDING = 1e-5  # relative growth of the cost that does not count: errors are differences of float32
# after a refused step of at most this length, the texel has converged: the damping stays
STILL = 1e-4
TILE = 2**18  # texels that are solved at once, so that their arrays stay small
FREE = 1.0  # above this damping, a step up to STILL does not end the search: damping may have shortened it


def tile_rows(side: int) -> int:
    """Number of rows of a tile of a material with ``side`` texels a side."""
    return min(side, max(1, TILE // side))


def tiles(side: int, count: int | None = None) -> list[slice]:
    """Tiles of equal size that cover ``count`` rows (default: all); the last may overlap the one before."""
    count, rows = count or side, tile_rows(side)
    return [slice(first, first + rows) for first in (min(k, count - rows) for k in range(0, count, rows))]


class Kernel:
    """Cost, normal equations and steps of every texel, traced once for a kind of material and scene.

    :attr:`steps`, :attr:`posterior` and :attr:`equations` are called by the methods of
    :class:`~mitsvbrdf.fit.hierarchical.solver.TexelSolver`. Their ``problem`` has the Dr.Jit arrays
    ``photos`` (of the tile), ``texels`` (their places, row by row), ``side`` (of the material, in texels),
    ``views`` (cameras, lights, intensities), ``count`` (of the views), ``weight`` (1 / noise^2) and ``fixed``
    (maps of the tile). Optional ones are ``scale`` (s of the robust cost), ``weights`` (of the tile's pixels)
    and ``curve`` (two numbers of the response curve). The argument ``texels`` is their number in a tile.
    """

    def __init__(self, mi: ModuleType, bsdf: Bsdf, unknowns: Unknowns, needs: Needs, texels: int,
                 falloff: Falloff, transfer: color.Transfer) -> None:
        self.mi, self.unknowns, self.needs = mi, unknowns, needs
        self.falloff, self.transfer = falloff, transfer
        self.texels, self.size = texels, unknowns.size
        self.columns = columns_of(unknowns)
        self.pairs = pairs_of(self.columns)
        self.shader = HeldPlugin(mi, bsdf, needs)
        # no reference cycle: Python's garbage collector would free Dr.Jit's arrays in any thread
        me = weakref.proxy(self)
        self.steps = frozen(lambda *args: Kernel._steps(me, *args), self.shader)
        self.posterior = frozen(lambda *args: Kernel._posterior(me, *args), self.shader)
        self.equations = frozen(lambda *args: Kernel._equations(me, *args), self.shader)

    def zeros(self, count: int, kind: Any = None) -> list:
        """``count`` zeros for each texel, each an object of its own, since loops write into their state."""
        import drjit as dr

        return [dr.zeros(kind or self.mi.Float, self.texels) for _ in range(count)]

    def _steps(self, problem: dict, start: list, damping: Any, mean: list, precision: list, low: list,
               high: list, iterations: Any) -> list:
        import drjit as dr

        def iterate(k: Any, moves: Any, trial: list, x: list, damping: Any, data: Any, prior: Any,
                    slope: list, curve: list) -> tuple:
            trial_prior = sum(p * dr.square(t - m) for p, t, m in zip(precision, trial, mean))
            trial_data, trial_slope, trial_curve = self._linearised(problem, trial)
            # False where the cost is NaN
            better = trial_data + trial_prior <= (data + prior) * (1 + ROUNDING)
            better &= dr.isfinite(trial_data + trial_prior)
            still = (k > 0) & (damping <= FREE) & (farthest(trial, x) <= STILL)
            damping = dr.select(k == 0, damping, next_damping(damping, better, trial, x))
            x, data, prior, slope, curve = chosen(better, [trial, trial_data, trial_prior, trial_slope,
                                                           trial_curve], [x, data, prior, slope, curve])
            down = [p * (m - v) - s for s, p, v, m in zip(slope, precision, x, mean)]
            step = bounded_step(down, self._matrix(curve, precision), damping, x, low, high)
            trial = [dr.clip(v + s, least, most) for v, s, least, most in zip(x, step, low, high)]
            return k + 1, ~still, trial, x, damping, data, prior, slope, curve

        Float = self.mi.Float
        state = (dr.zeros(self.mi.UInt32, self.texels), dr.full(self.mi.Bool, True, self.texels),
                 [Float(v) for v in start], start, damping,
                 dr.full(Float, dr.inf, self.texels), *self.zeros(1), self.zeros(self.size),
                 self.zeros(len(self.pairs)))
        _, _, _, x, damping, data, prior, *_ = dr.while_loop(
            state, lambda k, moves, *_: moves & (k <= iterations), iterate, label="iterations")
        return [x, [damping, data, prior]]

    def _posterior(self, problem: dict, x: list, precision: list) -> list:
        import drjit as dr

        # A highlight has 1e6 times a prior's precision, and more: float32's rounding would drown the prior.
        *_, curve = self._linearised(problem, x, dr.float64_array_t(self.mi.Float))
        lower = cholesky.factor(self._matrix(curve, precision), self.size)
        found = [*cholesky.inverse_diagonal(lower, self.size), cholesky.log_determinant(lower, self.size)]
        return [[self.mi.Float(v) for v in found]]

    def _equations(self, problem: dict, x: list) -> list:
        cost, slope, curve = self._linearised(problem, x)
        return [[cost], slope, curve]

    def _matrix(self, curve: list, precision: list) -> cholesky.Matrix:
        """J^T W J, given at :attr:`pairs`, plus the prior's precision."""
        matrix = dict(zip(self.pairs, curve))
        return matrix | {(u, u): matrix[u, u] + p for u, p in enumerate(precision)}

    def _linearised(self, problem: dict, x: list, kind: Any = None) -> tuple:
        """The data cost, J^T W e, and J^T W J at :attr:`pairs`, all at x; summed in floats of ``kind``."""
        import drjit as dr

        kind = kind or self.mi.Float
        texels = Texels(self, problem, x, kind)
        state = (dr.zeros(self.mi.UInt32, self.texels), *self.zeros(1, kind), self.zeros(self.size, kind),
                 self.zeros(len(self.pairs), kind))
        _, cost, slope, curve = dr.while_loop(state, lambda view, *_: view < problem["count"],
                                              texels.add_view, label="views")
        self.shader.release()
        # Turn derivatives with respect to the plugin's inputs into derivatives with respect to the unknowns.
        by = texels.stretch
        curve = [v * by[i] * by[j] for (i, j), v in zip(self.pairs, curve)]
        return cost, [s * b for s, b in zip(slope, by)], curve


class Texels:
    """The texels at one x, rendered and compared with each photo; sums are in floats of ``kind``."""

    def __init__(self, kernel: Kernel, problem: dict, x: list, kind: Any) -> None:
        import drjit as dr

        mi, self.kernel, self.problem, self.kind = kernel.mi, kernel, problem, kind
        self.index = dr.arange(mi.UInt32, kernel.texels)
        self.place = texel_position(mi, problem["texels"], problem["side"])
        self.maps, self.stretch = traced_maps(mi, kernel.unknowns, x, problem["fixed"])
        Vector: Any = dr.float64_array_t(mi.Vector3f)
        self.axes, self.turns = None, []
        if "normal" in kernel.unknowns.shapes:
            normal = Vector(*self.maps["normal"], 1)
            self.axes = shading_axes(normal)
            # Angles, per unit of slope k, by which the normal turns towards the tangents; directions turn the
            # other way.
            self.turns = [tuple(mi.Float(axis[k] / dr.norm(normal)) for axis in self.axes[:2])
                          for k in range(2)]
        elif kernel.needs.normal_map:
            self.axes = shading_axes(Vector(self.maps["normal"]))

    def add_view(self, view: Any, cost: Any, slope: list, curve: list) -> tuple:
        """Add the part of one view to the data cost, J^T W e and J^T W J."""
        import drjit as dr

        shown, lit, seeds = self._shown(view)
        error, weight, part = self._weighed(dr.detach(shown), view)
        jacobian = [[self.kind(dr.select(lit, s, 0)) for s in column] for column in along(shown, seeds)]
        columns, slope, by_pair = self.kernel.columns, list(slope), dict(zip(self.kernel.pairs, curve))
        for m, (*_, places) in enumerate(columns):
            for c in range(3):
                weighted = self.kind(weight[c]) * jacobian[m][c]
                slope[places[c]] = slope[places[c]] + weighted * error[c]
                for n, (*_, others) in enumerate(columns[:m + 1]):
                    pair = pair_of(places[c], others[c])
                    by_pair[pair] = by_pair[pair] + weighted * jacobian[n][c]
        return view + 1, cost + self.kind(part), slope, list(by_pair.values())

    def _shown(self, view: Any) -> tuple:
        """Display values rendered for a view; whether light and camera are above; a seed for each column."""
        import drjit as dr

        kernel = self.kernel
        camera, light, intensity = (row(kernel.mi, rows, view) for rows in self.problem["views"])
        *directions, irradiance = view_geometry(kernel.mi, self.place, self.axes, camera, light, intensity,
                                                kernel.falloff)
        lit = (directions[0].z > 0) & (directions[1].z > 0)
        free = {name: type(self.maps[name])(self.maps[name]) for name in kernel.unknowns.shapes
                if name != "normal"}
        dr.enable_grad(free, directions)
        kernel.shader.hold(self.maps | free)
        shown = traced_encode(kernel.shader.eval(*directions) * irradiance, kernel.transfer)
        if "curve" in self.problem:
            shown = color.Curve(*self.problem["curve"]).bent(shown, traced())
        seeds = [[(free[name], 1)] if name in free else
                 [(d, turned(dr.detach(d), *self.turns[axis])) for d in directions]
                 for name, axis, _ in kernel.columns]
        return shown, lit, seeds

    def _weighed(self, shown: Any, view: Any) -> tuple:
        """Errors of the display values of a view, their weights, and their part of the cost."""
        import drjit as dr

        problem, place = self.problem, view * self.kernel.texels + self.index
        photo = dr.gather(self.kernel.mi.Color3f, problem["photos"], place)
        error = shown - photo
        weight = dr.select((photo >= CLIPPED) & (error > 0), 0, problem["weight"])
        if "weights" in problem:
            weight = weight * dr.gather(self.kernel.mi.Float, problem["weights"], place)
        if "scale" not in problem:
            return error, weight, dr.sum(weight * dr.square(error))
        excess = dr.sqrt(1 + dr.square(error) / dr.square(problem["scale"]))
        return error, weight / excess, dr.sum(weight * (2 * dr.square(error) / (1 + excess)))


def next_damping(damping: Any, better: Any, trial: list, x: list) -> Any:
    """The damping after a step from ``x`` to ``trial``, accepted where ``better``, else refused."""
    import drjit as dr

    arrived = farthest(trial, x) <= STILL
    return dr.clip(damping * dr.select(better, EASED, dr.select(arrived, 1, STIFFENED)), *DAMPING_RANGE)


def farthest(trial: list, x: list) -> Any:
    """The largest change of any number from ``x`` to ``trial``."""
    import drjit as dr

    return reduce(dr.maximum, [dr.abs(t - v) for t, v in zip(trial, x)])


def bounded_step(down: list, matrix: cholesky.Matrix, damping: Any, x: list, low: list, high: list) -> list:
    """The damped step; an unknown at its bound that would leave its range takes no part in it."""
    import drjit as dr

    stuck = [(v <= least) & (d < 0) | (v >= most) & (d > 0) for v, d, least, most in zip(x, down, low, high)]
    system = {(i, j): value * (1 + damping) if i == j else dr.select(stuck[i] | stuck[j], 0, value)
              for (i, j), value in matrix.items()}
    return cholesky.solved(cholesky.factor(system, len(x)), [dr.select(s, 0, d) for s, d in zip(stuck, down)])


def chosen(better: Any, new: Any, old: Any) -> Any:
    """The new values where they are better, else the old ones; in lists, item by item."""
    import drjit as dr

    return ([chosen(better, *pair) for pair in zip(new, old)] if isinstance(new, list)
            else dr.select(better, new, old))


def traced_maps(mi: ModuleType, unknowns: Unknowns, x: list, fixed: dict) -> tuple[dict, list]:
    """The maps as inputs of the plugin (unknown normal: its slopes), and their derivatives by unknowns."""
    def whole(planes: Sequence) -> Any:
        return mi.Color3f(*planes) if len(planes) == 3 else planes[0]

    maps, stretch = {name: whole(planes) for name, planes in fixed.items()}, list[Any]()
    for name, of in unknowns.slices.items():
        planes, by = zip(*(traced_decode(v) if name in COLOURS else (v, 1.0) for v in x[of]))
        maps[name] = planes if name == "normal" else whole(planes)
        stretch += by
    return maps, stretch


def turned(direction: Any, towards_s: Any, towards_t: Any) -> Any:
    """The derivative of a direction in a shading frame whose normal turns towards its tangents.

    The rotation of the frame about the normal is omitted: isotropic lobes do not depend on it.
    """
    return type(direction)(-towards_s * direction.z, -towards_t * direction.z,
                           towards_s * direction.x + towards_t * direction.y)


def traced_decode(value: Any) -> tuple:
    """:func:`mitsvbrdf.color.decode` of gamma 2.2, and its derivative."""
    import drjit as dr

    toe = color.TOE ** (1 / 2.2)
    power = dr.maximum(value, toe) ** 1.2
    return (dr.select(value <= toe, value * (color.TOE / toe), value * power),
            dr.select(value <= toe, color.TOE / toe, 2.2 * power))


def traced() -> color.Operations:
    """The operations of Dr.Jit that :mod:`mitsvbrdf.color` needs."""
    import drjit as dr

    return color.Operations(dr.select, dr.maximum)


def traced_encode(linear: Any, transfer: color.Transfer) -> Any:
    """:func:`mitsvbrdf.color.encode` of Dr.Jit values."""
    return color.response(transfer).encode(linear, traced())
