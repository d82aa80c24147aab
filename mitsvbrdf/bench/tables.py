"""The tables of a benchmark as text, for the terminal and for the page; they print what the record and its summary hold.

Of fits: errors at equal time, times to an equal error, each material and each map at the longest budget, ingredients taken
away. Of renderers: seconds and errors by size. Of captures: what a phone's photos come to against the truth.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from ..pages.page import figure
from . import summary
from .summary import ERRORS, Point
from .variants import FULL

PEERS = "peers-baseline"

# Of the suite capture: what a table shows, by heading, in per cent (%), as a ratio (x) or as it is.
FROM_PHONE = {"cameras": ("cameras", "%"), "rectification, px": ("rectification", ""), "flash, cm": ("flash", ""),
              "power": ("power", "x"), "maps": ("found mean", "."), "true views": ("true mean", "."), "ratio": ("ratio", "x"),
              "diffuse, scaled": ("found scaled diffuse", "."), "with true views": ("true scaled diffuse", ".")}
WITHOUT_VIEWS = {"lateral": ("fitted lateral", "."), "depth": ("fitted depth", "%"), "photos": ("found photos", "."),
                 "views given": ("given photos", "."), "ratio": ("ratio", "x"), "left out, refined": ("refined left out", "."),
                 "held": ("held left out", ".")}


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
        rows = [[_method(name, fits), *(error_cell(at_time(points, budget)) for budget in times)]
                for name, points in found.items()]
        values = [[_value(at_time(points, budget)) for budget in times] for points in found.values()]
        rows = with_best(rows, values)
        published = summary.published_mean(record["published"], kind, summary.names(fits), error)
        rows += [[f"{who}, published", *[""] * (len(times) - 1), f"{value:.4f}"] for who, value in published.items()]
        if found:
            tables.append(Table(f"{title}, {count_of(kind, fits)}", ["", *(f"{budget:g} s" for budget in times)], rows,
                                _spread_note(fits)))
    return tables


def equal_error(record: Mapping) -> list[Table]:
    """The time of the shortest fit of each method that beats the baseline's last error, and MaterialGAN's."""
    tables = []
    for kind in ERRORS:
        fits = summary.of(record["records"], "methods", kind)
        targets = list(_targets(record, kind, fits))
        if not targets:
            continue
        rows = []
        for name in dict.fromkeys(r["method"] for r in fits):
            row = [f"`{name}`"]
            for _, _, error, only, target, whose in targets:
                points = summary.curves(fits, error, only).get(name, [])
                below = summary.first_below(points, target)
                best = min((p.median for p in points), default=None)
                row.append("–" if name == whose or best is None else f"{below.seconds:.3g} s" if below
                           else f"not in {points[-1].budget:g} s (best {best:.4f})")
            rows.append(row)
        heads = ["", *(f"{head} {goal}" for head, goal, *_ in targets)]
        tables.append(Table("Seconds to a lower error, " + count_of(kind, fits), heads, rows,
                            "The shortest budget whose median is lower; schedules follow it, so nothing is known in between."))
    return tables


def _targets(record: Mapping, kind: str, fits: Sequence[Mapping]) -> Iterator[tuple]:
    """Heading, goal, error, the materials that count, value, and the method it is from."""
    for error, title in ERRORS[kind].items():
        short = title.removeprefix("Error ").removeprefix("of ").removeprefix("the ")
        final = summary.curves(fits, error).get(PEERS)
        if final:
            yield f"{short},", f"below `{PEERS}` ({final[-1].median:.4f})", error, None, final[-1].median, PEERS
        only = summary.with_published(record["published"], kind, summary.names(fits), "MaterialGAN", error)
        if only:
            value = summary.published_mean(record["published"], kind, only, error)["MaterialGAN"]
            where = "" if set(only) == set(summary.names(fits)) else f" on {', '.join(only)}"
            yield f"{short},", f"below MaterialGAN{where} ({value:.4f})", error, only, value, None


def each_one(record: Mapping, kind: str, error: str, title: str) -> Table | None:
    """The error of each material or capture at the longest budget, beside what was published for it."""
    fits = summary.of(record["records"], "methods", kind)
    names, methods = summary.names(fits), list(dict.fromkeys(r["method"] for r in fits))
    longest = max(summary.budgets(fits), default=0)
    whose = list(dict.fromkeys(who for name in names for who, e in record["published"].get(kind, {}).get(name, {}).items()
                               if error in e))
    rows, values = [], []
    for name in names:
        found = {m: at_time(points, longest) for m, points in summary.curves(fits, error, [name]).items()}
        given = record["published"].get(kind, {}).get(name, {})
        rows.append([name, *(error_cell(found.get(m), False) for m in methods),
                     *(f"{given[who][error]:.4f}" if error in given.get(who, {}) else "" for who in whose)])
        values.append([_value(found.get(m)) for m in methods] + [given.get(who, {}).get(error) for who in whose])
    if not rows:
        return None
    return Table(f"{title}, {longest:g} s, each {kind}",
                 ["", *(f"`{m}`" for m in methods), *(f"{who}, published" for who in whose)], _best_in_row(rows, values))


def each_map(record: Mapping, suite: str = "methods") -> Table | None:
    """The error of each map at the longest budget."""
    fits = summary.of(record["records"], suite, "material")
    heads = ("diffuse", "specular", "roughness", "normal", "mean", "novel_light")
    longest = max(summary.budgets(fits), default=0)
    found = {head: summary.curves(fits, head) for head in heads}
    methods = list(dict.fromkeys(r["method"] for r in fits))
    rows = [[f"`{m}`" if suite == "methods" else m,
             *(error_cell(at_time(found[head].get(m, []), longest), False) for head in heads)] for m in methods]
    values = [[_value(at_time(found[head].get(m, []), longest)) for head in heads] for m in methods]
    if not rows:
        return None
    return Table(f"RMSE of each map, {longest:g} s, {count_of('material', fits)}", ["", *heads[:-1], "new light"],
                 with_best(rows, values))


def renderer_tables(record: Mapping) -> list[Table]:
    """Seconds of a gradient step, of a picture alone, errors, and jittered pixels."""
    cases = [r for r in record["records"] if r["suite"] == "renderers"]
    texels = sorted((r for r in cases if r["truth"] == "texels"), key=lambda r: (r["bsdf"] != "roughconductor", r["resolution"],
                                                                                r["views"]))
    names = list(dict.fromkeys(row["renderer"] for r in texels for row in r["rows"]))
    heads = ["", *(f"`{name}`" for name in names)]

    def rows(cell: Callable[[Mapping], str], best: str | None) -> list[list[str]]:
        made, values = [], []
        for r in texels:
            by_name = {row["renderer"]: row for row in r["rows"]}
            made.append([f"{r['bsdf']}, {r['resolution']} px, {r['views']} view{'s' * (r['views'] > 1)}",
                         *(cell(by_name[name]) if name in by_name else "–" for name in names)])
            values.append([by_name[name][best]["median"] if best and name in by_name else None for name in names])
        return _best_in_row(made, values)

    why = sorted({f"`{s['renderer']}`, {r['resolution']} px, {r['views']} views: {s['why']}"
                  for r in texels for s in r["skipped"]})
    note = f"Left out for want of memory: {'; '.join(why)}." if why else ""
    tables = []
    if texels:
        tables += [Table("Seconds forward and backward", heads, rows(lambda row: _time(row["both"]), "both"), note),
                   Table("Seconds of a picture alone", heads, rows(lambda row: _time(row["forward"]), "forward")),
                   Table("Error of image / gradient", heads,
                         rows(lambda row: f"{figure(row['image'])} / {figure(row['gradient'])}", None),
                         "Image: mean relative error; gradient: relative L2 of the worst map; roughness 0.1 and more.")]
    for r in (r for r in cases if r["truth"] == "pixels"):
        made = [[f"`{row['renderer']}`, " + ("texel centre" if row["samples"] == 1 else f"{row['samples']} jittered rays"),
                 figure(row["image"]), figure(row["gradient"]), _time(row["forward"]), _time(row["both"])] for row in r["rows"]]
        tables.append(Table(f"Against the average over each pixel, {r['bsdf']}, {r['resolution']} px, {r['views']} views",
                            ["", "image", "gradient", "forward", "forward and backward"], made))
    return tables


def ablation_tables(record: Mapping, suite: str = "ablation") -> list[Table]:
    """The error of each variant of a method, and how much more that is than the whole method's, by budget."""
    tables = []
    for kind, error, title, fits in judged(record, suite):
        times, found = summary.budgets(fits), summary.curves(fits, error)
        change = summary.differences(fits, error)
        rows = [[name, *(_changed(at_time(points, budget), change.get(name, {}).get(budget)) for budget in times)]
                for name, points in found.items()]
        if rows:
            tables.append(Table(f"{title}, {count_of(kind, fits)}", ["", *(f"{budget:g} s" for budget in times)], rows,
                                f"Behind the error: median difference to `{FULL}` over pairs of the same "
                                f"{kind} and seed, quartiles in brackets; above 0 "
                                f"{'the ingredient helps' if suite == 'ablation' else 'it is worse'}."))
    return tables


