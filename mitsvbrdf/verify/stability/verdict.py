"""From figures to a verdict: exact, clamped, degraded, limited, refused, wrong or not finite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ...measure.tolerances import SWEEP_TOLERANCES

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
