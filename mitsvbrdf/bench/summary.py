"""From records to what tables and curves show: medians over seeds with quartiles, times to an error, differences.

For several materials or captures the error of a seed is the mean over them; a seed that lacks one of them does not count.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ..system.timing import spread
from .published import Published
from .variants import FULL

# The errors that are judged by, of known materials and of real captures, and what to call them.
ERRORS: dict[str, dict[str, str]] = {
    "material": {"mean": "Error of the maps", "novel_light": "Error under new light"},
    "capture": {"left_out": "Error of photos left out", "seen": "Error of photos seen"},
}

KINDS = {"material": "known material", "capture": "real capture"}  # what is fitted, in words


@dataclass(frozen=True)
class Point:
    """A method at one budget.

    Args:
        budget: seconds it was given.
        seconds: the loop's own, median over seeds.
        median: of the error over seeds; ``low`` and ``high`` are its quartiles.
        seeds: how many.
    """

    budget: float
    seconds: float
    median: float
    low: float
    high: float
    seeds: int


FIT_SUITES = ("methods", "ablation", "gan")  # whose records are fits


def of(records: Iterable[Mapping], suite: str, kind: str) -> list[Mapping]:
    """The fits of a suite of materials or of captures."""
    return [r for r in records if r["suite"] == suite and r["kind"] == kind] if suite in FIT_SUITES else []


def names(fits: Iterable[Mapping]) -> list[str]:
    """Materials or captures, in the order of the records."""
    return list(dict.fromkeys(r["name"] for r in fits))


def budgets(fits: Iterable[Mapping]) -> list[float]:
    """Budgets, the shortest first."""
    return sorted({r["budget"] for r in fits})


def curves(fits: Sequence[Mapping], error: str, only: Sequence[str] | None = None) -> dict[str, list[Point]]:
    """Method -> its points, the shortest budget first.

    Args:
        fits: of one suite and kind.
        error: a name in the records' ``errors``.
        only: the materials or captures that count; left out: all.
    """
    wanted = set(names(fits) if only is None else only)
    groups: dict[str, dict[float, dict[int, dict[str, Mapping]]]] = {r["method"]: {} for r in fits}
    for r in fits:
        if r["name"] in wanted and error in r["errors"]:
            groups[r["method"]].setdefault(r["budget"], {}).setdefault(r["seed"], {})[r["name"]] = r
    found = {}
    for method, by_budget in groups.items():
        points = [_point(budget, error, [list(each.values()) for each in seeds.values() if set(each) == wanted])
                  for budget, seeds in sorted(by_budget.items())]
        found[method] = [point for point in points if point]
    return {method: points for method, points in found.items() if points}


def _point(budget: float, error: str, seeds: list[list[Mapping]]) -> Point | None:
    if not seeds:
        return None
    errors = spread([statistics.fmean(r["errors"][error] for r in each) for each in seeds])
    seconds = statistics.median(statistics.fmean(r["seconds"] for r in each) for each in seeds)
    return Point(budget, seconds, errors["median"], errors["low"], errors["high"], len(seeds))


def first_below(points: Sequence[Point], target: float) -> Point | None:
    """The shortest budget whose median error is below a target. Between budgets nothing is known: schedules follow them."""
    return next((point for point in points if point.median < target), None)


def published_mean(published: Published, kind: str, wanted: Sequence[str], error: str) -> dict[str, float]:
    """Whose -> the mean of their published errors, where all of these materials or captures have one."""
    entries = [published.get(kind, {}).get(name, {}) for name in wanted]
    whose = [who for who in (entries[0] if entries else {}) if all(error in each.get(who, {}) for each in entries)]
    return {who: statistics.fmean(each[who][error] for each in entries) for who in whose}


def with_published(published: Published, kind: str, wanted: Sequence[str], who: str, error: str) -> list[str]:
    """The materials or captures for which somebody published this error."""
    return [name for name in wanted if error in published.get(kind, {}).get(name, {}).get(who, {})]


def differences(fits: Sequence[Mapping], error: str) -> dict[str, dict[float, dict[str, float]]]:
    """Variant -> budget -> spread of its error less that of the whole method, each pair of one material and one seed."""
    whole = {(r["budget"], r["name"], r["seed"]): r["errors"][error] for r in fits
             if r["method"] == FULL and error in r["errors"]}
    pairs: dict[str, dict[float, list[float]]] = {}
    for r in fits:
        key = r["budget"], r["name"], r["seed"]
        if r["method"] != FULL and error in r["errors"] and key in whole:
            pairs.setdefault(r["method"], {}).setdefault(r["budget"], []).append(r["errors"][error] - whole[key])
    return {method: {budget: spread(each) for budget, each in sorted(found.items())} for method, found in pairs.items()}


def failures(records: Iterable[Mapping]) -> list[Mapping]:
    """Fits that could not be done."""
    return [r for r in records if r["suite"] in FIT_SUITES and r["stopped"] == "failed"]
