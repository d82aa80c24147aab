"""The pictures of a benchmark: error against run time, as SVG. They show numbers of the record's summary and compute none."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from ..measure.tolerances import TOLERANCES
from ..pages.colours import CHART_AXIS, CHART_GRID, CHART_LINES, CHART_QUIET, CHART_TEXT
from . import summary

WIDTH = 8.3  # inches, 800 pixels on a screen
FONT_SIZES = {"title": 10, "label": 8.5, "tick": 8, "small": 7}
# The twin has no error to show.
RENDERER_LINES = {"mitsuba": CHART_LINES[0], "mitsuba-scene": CHART_LINES[1], "analytic": CHART_LINES[3]}
OVER_SIDES: dict = {"linestyle": "-", "marker": "o", "linewidth": 1.6, "markersize": 4}
OVER_VIEWS: dict = {"linestyle": ":", "marker": "s", "linewidth": 0.9, "markersize": 3.2}


def methods_figure(record: Mapping) -> Figure | None:
    """Error against seconds for all materials and all captures together, two errors of each; None without fits."""
    parts = [(kind, fits, view) for view in summary.views(record) for kind in summary.ERRORS
             if (fits := summary.of(view["records"], "methods", kind))]
    if not parts:
        return None
    drawing = Figure(figsize=(WIDTH, 3.1 * len(parts) + 0.3))
    height = drawing.get_figheight()
    panels = drawing.subplots(len(parts), 2, squeeze=False)
    drawing.subplots_adjust(left=0.06, right=0.805, wspace=0.88, hspace=0.42, top=1 - 0.5 / height, bottom=0.45 / height)
    for row, (kind, fits, view) in zip(panels, parts):
        for panel, (error, title) in zip(row, summary.ERRORS[kind].items()):
            found = summary.curves(fits, error)
            lines = summary.published_mean(view["published"], kind, summary.names(fits), error)
            _curves(panel, found, colours(fits), {_whose(who, error): value for who, value in lines.items()}, direct=True)
            headed(panel, title, f"RMSE, {names_of(kind, fits)}")
    return drawing


def _whose(who: str, error: str) -> str:
    """A published line's name, short, and how it came about."""
    name = who.removesuffix(" without them")
    return f"{name} (blind)" if name != who else f"{who} (saw them)" if error == "left_out" else f"{who} (published)"


def small_multiples(record: Mapping, kind: str, error: str) -> Figure | None:
    """One panel for each material or capture, all on the same axes; None where there is but one or none."""
    fits = [r for r in summary.of(record["records"], "methods", kind) if error in r["errors"]]
    each = summary.names(fits)
    if len(each) < 2:
        return None
    across, down = min(4, len(each)), math.ceil(len(each) / 4)
    drawing = Figure(figsize=(WIDTH, 1.95 * down + 0.95))
    height = drawing.get_figheight()
    panels = drawing.subplots(down, across, squeeze=False, sharex=True, sharey=True).flatten()
    drawing.subplots_adjust(left=0.055, right=0.985, wspace=0.08, hspace=0.3, top=1 - 0.82 / height, bottom=0.4 / height)
    published = []
    for number, (panel, name) in enumerate(zip(panels, each)):
        lines = {_whose(who, error): errors[error] for who, errors in record["published"].get(kind, {}).get(name, {}).items()
                 if error in errors}
        _curves(panel, summary.curves(fits, error, [name]), colours(fits), lines, direct=False)
        published.append(lines)
        panel.set_title(name, loc="left", fontsize=FONT_SIZES["label"], pad=3)
        panel.set_xlabel("seconds" if number >= len(each) - across else "", fontsize=FONT_SIZES["small"])
        panel.tick_params(labelbottom=number >= len(each) - across)
    for panel in panels[len(each):]:
        panel.set_visible(False)
    for panel, lines in zip(panels, published):  # now that the shared axes are known
        _inner_labels(panel, lines)
    handles = [Line2D([], [], color=colour, linewidth=2, label=name) for name, colour in colours(fits).items()]
    drawing.text(0.055, 1 - 0.1 / height, f"{summary.ERRORS[kind][error]}, RMSE", fontsize=FONT_SIZES["title"],
                 fontweight="bold", va="top")
    drawing.legend(handles=handles, loc="upper left", ncols=len(handles), fontsize=FONT_SIZES["tick"], frameon=False,
                   bbox_to_anchor=(0.047, 1 - 0.26 / height), handlelength=1.4, columnspacing=1.6, borderaxespad=0)
    return drawing


