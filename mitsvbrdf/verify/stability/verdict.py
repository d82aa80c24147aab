"""From figures to a verdict, and the cuts of the model that the verdict ``clamped`` names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from torch import Tensor

from ...color import TOE
from ...measure.tolerances import SWEEP_TOLERANCES
from ...render.analytic import MIN_ALPHA
from ...render.bsdf import F0_RANGE
from ...render.needs import CONSTANT_FRESNEL_DEGREES, half_angle_bound
from .sweeps import Case

# From best to worst: ``degraded`` is as far off as conditioning explains, ``limited`` further, for a known
# cause and within a stated bound. The last two are never accepted, ``refused`` only of what is invalid.
VERDICTS = ("exact", "clamped", "degraded", "limited", "refused", "wrong", "not finite")


def verdict(figures: Mapping, limit: Mapping[str, float], clamps: Sequence[str] = (),
            known: tuple[float, str] | None = None) -> tuple[str, str]:
    """A key of :data:`VERDICTS`, and why.

    Args:
        figures: ``errors``, the relative L2 error of ``image`` and each map's gradient, None for infinite;
            ``not_finite`` and ``silenced``, how many values by the same names; or ``refused``, the error
            message, alone.
        limit: what one rounding of every normal changes
            (:func:`mitsvbrdf.verify.float32_limits.float32_limit`), by the names of ``errors``; empty where
            it was not looked at. Measured errors reach a third of it where nothing else is wrong.
        clamps: names of the cuts that act.
        known: the largest error that is known and explained, and its cause.
    """
    if "refused" in figures:
        return "refused", figures["refused"]
    for kind, what, how in (("not finite", "not_finite", ""), ("wrong", "silenced", " come back as 0")):
        found = [f"{count} of {name}" for name, count in figures[what].items() if count]
        if found and not (known and kind == "wrong"):
            return kind, ", ".join(found) + how
    errors = {name: float("inf") if error is None else error for name, error in figures["errors"].items()}
    excess = {name: error / max(_tolerance(name), limit.get(name, 0.0)) for name, error in errors.items()}
    name = max(excess, key=excess.__getitem__)
    if excess[name] > 1:
        if known and errors[name] <= known[0]:
            return "limited", f"{known[1]}: {name} {errors[name]:.1g}"
        return "wrong", f"{name} {errors[name]:.1g}, {_beside(name, limit)}"
    off = {name: error / _tolerance(name) for name, error in errors.items()}
    name = max(off, key=off.__getitem__)
    if off[name] > 1:
        return "degraded", f"{name} {errors[name]:.1g}, {_beside(name, limit)}"
    return ("clamped", ", ".join(clamps)) if clamps else ("exact", "")


def _tolerance(name: str) -> float:
    return SWEEP_TOLERANCES["image" if name == "image" else "gradient"]


def _beside(name: str, limit: Mapping[str, float]) -> str:
    return f"one rounding makes {limit[name]:.1g}" if name in limit else f"tolerance {_tolerance(name):.1g}"


Acts = Callable[[Case, Tensor], bool]


def _smoother_than(bsdf: str) -> Acts:
    return lambda case, radiance: case.svbrdf.bsdf == bsdf and bool(
        (case.svbrdf["roughness"].double() ** 2 <= MIN_ALPHA[bsdf]).any())


def _index_cut(case: Case, radiance: Tensor) -> bool:
    if case.svbrdf.bsdf != "roughconductor" or half_angle_bound(case.views) <= CONSTANT_FRESNEL_DEGREES:
        return False
    f0 = case.svbrdf["specular"]
    return bool(((f0 < F0_RANGE[0]) | (f0 > F0_RANGE[1])).any())


# By name, as a verdict has it: whether the cut changes a value or gradient of a case of this radiance. No
# other cut acts in the sweeps.
CLAMPS: dict[str, Acts] = {
    # D is 1 / (pi alpha^2) at its peak: without an end it overflows float32 at r = 1e-10, and one rounding of
    # the normal is worth 6e-8 / alpha of it. Below, the image stays as it is and roughness has gradient 0.
    f"alpha >= {MIN_ALPHA['roughconductor']:g}": _smoother_than("roughconductor"),
    # The plugin's own end. Below, only the diffuse lobe answers to roughness.
    f"alpha >= {MIN_ALPHA['principled']:g}": _smoother_than("principled"),
    # The refractive index is infinite at F0 = 1, its slope at F0 = 0. Beyond, F is proportional to F0.
    f"index for F0 in [{F0_RANGE[0]:g}, {F0_RANGE[1]:g}]": _index_cut,
    # The power curve is vertical at 0: below the toe it is its chord, of slope 1282.
    "toe of gamma 2.2": lambda case, radiance: case.transfer == "gamma2.2" and bool((radiance < TOE).any()),
    # A burnt-out photo value says at least this bright: gradient 0 where the rendering is brighter still.
    "burnt-out photos": lambda case, radiance: case.transfer is not None and bool((radiance >= 1).any()),
}