def capture_tables(record: Mapping) -> list[Table]:
    """Captures of known materials, with and without a sheet, against the truth, and real ones without their views."""
    found = [r for r in record["records"] if r["suite"] == "capture"]
    parts = (("A phone and a sheet of tags, known materials", FROM_PHONE, [r for r in found if r["sheet"]]),
             ("A phone alone, known materials", FROM_PHONE, [r for r in found if r["kind"] == "material" and not r["sheet"]]),
             ("Real captures without views", WITHOUT_VIEWS, [r for r in found if r["kind"] == "capture"]))
    tables = []
    for title, columns, rows in parts:
        done = [r["errors"] for r in rows if r["errors"]]
        cells = [[r["name"], *(_counted(r["errors"].get(key), how) for key, how in columns.values())] for r in rows]
        if len(done) > 1:
            values = [[e[key] for e in done if key in e] for key, _ in columns.values()]
            share = "" if len(done) == len(rows) else f" of {len(done)} of {len(rows)}"
            cells.append([f"median{share}", *(_counted(statistics.median(v) if v else None, how)
                                              for v, (_, how) in zip(values, columns.values()))])
        failed = "; ".join(f"{r['name']}: {r['why']}" for r in rows if r["why"])
        if rows:
            tables.append(Table(title, ["", *columns], cells, f"Failed: {failed}." if failed else ""))
    stages: dict[str, list[float]] = {}
    for r in found:
        for stage, seconds in r["seconds"].items() if r["kind"] == "material" else ():
            stages.setdefault(stage, []).append(seconds)
    if stages:
        tables.append(Table("Seconds from a phone to maps, median", ["", "seconds"],
                            [[stage, f"{statistics.median(seconds):.3g}"] for stage, seconds in stages.items()]))
    return tables