def renderers_figure(record: Mapping) -> Figure | None:
    """Error of image and gradient against seconds, over sizes and numbers of views, and of jittered pixels."""
    cases = [r for r in record["records"] if r["suite"] == "renderers"]
    if not cases:
        return None
    bsdfs = list(dict.fromkeys(r["bsdf"] for r in cases))
    drawing = Figure(figsize=(WIDTH, 2.6 * len(bsdfs) + 0.8))
    height = drawing.get_figheight()
    panels = drawing.subplots(len(bsdfs), 3, squeeze=False, sharex="col", sharey="col")
    drawing.subplots_adjust(left=0.07, right=0.985, wspace=0.3, hspace=0.42, top=1 - 1.05 / height, bottom=0.45 / height)
    whose = {row["renderer"] for r in cases for row in r["rows"]}
    shades = {name: colour for name, colour in RENDERER_LINES.items() if name in whose}
    tolerances = {"image": TOLERANCES["image"]["mean"], "gradient": TOLERANCES["gradients"]["relative_l2"]}
    for row, bsdf in zip(panels, bsdfs):
        texels = [r for r in cases if r["bsdf"] == bsdf and r["truth"] == "texels"]
        for panel, (error, time, title) in zip(row, (("image", "forward", "Image, forward"),
                                                     ("gradient", "both", "Gradient, forward and backward"))):
            _sweeps(panel, texels, error, time, shades)
            panel.axhline(tolerances[error], color=CHART_TEXT, linewidth=1.0, linestyle=(0, (5, 3)), zorder=1)
            panel.annotate("stated tolerance", (0.985, tolerances[error]), (0, 2), xycoords=("axes fraction", "data"),
                           textcoords="offset points", ha="right", fontsize=6.5, fontstyle="italic", color=CHART_TEXT)
            panel.set_ylim(2e-8, 1e-5)
            plain(panel)
            headed(panel, title, f"relative error, {bsdf}")
        jittered = next((r for r in cases if r["bsdf"] == bsdf and r["truth"] == "pixels"), None)
        if jittered:
            _samples(row[2], jittered, shades)
        row[2].set_visible(jittered is not None)
    for panel in panels[-1]:
        panel.set_xlabel("seconds", fontsize=FONT_SIZES["small"])
    handles = _renderer_keys(cases, shades)
    drawing.legend(handles=handles, loc="upper left", ncols=3, fontsize=FONT_SIZES["tick"], frameon=False,
                   bbox_to_anchor=(0.062, 1 - 0.08 / height), handlelength=1.8, columnspacing=1.6, borderaxespad=0)
    return drawing


def _renderer_keys(cases: Sequence[Mapping], shades: Mapping[str, str]) -> list[Line2D]:
    """What the legend explains: the renderers by colour, the sweeps by line, the ray to the centre by its mark."""
    keys = [Line2D([], [], color=colour, linewidth=2, label=name) for name, colour in shades.items()]
    sides, counts = _grown([r for r in cases if r["truth"] == "texels"])
    if sides:
        keys.append(Line2D([], [], color=CHART_QUIET, **OVER_SIDES,
                           label=f"9 views of {sides[0]['resolution']} to {sides[-1]['resolution']} px"))
    if counts:
        keys.append(Line2D([], [], color=CHART_QUIET, **OVER_VIEWS,
                           label=f"{counts[0]['views']} to {counts[-1]['views']} views of {counts[0]['resolution']} px"))
    return [*keys, Line2D([], [], color=CHART_QUIET, linestyle="none", marker="D", markersize=4.5,
                          label="one ray to the centre")]


def colours(fits: Sequence[Mapping]) -> dict[str, str]:
    """Method -> its colour, in the order of the records."""
    methods = dict.fromkeys(r["method"] for r in fits)
    return {name: CHART_LINES[i % len(CHART_LINES)] for i, name in enumerate(methods)}


