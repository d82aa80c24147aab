"""From records to what tables and curves show: medians over seeds with quartiles, times to an error,
differences.

For several materials or captures the error of a seed is the mean over them; a seed that lacks one of them
does not count.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ..io.timing import spread
from .behaviour import ended_for_good
from .methods import method_table
from .published import BLIND, Published
from .schema import USUAL_LEFT_OUT, capture_kind, identity
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
        seconds: the loop's own, median over seeds; ``wall`` with what comes before and after it.
        median: of the error over seeds; ``low`` and ``high`` are its quartiles.
        seeds: how many.
        scenes: quartiles over materials or captures, each of its median over seeds; ``count`` is how many
            these are.
        ended: whether all these fits ended by themselves.
    """

    budget: float
    seconds: float
    wall: float
    median: float
    low: float
    high: float
    seeds: int
    scenes: tuple[float, float]
    count: int
    ended: bool


BY_ITSELF = "iterations", "settled"  # how fits end before their budget does
FIT_SUITES = ("methods", "ablation", "gan")  # whose records are fits


def of(records: Iterable[Mapping], suite: str, kind: str) -> list[Mapping]:
    """The fits of a suite of materials or of captures, with those that a shorter budget stands for.

    Methods stand in their own order, the default first, whichever fit ended first.
    """
    fits = with_repeats([r for r in records if r["suite"] == suite and r["kind"] == kind]
                        if suite in FIT_SUITES else [])
    if suite != "methods":
        return fits
    rank = {name: number for number, name in enumerate(method_table())}
    return sorted(fits, key=lambda r: (rank.get(r["method"], len(rank)), r["name"]))


def with_repeats(fits: Sequence[Mapping]) -> list[Mapping]:
    """Fits and, at each longer budget that was not run, those that ended for good with a shorter one."""
    found = {identity(dict(r)): r for r in fits}
    for r in sorted(filter(ended_for_good, fits), key=lambda r: r["budget"]):
        for budget in budgets(fits):
            if budget > r["budget"]:
                found.setdefault(identity({**r, "budget": budget}), {**r, "budget": budget})
    return list(found.values())


def protocols(record: Mapping) -> list[dict]:
    """The record apart by what fits are judged by: known materials, and real captures by the photos left
    out.
    """
    materials = {**record, "records": [r for r in record["records"] if r.get("kind") != "capture"]}
    return [materials, *(protocol(record, numbers) for numbers in ways_to_leave_out(record["records"]))]


def for_readers(record: Mapping) -> list[dict]:
    """:func:`protocols`, those first in which others did not see the photos left out either, as their authors
    published.
    """
    return sorted(protocols(record), key=lambda part: not any(
        who.endswith(BLIND) for each in part["published"].get("capture", {}).values() for who in each))


def ways_to_leave_out(records: Iterable[Mapping]) -> list[tuple[int, ...]]:
    """The numbers of the photos left out, each way once: the usual one first, whatever the order of the
    records.
    """
    ways = dict.fromkeys(tuple(r["left_out"]) for r in records if "left_out" in r)
    return sorted(ways, key=lambda numbers: numbers != USUAL_LEFT_OUT)


def protocol(record: Mapping, left_out: Sequence[int]) -> dict:
    """The captures of which these photos were left out, with the numbers published for them under the kind
    ``capture``.
    """
    return {**record, "left_out": tuple(left_out),
            "records": [r for r in record["records"] if r.get("left_out") == list(left_out)],
            "published": {"capture": record["published"].get(capture_kind(left_out), {})}}


def usual(record: Mapping) -> dict:
    """Materials, and captures without the usual photos, else of the first way to leave some out: for a page
    that shows one.
    """
    materials, *captures = protocols(record)
    if not captures:
        return {**materials, "left_out": USUAL_LEFT_OUT}
    return {**captures[0], "records": [r for r in record["records"] if r.get("left_out",
                                                                             [*captures[0]["left_out"]])
                                       == [*captures[0]["left_out"]]],
            "published": {**record["published"], **captures[0]["published"]}}


def names(fits: Iterable[Mapping]) -> list[str]:
    """Materials or captures, each once, in the order of these fits: :func:`of` sorts those of the suite
    ``methods``.
    """
    return list(dict.fromkeys(r["name"] for r in fits))


def budgets(fits: Iterable[Mapping]) -> list[float]:
    """Budgets, the shortest first."""
    return sorted({r["budget"] for r in fits})


def longest(fits: Sequence[Mapping]) -> float:
    """The longest budget that every method had; of all budgets where there is none such, 0 without fits."""
    each = [{r["budget"] for r in fits if r["method"] == method} for method in {r["method"] for r in fits}]
    return max(set.intersection(*each) or set.union(*each)) if each else 0


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
        points = [_point(budget, error, [each for each in seeds.values() if set(each) == wanted])
                  for budget, seeds in sorted(by_budget.items())]
        found[method] = [point for point in points if point]
    return {method: points for method, points in found.items() if points}


