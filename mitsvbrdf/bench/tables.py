"""The tables of a benchmark as text, for the terminal and for the page; they print what the record and its
summary hold.

Errors of fits at equal time, of each material and each map at the longest budget, by how different pictures
look, and with ingredients taken away. :mod:`~mitsvbrdf.bench.times` has the seconds to an error,
:mod:`~mitsvbrdf.bench.suite_tables` what is no fit. No cell is empty: one without a number says why.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ..batch.progress import duration
from . import summary
from .behaviour import record_draws
from .published import BLIND
from .summary import ERRORS, Point
from .variants import FULL

ENDED = "†"  # behind an error: the fits ended before their budget did

# Mean FLIP of pictures, under the name of the error that it stands beside.
LOOKS = {"material": {"flip_novel_light": "under new light", "flip_photos": "photos"},
         "capture": {"flip_left_out": "photos left out", "flip_seen": "photos seen"}}


@dataclass(frozen=True)
class Table:
    """Text cells under headings.

    Args:
        title: what it shows.
        heads: one a column.
        rows: cells; ``**`` around the best.
        note: a sentence below it.
    """

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def equal_time(record: Mapping) -> list[Table]:
    """Each error of each method at each budget, the lowest in bold."""
    tables = []
    for kind, error, title, fits in judged(record, "methods"):
        found, times = summary.curves(fits, error), summary.budgets(fits)
        methods = methods_of(fits)
        rows = [[f"`{name}`", *(cell(fits, found, name, budget, error) for budget in times)]
                for name in methods]
        rows = with_best(rows, [[value_at(found, name, budget) for budget in times] for name in methods])
        published = summary.published_mean(record["published"], kind, summary.names(fits), error)
        rows += [[as_published(who, error), *[f"{value:.4f}"] * len(times)]
                 for who, value in fair_first(published, error)]
        if found:
            tables.append(Table(f"{title}, {count_of(kind, fits)}",
                                ["", *(f"{budget:g} s" for budget in times)], rows,
                                " ".join(filter(None, (_spread_note(fits, found), _not_run_note(fits))))))
    return tables


def each_one(record: Mapping, kind: str, error: str, title: str) -> Table | None:
    """The error of each material or capture at the longest budget of all methods, beside what was published
    for it.
    """
    fits = summary.of(record["records"], "methods", kind)
    names, methods, longest = summary.names(fits), methods_of(fits), summary.longest(fits)
    published = record["published"].get(kind, {})
    given_by = {who: 0.0 for name in names for who, e in published.get(name, {}).items() if error in e}
    whose = [who for who, _ in fair_first(given_by, error)]
    rows, values = [], []
    for name in names:
        found = summary.curves(fits, error, [name])
        given = {who: each[error] for who, each in published.get(name, {}).items() if error in each}
        rows.append([name, *(cell(fits, found, m, longest, error, [name], False) for m in methods),
                     *(f"{given[who]:.4f}" if who in given else "not published" for who in whose)])
        values.append([value_at(found, m, longest) for m in methods] + [given.get(who) for who in whose])
    if not rows:
        return None
    with_median(rows, values, 4)
    fair = [[None if who in whose and unfair(who, error) else value for who, value in zip((*methods, *whose),
                                                                                          row)]
            for row in values]
    return Table(f"{title}, {longest:g} s, each {kind}",
                 ["", *(_with_seeds(fits, m, longest) for m in methods),
                  *(as_published(who, error) for who in whose)],
                 best_in_row(rows, fair))


def with_median(rows: list[list[str]], values: list[list[float | None]], digits: int) -> None:
    """Put the median of each column above several rows; of columns where all have a value."""
    if len(rows) > 1:
        columns = [[value for value in each if value is not None] for each in zip(*values)]
        values.insert(0, [statistics.median(each) if len(each) == len(rows) else None for each in columns])
        rows.insert(0, ["median", *("not of all" if value is None else f"{value:.{digits}f}"
                                    for value in values[0])])


def unfair(who: str, error: str) -> bool:
    """Whether a published error is of photos that the method saw and fits here did not."""
    return error == "left_out" and not who.endswith(BLIND)


def as_published(who: str, error: str) -> str:
    """What a row or column of published errors is called; those that are no fair comparison are marked."""
    return f"*{who}, which saw them*" if unfair(who, error) else f"{who.removesuffix(BLIND)}, published"


def fair_first(values: Mapping[str, float], error: str) -> list[tuple[str, float]]:
    """Published errors, those that are no fair comparison last."""
    return sorted(values.items(), key=lambda each: unfair(each[0], error))


def each_map(record: Mapping, suite: str = "methods") -> Table | None:
    """The error of each map at the longest budget of all methods."""
    heads = ({name: name for name in ("diffuse", "specular", "roughness", "normal", "mean")}
             | {"novel_light": "new light"})
    fits = summary.of(record["records"], suite, "material")
    return _at_the_end(fits, "material", heads, "RMSE of each map", "`" if suite == "methods" else "")


def looks(record: Mapping, kind: str) -> Table | None:
    """Mean FLIP at the longest budget of all methods."""
    fits = summary.of(record["records"], "methods", kind)
    if not any(error in r["errors"] for r in fits for error in LOOKS[kind]):
        return None
    return _at_the_end(fits, kind, LOOKS[kind], "FLIP: how different pictures look, 0 to 1", "`")


def _at_the_end(fits: Sequence[Mapping], kind: str, heads: Mapping[str, str], title: str,
                quote: str) -> Table | None:
    """Several errors of each method at the longest budget of all."""
    longest = summary.longest(fits)
    found = {error: summary.curves(fits, error) for error in heads}
    rows = [[_with_seeds(fits, m, longest, quote),
             *(cell(fits, found[error], m, longest, error, None, False) for error in heads)]
            for m in methods_of(fits)]
    values = [[value_at(found[error], m, longest) for error in heads] for m in methods_of(fits)]
    if not rows:
        return None
    return Table(f"{title}, {longest:g} s, {count_of(kind, fits)}", ["", *heads.values()],
                 with_best(rows, values))


def ablation_tables(record: Mapping, suite: str = "ablation") -> list[Table]:
    """The error of each variant of a method, and how much more that is than the whole method's, by budget."""
    tables = []
    for kind, error, title, fits in judged(record, suite):
        times, found = summary.budgets(fits), summary.curves(fits, error)
        change = summary.differences(fits, error)
        rows = [[name, *(_changed(at_time(points, budget), change.get(name, {}).get(budget))
                         for budget in times)]
                for name, points in found.items()]
        if rows:
            tables.append(Table(f"{title}, {count_of(kind, fits)}",
                                ["", *(f"{budget:g} s" for budget in times)], rows,
                                f"Behind the error: median difference to `{FULL}` over pairs of the same "
                                f"{kind} and seed, quartiles in brackets; above 0 "
                                f"{'the ingredient helps' if suite == 'ablation' else 'it is worse'}."))
    return tables


