"""The results in a README: short tables between two markers, made from the records of a benchmark."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from pathlib import Path

from ..errors import ConfigError
from ..io import files
from ..report.page import figure
from . import summary
from .methods import method_table
from .page import markdown
from .published import BLIND, METHOD_NAMES
from .tables import Table, at_time, best_in_row, methods_of, with_median

BEGIN, END = "<!-- results: mitsvbrdf bench --readme -->", "<!-- /results -->"
MAPS = ("diffuse", "specular", "roughness", "normal")
SIDE, VIEWS = 256, 4  # of the renderers' case


def around_results(path: Path) -> tuple[str, str]:
    """What stands before the first marker of a Markdown file, and after the second.

    Raises:
        ConfigError: no such file, or one without the two markers in their order.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as reason:
        raise ConfigError("a Markdown file for the results", f"{path}: {reason}", "check --readme") from None
    before, begun, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not begun or not ended:
        raise ConfigError(f"{BEGIN} and {END} around the results", f"{path} without them",
                          "put both into the file")
    return before, after


def write_readme(path: Path, record: Mapping) -> Path:
    """Put the results between the markers of a Markdown file.

    Args:
        path: of the file.
        record: a :class:`mitsvbrdf.bench.records.Benchmark`.

    Raises:
        ConfigError: no such file, or one without the two markers in their order.
        OutputError: the file cannot be written.
    """
    before, after = around_results(path)
    files.write_bytes(path, f"{before}{BEGIN}\n\n{results(record)}\n{END}{after}".encode())
    return Path(path)


def results(record: Mapping) -> str:
    """The tables: photos that nobody saw, known materials, renderers; each where there are records of it."""
    return "\n".join(line for table in (_photos(record), _materials(record), _renderers(record))
                     for line in markdown(table))


def _photos(record: Mapping) -> Table | None:
    """Photos left out of captures of which peers published what they made of these without having seen
    them.
    """
    default = next(iter(method_table()))
    for protocol in summary.protocols(record):
        given = protocol["published"].get("capture", {})
        whose = list(dict.fromkeys(who for each in given.values() for who in each if who.endswith(BLIND)))
        every = summary.of(protocol["records"], "methods", "capture")
        fits, longest = [r for r in every if r["method"] == default], summary.longest(every)
        names = [name for name in summary.names(fits) if any(who in given.get(name, {}) for who in whose)]
        found = [at_time(summary.curves(fits, "left_out", [name]).get(default, []), longest)
                 for name in names]
        points = [point for point in found if point]
        if not points:
            continue
        values = [[point.median if point else None,
                   *(given[name].get(who, {}).get("left_out") for who in whose)]
                  for name, point in zip(names, found)]
        lacking = [[summary.absent(fits, default, longest, "left_out", [name]),
                    *["not published"] * len(whose)]
                   for name in names]
        rows = [[f"`{name}`", *(why if value is None else f"{value:.3f}" for value, why in zip(row, reasons))]
                for name, row, reasons in zip(names, values, lacking)]
        ahead = "; ".join(filter(None,
                                 (_ahead(who.removesuffix(BLIND), [(row[0], row[1 + k]) for row in values])
                                  for k, who in enumerate(whose))))
        loop, wall = (statistics.median(getattr(point, clock) for point in points) for clock in ("seconds",
                                                                                                 "wall"))
        with_median(rows, values, 3)
        numbers = " and ".join(map(str, protocol["left_out"]))
        return Table(f"Real photos that no fit has seen: photos {numbers} predicted from the others, RMSE "
                     "in display values",
                     ["", "default", *(who.removesuffix(BLIND) for who in whose)], best_in_row(rows, values),
                     "The others learned from large data sets; figures as published, of all captures that "
                     "have them."
                     + (f" The default is lower than {ahead}." if ahead else "")
                     + f" The default's budget was {longest:g} s; its loop took {loop:.0f} s in the median, "
                       f"{wall:.0f} s with "
                     "the first guess and the uncertainty of the maps, without start-up and page.")
    return None


def _ahead(who: str, pairs: list[tuple[float | None, float | None]]) -> str:
    ratios = [ours / theirs for ours, theirs in pairs if ours is not None and theirs is not None]
    if not ratios:
        return ""
    return f"{who} on {sum(r < 1 for r in ratios)} of {len(ratios)} (median ratio {statistics.median(ratios):.2f})"


def _materials(record: Mapping) -> Table | None:
    """The maps of known materials: the default and the paper's method over all, then each beside what was
    published.
    """
    default = next(iter(method_table()))
    shown = {default: "default", "gan": "`--method gan`"}
    fits = summary.of([r for r in record["records"] if r.get("method") in shown], "methods", "material")
    names, longest, rows = summary.names(fits), summary.longest(fits), list[list[str]]()

    def own(method: str, only: list[str]) -> list[str]:
        points = {error: at_time(summary.curves(fits, error, only).get(method, []), longest)
                  for error in MAPS}
        return [f"{point.median:.3f}" if point else summary.absent(fits, method, longest, error, only)
                for error, point in points.items()]

    for method in methods_of(fits):
        rows.append([f"mean of {len(names)}, {shown[method]}", *own(method, names)])
    for name in names:
        given = record["published"].get("material", {}).get(name, {})
        theirs = [[f"`{name}`, {who} as published", *(f"{given[who][error]:.3f}" for error in MAPS)]
                  for who in METHOD_NAMES.values() if who in given]
        rows += [[f"`{name}`, default", *own(default, [name])], *theirs] if theirs else []
    note = ("Published figures are on the publishers' own photos of the same maps."
            if len(rows) > len(methods_of(fits)) else "")
    return (Table(f"Known materials: RMSE of each map, budget {longest:g} s", ["", *MAPS], rows, note)
            if rows else None)


def _renderers(record: Mapping) -> Table | None:
    """Each renderer against float64."""
    cases = [r for r in record["records"] if r["suite"] == "renderers" and r["truth"] == "texels"
             and (r["resolution"], r["views"]) == (SIDE, VIEWS)]
    rows = [[f"`{row['renderer']}`, `{case['bsdf']}`", figure(row["image"]), figure(row["gradient"])]
            for case in cases for row in case["rows"]]
    if not rows:
        return None
    return Table("Renderers against float64", ["", "image", "gradient"], rows,
                 "Mean relative error of the image, relative L2 of the gradient of the worst map; roughness "
                 "0.1 and more.")