def _counted(value: float | None, how: str) -> str:
    if value is None:
        return "–"
    return {"%": f"{100 * value:.2f} %", "x": f"{value:.3f}", ".": f"{value:.4f}", "": f"{value:.3g}"}[how]


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


def _value(point: Point | None) -> float | None:
    return None if point is None else point.median


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


def _time(spread: Mapping) -> str:
    scale, unit = (1e3, "ms") if spread["median"] < 1 else (1, "s")
    median, low, high = (f"{scale * spread[name]:.3g}" for name in ("median", "low", "high"))
    return f"{median} {unit} ({low}–{high})"


def with_best(rows: list[list[str]], values: list[list[float | None]]) -> list[list[str]]:
    """The lowest of each column in bold."""
    for column in range(len(values[0]) if values else 0):
        here = [row[column] for row in values if row[column] is not None]
        for row, value in zip(rows, values):
            if here and value[column] == min(here):  # type: ignore[type-var]
                row[column + 1] = f"**{row[column + 1]}**"
    return rows


def _best_in_row(rows: list[list[str]], values: list[list[float | None]]) -> list[list[str]]:
    """The lowest of each row in bold."""
    for row, value in zip(rows, values):
        here = [v for v in value if v is not None]
        for column, v in enumerate(value):
            if here and v == min(here):
                row[column + 1] = f"**{row[column + 1]}**"
    return rows


def _method(name: str, fits: Sequence[Mapping]) -> str:
    """The name, and when a method ends by itself."""
    ended = [r["seconds"] for r in fits if r["method"] == name and r["stopped"] == "iterations"]
    return f"`{name}`" + (f" (ends after {statistics.median(ended):.3g} s)" if ended else "")


def count_of(kind: str, fits: Sequence[Mapping]) -> str:
    """Whose error it is: the only material's or capture's, or the mean over how many."""
    names = summary.names(fits)
    return names[0] if len(names) == 1 else f"mean of {len(names)} {summary.KINDS[kind]}s"


def _spread_note(fits: Sequence[Mapping]) -> str:
    seeds = len({r["seed"] for r in fits})
    return f"Median of {seeds} seeds, quartiles in brackets." if seeds > 1 else "One seed."