def names_of(kind: str, fits: Sequence[Mapping]) -> str:
    """How many materials or captures, and what the band is of."""
    count, seeds = len(summary.names(fits)), len({r["seed"] for r in fits})
    left_out = f" without {' and '.join(map(str, fits[0]['left_out']))}" if fits[0].get("left_out") else ""
    band = f"quartiles of {'them' if count > 1 else f'{seeds} seeds'}" if max(count, seeds) > 1 else "one seed"
    return f"{count} {summary.KINDS[kind]}{'s' * (count > 1)}{left_out}; {'mean, band: ' if count > 1 else ''}{band}"


def _curves(panel: Axes, found: Mapping[str, Sequence[summary.Point]], shades: Mapping[str, str], lines: Mapping[str, float],
            direct: bool) -> None:
    """Median lines with bands, dashed published lines, and labels at their ends (``direct``)."""
    budgets = sorted({p.budget for points in found.values() for p in points})
    last = max((p.seconds for points in found.values() for p in points), default=1.0)
    right = max([last, *budgets]) * 1.12
    ends = []
    for number, (name, points) in enumerate(reversed(list(found.items()))):  # the default method on top
        x, y = [p.seconds for p in points], [p.median for p in points]
        low, high = ([p.scenes[0] for p in points], [p.scenes[1] for p in points]) if direct and points[0].count > 1 else (
            [p.low for p in points], [p.high for p in points])
        if high > low:
            panel.fill_between(x, low, high, color=shades[name], alpha=0.13, linewidth=0, zorder=2)
        panel.plot(x, y, color=shades[name], linewidth=2.0 if direct else 1.5, marker="o", markersize=4 if direct else 2.6,
                   zorder=3 + number, solid_capstyle="round")
        if points[-1].ended:
            panel.plot([x[-1], right], [y[-1]] * 2, color=shades[name], linewidth=0.9, linestyle=(0, (1, 2)), zorder=2)
        ends.append((name, y[-1], shades[name], "normal"))
    for who, value in lines.items():
        until = 1.0 if direct or len(lines) == 1 else 0.4  # several leave room for their names
        panel.axhline(value, xmax=until, color=CHART_TEXT, linewidth=1.0, linestyle=(0, (5, 3)), zorder=1)
        ends.append((who, value, CHART_TEXT, "italic"))
    panel.set(xscale="log", yscale="log")
    panel.set_xlim(min([p.seconds for points in found.values() for p in points] or [1.0]) / 1.25, right)
    panel.xaxis.set_major_locator(FixedLocator(budgets))
    panel.xaxis.set_minor_locator(NullLocator())
    plain(panel)
    if direct:
        panel.set_xlabel("seconds", fontsize=FONT_SIZES["small"], labelpad=1)
        _labels(panel, ends)


def _labels(panel: Axes, ends: Sequence[tuple[str, float, str, str]]) -> None:
    """Names beside the right edge at the height of their lines, pushed apart where they would overlap."""
    low, high = map(math.log, panel.get_ylim())
    at = sorted((((math.log(value) - low) / (high - low)), name, colour, style) for name, value, colour, style in ends)
    places = spaced([each[0] for each in at], 0.072)
    for (height, name, colour, style), place in zip(at, places):
        panel.annotate(name, xy=(1.0, height), xytext=(1.045, place), xycoords="axes fraction", textcoords="axes fraction",
                       color=colour, fontsize=FONT_SIZES["label"], fontstyle=style, va="center", annotation_clip=False,
                       arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.7, "shrinkA": 1, "shrinkB": 0})


def spaced(heights: Sequence[float], gap: float) -> list[float]:
    """Sorted heights moved as little as needed to lie at least ``gap`` apart: neighbours share their centre of gravity."""
    groups: list[list[float]] = []  # sum of (height - its rank's shift), count
    for height in heights:
        groups.append([height, 1])
        while len(groups) > 1 and groups[-2][0] / groups[-2][1] + (groups[-2][1] + groups[-1][1]) / 2 * gap > (
                groups[-1][0] / groups[-1][1]):
            total, count = groups.pop()
            groups[-1] = [groups[-1][0] + total, groups[-1][1] + count]
    return [total / count + (k - (count - 1) / 2) * gap for total, count in groups for k in range(int(count))]