def _point(budget: float, error: str, seeds: list[dict[str, Mapping]]) -> Point | None:
    if not seeds:
        return None
    errors = spread([statistics.fmean(r["errors"][error] for r in each.values()) for each in seeds])
    seconds, wall = (statistics.median(statistics.fmean(r[clock] for r in each.values()) for each in seeds)
                     for clock in ("seconds", "wall"))
    scenes = spread([statistics.median(each[name]["errors"][error] for each in seeds) for name in seeds[0]])
    ended = all(r["stopped"] in BY_ITSELF for each in seeds for r in each.values())
    return Point(budget, seconds, wall, errors["median"], errors["low"], errors["high"], len(seeds),
                 (scenes["low"], scenes["high"]), len(seeds[0]), ended)


def absent(fits: Iterable[Mapping], method: str, budget: float, error: str, only: Sequence[str]
           | None = None) -> str:
    """Why :func:`curves` has no point of a method at a budget, in a few words."""
    fits = list(fits)
    wanted = set(names(fits) if only is None else only)
    here = [r for r in fits if r["method"] == method and r["budget"] == budget and r["name"] in wanted]
    failed = {r["name"]: r["why"] for r in here if r["stopped"] == "failed"}
    if not here:
        return "not run"
    if failed:
        why = " ".join(str(next(iter(failed.values()))).split()).replace("|", "/")
        return f"fails: {why}" if len(wanted) == 1 else f"fails on {len(failed)} of {len(wanted)}"
    done = {r["name"] for r in here if error in r["errors"]}
    return f"only {len(done)} of {len(wanted)}" if done else "not measured"


def cold_starts(record: Mapping) -> dict[str, float]:
    """Method -> seconds that a new process takes beside its loop with an empty kernel cache, by the suite
    ``start``.

    Kernels are compiled within the loop too: of its seconds, those that its iterations take with a full cache
    do not count.
    """
    found: dict[str, list[float]] = {}
    for r in (r for r in record["records"] if r["suite"] == "start"):
        empty, full = ({part: row[part]["median"] for part in ("wall", "loop", "iterations")}
                       for cache in ("empty", "full") for row in r["rows"] if row["cache"] == cache)
        loop = full["loop"] * empty["iterations"] / max(full["iterations"], 1)
        found.setdefault(r["method"], []).append(empty["wall"] - min(loop, empty["loop"]))
    return {method: statistics.median(each) for method, each in found.items()}


def wall_seconds(point: Point, cold: float | None) -> float:
    """Seconds of a fit from start to end: of a new process, where ``cold`` of :func:`cold_starts` is known,
    else a warm one.
    """
    return point.wall if cold is None else point.seconds + cold


def first_below(points: Sequence[Point], target: float) -> Point | None:
    """The shortest budget whose median error is below a target; schedules follow budgets, so nothing is known
    in between.
    """
    return next((point for point in points if point.median < target), None)


def published_mean(published: Published, kind: str, wanted: Sequence[str], error: str) -> dict[str, float]:
    """Whose -> the mean of their published errors, where all of these materials or captures have one."""
    entries = [published.get(kind, {}).get(name, {}) for name in wanted]
    whose = [who for who in (entries[0] if entries else {}) if all(error in each.get(who, {})
                                                                   for each in entries)]
    return {who: statistics.fmean(each[who][error] for each in entries) for who in whose}


def atomic_write(published: Published, kind: str) -> list[str]:
    """Whose published errors fits are held against: MaterialGAN's, and those of methods that did not see what
    is left out.
    """
    whose = dict.fromkeys(who for each in published.get(kind, {}).values() for who in each)
    return [who for who in whose if who == "MaterialGAN" or who.endswith(BLIND)]


def comparable(published: Published, kind: str, error: str) -> list[str]:
    """Those of :func:`atomic_write` that did not see what is predicted: the others' errors of photos left out are
    no measure.
    """
    return [who for who in atomic_write(published, kind) if error != "left_out" or who.endswith(BLIND)]


def with_published(published: Published, kind: str, wanted: Sequence[str], who: str, error: str) -> list[str]:
    """The materials or captures for which somebody published this error."""
    return [name for name in wanted if error in published.get(kind, {}).get(name, {}).get(who, {})]


def differences(fits: Sequence[Mapping], error: str) -> dict[str, dict[float, dict[str, float]]]:
    """Variant -> budget -> spread of its error less that of the whole method, each pair of one material and
    one seed.
    """
    whole = {(r["budget"], r["name"], r["seed"]): r["errors"][error] for r in fits
             if r["method"] == FULL and error in r["errors"]}
    pairs: dict[str, dict[float, list[float]]] = {}
    for r in fits:
        key = r["budget"], r["name"], r["seed"]
        if r["method"] != FULL and error in r["errors"] and key in whole:
            pairs.setdefault(r["method"], {}).setdefault(r["budget"],
                                                         []).append(r["errors"][error] - whole[key])
    return {method: {budget: spread(each) for budget, each in sorted(found.items())}
            for method, found in pairs.items()}


def failures(records: Iterable[Mapping]) -> list[Mapping]:
    """Fits that could not be done."""
    return [r for r in records if r["suite"] in FIT_SUITES and r["stopped"] == "failed"]
