"""Tables of seconds: to an error, of a ladder of errors, to what was published, and by the clock on the
wall.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence

from . import summary
from .summary import ERRORS
from .tables import Table, as_published, at_time, count_of, judged, methods_of, unfair

PEERS = "peers-baseline"
STEP = math.sqrt(2)  # between two errors of a ladder
LOWEST = 1e-3  # which all ladders pass through
RUNGS = 12  # of a ladder at most, the lowest
OVERFLOWS = 1000  # steps above what any error in display values can be


def equal_error(record: Mapping) -> list[Table]:
    """The time of the shortest fit of each method that beats the baseline's last error, and MaterialGAN's."""
    tables = []
    for kind in ERRORS:
        fits = summary.of(record["records"], "methods", kind)
        targets = list(_targets(record, kind, fits))
        if not targets:
            continue
        rows, longest = [], max(summary.budgets(fits))
        for name in dict.fromkeys(r["method"] for r in fits):
            row = [f"`{name}`"]
            for _, _, error, only, target, whose in targets:
                points = summary.curves(fits, error, only).get(name, [])
                below = summary.first_below(points, target)
                best = min((p.median for p in points), default=None)
                row.append("its own error" if name == whose
                           else summary.absent(fits, name, longest, error, only) if best is None
                           else f"{below.seconds:.3g} s" if below else f"not in {points[-1].budget:g} s "
                                                                       f"(best {best:.4f})")
            rows.append(row)
        heads = ["", *(f"{head} {goal}" for head, goal, *_ in targets)]
        tables.append(Table("Seconds to pass others, " + count_of(kind, fits), heads, rows,
                            "The shortest budget whose median is lower; schedules follow it, so nothing is "
                            "known in between."))
    return tables


def _targets(record: Mapping, kind: str, fits: Sequence[Mapping]) -> Iterator[tuple]:
    """Heading, goal, error, the materials that count, value, and the method it is from."""
    for error, title in ERRORS[kind].items():
        short = title.removeprefix("Error ").removeprefix("of ").removeprefix("the ")
        final = summary.curves(fits, error).get(PEERS)
        if final:
            yield f"{short},", f"below `{PEERS}` ({final[-1].median:.4f})", error, None, final[
                -1].median, PEERS
        for who in summary.comparable(record["published"], kind, error):
            only = summary.with_published(record["published"], kind, summary.names(fits), who, error)
            if only:
                value = summary.published_mean(record["published"], kind, only, error)[who]
                where = "" if set(only) == set(summary.names(fits)) else f" on {', '.join(only)}"
                yield f"{short},", f"below {as_published(who, error)}{where} ({value:.4f})", error, only, value, None


def ladders(record: Mapping) -> list[Table]:
    """The time of each method to each of a ladder of errors, from the largest that any fit has to the
    lowest.
    """
    tables = []
    for kind, error, title, fits in judged(record, "methods"):
        found = summary.curves(fits, error)
        rungs = ladder([p.median for points in found.values() for p in points])
        longest, rows = max(summary.budgets(fits)), []
        for name in methods_of(fits):
            points = found.get(name, [])
            why = f"not in {points[-1].budget:g} s" if points else summary.absent(fits, name, longest, error)
            below = [summary.first_below(points, rung) for rung in rungs]
            rows.append([f"`{name}`", *(f"{point.seconds:.3g} s" if point else why for point in below)])
        if rungs:
            tables.append(Table(f"Seconds to an error: {title.lower()}, {count_of(kind, fits)}",
                                ["below", *(f"{rung:.2g}" for rung in rungs)], rows,
                                "The loop's seconds with the shortest budget whose median is below."))
    return tables


def ladder(errors: list[float]) -> list[float]:
    """Errors a factor of :data:`STEP` apart, the largest first, down to just above the lowest; :data:`RUNGS`
    at most.
    """
    if not errors or min(errors) <= 0:
        return []
    top, bottom = (math.floor((math.log(value) - math.log(LOWEST)) / math.log(STEP))
                   for value in (max(errors), min(errors)))
    return [LOWEST * STEP**k for k in range(min(top, bottom + RUNGS), bottom, -1) if k < OVERFLOWS]


def passing(record: Mapping, kind: str = "capture", error: str = "left_out") -> Table | None:
    """The time of the default method to pass what was published for each capture."""
    fits = summary.of(record["records"], "methods", kind)
    default, published = next((r["method"] for r in fits), ""), record["published"].get(kind, {})
    longest = max(summary.budgets(fits), default=0)
    names = [name for name in summary.names(fits) if any(error in e for e in published.get(name,
                                                                                           {}).values())]
    whose = sorted(dict.fromkeys(who for name in names for who, e in published[name].items() if error in e),
                   key=lambda who: unfair(who, error))
    rows, taken = [], {who: list[float]() for who in whose}
    for name in names:
        points = summary.curves(fits, error, [name]).get(default, [])
        last, why = at_time(points, longest), summary.absent(fits, default, longest, error, [name])
        if not points:
            rows.append([name, *[why] * (len(whose) + 1)])
            continue
        row = [name, f"{last.median:.4f}" if last else why]
        for who in whose:
            target = published[name].get(who, {}).get(error)
            below = None if target is None else summary.first_below(points, target)
            taken[who] += [] if target is None else [below.seconds if below else math.inf]
            row.append("not published" if target is None else f"{below.seconds:.3g} s ({target:.4f})" if below
                       else f"not in {points[-1].budget:g} s ({target:.4f})")
        rows.append(row)
    if not rows:
        return None
    if len(rows) > 1:
        middle = {who: statistics.median(each) if each else math.inf for who, each in taken.items()}
        rows.append(["median", "of the seconds", *(
            (f"{middle[who]:.3g} s" if math.isfinite(middle[who]) else "not passed by half")
            + f" ({sum(map(math.isfinite, taken[who]))} of {len(taken[who])} passed)" for who in whose)])
    return Table(f"Seconds of `{default}` to pass what was published, photos left out",
                 ["", f"`{default}` after {longest:g} s",
                  *(f"below {as_published(who, error)}" for who in whose)], rows,
                 "Published errors in brackets. The loop's seconds with the shortest budget whose median is "
                 "lower.")


def wall_time(record: Mapping) -> list[Table]:
    """Seconds on the wall beside the loop's, by method and budget."""
    tables = []
    for kind in ERRORS:
        fits = summary.of(record["records"], "methods", kind)
        error = next(reversed(ERRORS[kind]))  # the last is one that all fits have
        found, times = summary.curves(fits, error), summary.budgets(fits)
        rows = []
        for name in methods_of(fits):
            points = [at_time(found.get(name, []), budget) for budget in times]
            rows.append([f"`{name}`", *(f"{p.wall:.3g} / {p.seconds:.3g}" if p else summary.absent(fits, name,
                                                                                                   budget, error)
                                        for p, budget in zip(points, times))])
        if rows:
            tables.append(Table(f"Seconds on the wall / of the loop, {count_of(kind, fits)}",
                                ["", *(f"{budget:g} s" for budget in times)], rows,
                                "In a process that is warm: the first guess before the loop, the "
                                "uncertainty of the maps after "
                                "it. The suite `start` has what a new process adds."))
    return tables
