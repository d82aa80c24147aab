"""The results in a README: short tables between two markers, made from the records of a benchmark."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from pathlib import Path

from ..errors import ConfigError
from ..pages.page import figure
from ..system import files
from . import summary
from .methods import method_table
from .page import markdown
from .published import METHOD_NAMES
from .tables import Table, best_in_row

BEGIN, END = "<!-- results: mitsvbrdf bench --readme -->", "<!-- /results -->"
BLIND = " without them"  # of a published method that did not see the photos left out either
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
        raise ConfigError(f"{BEGIN} and {END} around the results", f"{path} without them", "put both into the file")
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
    return "\n".join(line for table in (_photos(record), _materials(record), _renderers(record)) for line in markdown(table))


def _last(fits: list[Mapping], error: str, name: str, method: str) -> summary.Point | None:
    """A method's point at its longest budget."""
    points = summary.curves(fits, error, [name]).get(method)
    return points[-1] if points else None


def _photos(record: Mapping) -> Table | None:
    """Photos left out of captures of which peers published what they made of these without having seen them."""
    default = next(iter(method_table()))
    for view in summary.views(record):
        given = view["published"].get("capture", {})
        whose = list(dict.fromkeys(who for each in given.values() for who in each if who.endswith(BLIND)))
        fits = summary.of(view["records"], "methods", "capture")
        found = {name: _last(fits, "left_out", name, default) for name in sorted(given) if any(w in given[name] for w in whose)}
        points = {name: point for name, point in found.items() if point}
        if not whose or not points:
            continue
        values = [[point.median, *(given[name].get(who, {}).get("left_out") for who in whose)]
                  for name, point in points.items()]
        rows = [[f"`{name}`", *("not published" if value is None else f"{value:.3f}" for value in row)]
                for name, row in zip(points, values)]
        ahead = "; ".join(_ahead(who.removesuffix(BLIND), [(row[0], row[1 + k]) for row in values])
                          for k, who in enumerate(whose))
        loop, wall = (statistics.median(getattr(point, clock) for point in points.values()) for clock in ("seconds", "wall"))
        numbers = " and ".join(map(str, view["left_out"]))
        return Table(f"Real photos that no fit has seen: photos {numbers} predicted from the others, RMSE in display values",
                     ["", "default", *(who.removesuffix(BLIND) for who in whose)], best_in_row(rows, values),
                     f"The others learned from large data sets; figures as published. The default is lower than {ahead}. A fit "
                     f"took {loop:.0f} s in the median, {wall:.0f} s with all that comes before and after it.")
    return None


def _ahead(who: str, pairs: list[tuple[float | None, float | None]]) -> str:
    ratios = [ours / theirs for ours, theirs in pairs if ours is not None and theirs is not None]
    return f"{who} on {sum(r < 1 for r in ratios)} of {len(ratios)} (median ratio {statistics.median(ratios):.2f})"


def _materials(record: Mapping) -> Table | None:
    """The maps of known materials: the default and the paper's method over all, then each beside what was published."""
    default = next(iter(method_table()))
    fits = summary.of(record["records"], "methods", "material")
    names, rows = summary.names(fits), list[list[str]]()
    for method, title in ((default, "default"), ("gan", "`--method gan`")):
        means = [summary.curves(fits, error).get(method) for error in MAPS]
        if names and all(means):
            rows.append([f"mean of {len(names)}, {title}", *(f"{points[-1].median:.3f}" for points in means if points)])
    for name in names:
        given = record["published"].get("material", {}).get(name, {})
        own = [_last(fits, error, name, default) for error in MAPS]
        if given and all(own):
            rows.append([f"`{name}`, default", *(f"{point.median:.3f}" for point in own if point)])
            rows += [[f"`{name}`, {who} as published", *(f"{given[who][error]:.3f}" for error in MAPS)]
                     for who in METHOD_NAMES.values() if who in given]
    return Table("Known materials: RMSE of each map", ["", *MAPS], rows) if rows else None


def _renderers(record: Mapping) -> Table | None:
    """Each renderer against float64."""
    cases = [r for r in record["records"] if r["suite"] == "renderers" and r["truth"] == "texels"
             and (r["resolution"], r["views"]) == (SIDE, VIEWS)]
    rows = [[f"`{row['renderer']}`, `{case['bsdf']}`", figure(row["image"]), figure(row["gradient"])]
            for case in cases for row in case["rows"]]
    if not rows:
        return None
    return Table("Renderers against float64", ["", "image", "gradient"], rows,
                 "Mean relative error of the image, relative L2 of the gradient of the worst map; roughness 0.1 and more.")