def _inner_labels(panel: Axes, published: Mapping[str, float]) -> None:
    """Names of published lines: above the one line, else behind the ends of several."""
    low, high = map(math.log, panel.get_ylim())
    lines = sorted(published.items(), key=lambda line: line[1])
    places = spaced([(math.log(value) - low) / (high - low) for _, value in lines], 0.085)
    where: dict[str, Any] = {"x": 0.415, "ha": "left", "va": "center"}
    if len(lines) == 1:
        where = {"x": 0.985, "ha": "right", "va": "bottom"}
    for (who, _), place in zip(lines, places):
        panel.text(y=place, s=who, transform=panel.transAxes, fontsize=6.3, fontstyle="italic", color=CHART_TEXT, zorder=20,
                   path_effects=[withStroke(linewidth=2.2, foreground="white")], **where)


def _sweeps(panel: Axes, cases: Sequence[Mapping], error: str, time: str, shades: Mapping[str, str]) -> None:
    """One line a renderer over growing sides, one over growing numbers of views, with the quartiles of their times."""
    sides, counts = _grown(cases)
    for name, colour in shades.items():
        for sweep, style in ((counts, OVER_VIEWS), (sides, OVER_SIDES)):
            rows = [row for r in sweep for row in r["rows"] if row["renderer"] == name and row[error] > 0]
            panel.plot([row[time]["median"] for row in rows], [row[error] for row in rows], color=colour, **style)
            for row in rows:
                panel.hlines(row[error], row[time]["low"], row[time]["high"], color=colour, linewidth=4, alpha=0.3)
    panel.set(xscale="log", yscale="log")
    plain(panel)


def _grown(cases: Sequence[Mapping]) -> tuple[list[Mapping], list[Mapping]]:
    """The cases of nine views by their side, and those of one side by their number of views."""
    sizes = {r["resolution"] for r in cases if r["views"] != 9}
    return (sorted((r for r in cases if r["views"] == 9), key=lambda r: r["resolution"]),
            sorted((r for r in cases if r["resolution"] in sizes), key=lambda r: r["views"]))


def _samples(panel: Axes, case: Mapping, shades: Mapping[str, str]) -> None:
    """The traced scene with more and more jittered rays a pixel, and what one ray through each centre does."""
    jittered = [row for row in case["rows"] if row["samples"] > 1]
    panel.plot([r["forward"]["median"] for r in jittered], [r["image"] for r in jittered], color=shades.get("mitsuba-scene"),
               marker="o", markersize=4, linewidth=1.6)
    for row in jittered:
        panel.annotate(str(row["samples"]), (row["forward"]["median"], row["image"]), (5, 4), fontsize=FONT_SIZES["small"],
                       textcoords="offset points", color=shades.get("mitsuba-scene"))
    for row in case["rows"]:
        if row["samples"] == 1 and row["renderer"] in shades:
            panel.plot(row["forward"]["median"], row["image"], "D", color=shades[row["renderer"]], markersize=5, zorder=4)
    panel.set(xscale="log", yscale="log")
    panel.margins(0.12, 0.15)
    headed(panel, "Whole pixels, forward", f"{case['bsdf']}, {case['resolution']} px; number: jittered rays")
    plain(panel)


def headed(panel: Axes, title: str, about: str) -> None:
    """Give a panel its title, and a quiet line below it."""
    panel.set_title(title, loc="left", fontsize=FONT_SIZES["title"], fontweight="bold", pad=14)
    panel.text(0, 1.025, about, transform=panel.transAxes, fontsize=FONT_SIZES["small"], color=CHART_QUIET, va="bottom")


def plain(panel: Axes) -> None:
    """Give a panel quiet axes whose numbers are written out."""
    for axis, limits, most in ((panel.xaxis, panel.get_xlim(), 60), (panel.yaxis, panel.get_ylim(), 300)):
        if not isinstance(axis.get_major_locator(), FixedLocator):
            axis.set_major_locator(LogLocator(subs=(1, 2, 5) if limits[1] / limits[0] < most else (1,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    panel.grid(True, which="major", color=CHART_GRID, linewidth=0.7)
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)
    panel.spines[["left", "bottom"]].set_color(CHART_AXIS)
    panel.tick_params(labelsize=FONT_SIZES["tick"], which="both", color=CHART_AXIS, labelcolor=CHART_TEXT, length=2.5)