def judged(record: Mapping, suite: str) -> Iterator[tuple[str, str, str, list[Mapping]]]:
    """Kind, error, its title and the fits, for each error that the fits of a suite are judged by."""
    for kind, errors in ERRORS.items():
        fits = summary.of(record["records"], suite, kind)
        for error, title in errors.items():
            if fits:
                yield kind, error, title, fits


def at_time(points: Sequence[Point], budget: float) -> Point | None:
    """The point of one budget."""
    return next((p for p in points if p.budget == budget), None)


def value_at(found: Mapping[str, Sequence[Point]], method: str, budget: float) -> float | None:
    """The median error of a method at a budget, of :func:`mitsvbrdf.bench.summary.curves`."""
    point = at_time(found.get(method, []), budget)
    return None if point is None else point.median


def methods_of(fits: Sequence[Mapping]) -> list[str]:
    """The methods, each once, in the order of these fits."""
    return list(dict.fromkeys(r["method"] for r in fits))


def cell(fits: Sequence[Mapping], found: Mapping[str, Sequence[Point]], method: str, budget: float,
         error: str, only: Sequence[str] | None = None, spread: bool = True) -> str:
    """The error of a method at a budget, or why there is none.

    Args:
        fits: all of the table.
        found: their :func:`mitsvbrdf.bench.summary.curves`, of ``error`` and ``only``.
        method: a name.
        budget: seconds.
        error: a name.
        only: the materials or captures that count.
        spread: whether quartiles, a mark where fits ended by themselves and what :func:`_with_seeds` says
            stand behind it.
    """
    point = at_time(found.get(method, []), budget)
    if point is None:
        return summary.absent(fits, method, budget, error, only)
    seeds, text = len(_seeds(fits, method, None if spread else budget)), error_cell(point, spread)
    if point.seeds < seeds:
        text += f" ({point.seeds} of {seeds} seeds)"
    return text + (f" {ENDED}" if spread and point.ended else "")


def _with_seeds(fits: Sequence[Mapping], method: str, budget: float, quote: str = "`") -> str:
    """A method's name in a table of one budget, and how many of its seeds had that budget where not all
    had.
    """
    here, seeds = len(_seeds(fits, method, budget)), len(_seeds(fits, method))
    return f"{quote}{method}{quote}" + (f" ({here} of {seeds} seeds)" if 0 < here < seeds else "")


def _seeds(fits: Sequence[Mapping], method: str, budget: float | None = None) -> set[int]:
    """The seeds of a method, of one budget or of any."""
    return {r["seed"] for r in fits if r["method"] == method and budget in (None, r["budget"])}


def error_cell(point: Point | None, spread: bool = True) -> str:
    """The median error, with its quartiles where there are several seeds; a dash for None."""
    if point is None:
        return "–"
    between = f" ({point.low:.4f}–{point.high:.4f})" if spread and point.seeds > 1 else ""
    return f"{point.median:.4f}{between}"


def _changed(point: Point | None, change: Mapping | None) -> str:
    if point is None or change is None:
        return error_cell(point, False)
    quartiles = f" ({change['low']:+.4f} to {change['high']:+.4f})" if change["repeats"] > 1 else ""
    return f"{point.median:.4f}, {change['median']:+.4f}{quartiles}"


def with_best(rows: list[list[str]], values: list[list[float | None]]) -> list[list[str]]:
    """The lowest of each column in bold."""
    for column in range(len(values[0]) if values else 0):
        here = [row[column] for row in values if row[column] is not None]
        for row, value in zip(rows, values):
            if here and value[column] == min(here):  # type: ignore[type-var]
                row[column + 1] = f"**{row[column + 1]}**"
    return rows


def best_in_row(rows: list[list[str]], values: list[list[float | None]]) -> list[list[str]]:
    """The lowest of each row in bold."""
    for row, value in zip(rows, values):
        here = [v for v in value if v is not None]
        for column, v in enumerate(value):
            if here and v == min(here):
                row[column + 1] = f"**{row[column + 1]}**"
    return rows


def count_of(kind: str, fits: Sequence[Mapping]) -> str:
    """Whose error it is: the only material's or capture's, or the mean over how many; and the photos left
    out.
    """
    names = summary.names(fits)
    whose = names[0] if len(names) == 1 else f"mean of {len(names)} {summary.KINDS[kind]}s"
    left_out = fits[0].get("left_out", ()) if fits else ()
    return f"{whose} without photos {' and '.join(map(str, left_out))}" if left_out else whose


def _spread_note(fits: Sequence[Mapping], found: Mapping[str, Sequence[Point]]) -> str:
    counts = {name: len(_seeds(fits, name)) for name in found}
    alike = [f"`{name}`" for name in found if not any(record_draws(r) for r in fits if r["method"] == name)]
    drawn = {name: count for name, count in counts.items() if f"`{name}`" not in alike}
    of = f"of {max(counts.values())} seeds" if len(set(drawn.values())) == 1 else (
        f"over seeds ({', '.join(f'{count} of `{name}`' for name, count in drawn.items())})")
    notes = ["One seed." if max(counts.values()) == 1 else f"Median {of}, quartiles in brackets."]
    notes += [f"Without randomness: {', '.join(alike)}."] if alike and max(counts.values()) > 1 else []
    ended = [f"`{name}` after {points[-1].seconds:.3g} s" for name, points in found.items()
             if points[-1].ended]
    return " ".join([*notes, *([f"{ENDED} ended by itself: {', '.join(ended)}."] if ended else [])])


def _not_run_note(fits: Sequence[Mapping]) -> str:
    """Which budgets which methods lack, and how long one fit of each material or capture with these would
    take.
    """
    ran = {(r["method"], r["budget"]) for r in fits}
    lacking = {name: [b for b in summary.budgets(fits) if (name, b) not in ran] for name in methods_of(fits)}
    named = [f"`{name}` at {', '.join(f'{b:g}' for b in each)} s" for name, each in lacking.items() if each]
    count = len(summary.names(fits)) * sum(map(len, lacking.values()))
    seconds = len(summary.names(fits)) * sum(map(sum, lacking.values()))
    return (f"Not run, for the time it takes: {'; '.join(named)} ({count} fits, {duration(seconds)})."
            if named else "")
