"""The pictures of fits of a benchmark: error against run time, as SVG. They show numbers of the record's
summary.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import accumulate

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from ..report.colours import CHART_AXIS, CHART_FAINT, CHART_GRID, CHART_LINES, CHART_QUIET, CHART_TEXT
from . import summary
from .published import BLIND
from .tables import unfair

WIDTH = 8.3  # inches, 800 pixels on a screen
FONT_SIZES = {"title": 10, "label": 8.5, "tick": 8, "small": 7}
MARKS = "Dsx^v"  # of published errors


def methods_figure(record: Mapping, wall: bool = False) -> Figure | None:
    """Error against seconds for all materials and all captures together, two errors of each; None without
    fits.

    Args:
        record: the benchmark.
        wall: seconds from the start of a process to its end, as far as they were measured, instead of the
            loop's own.
    """
    parts = [(kind, fits, protocol) for protocol in summary.for_readers(record) for kind in summary.ERRORS
             if (fits := summary.of(protocol["records"], "methods", kind))]
    if not parts:
        return None
    cold = summary.cold_starts(record)
    drawing = Figure(figsize=(WIDTH, 3.1 * len(parts) + 0.3))
    height = drawing.get_figheight()
    panels = drawing.subplots(len(parts), 2, squeeze=False)
    drawing.subplots_adjust(left=0.06, right=0.81, wspace=0.98, hspace=0.42, top=1 - 0.5 / height,
                            bottom=0.45 / height)
    shades = colours([fit for _, fits, _ in parts for fit in fits])
    for row, (kind, fits, protocol) in zip(panels, parts):
        for panel, (error, title) in zip(row, summary.ERRORS[kind].items()):
            found = {name: _once(points) for name, points in summary.curves(fits, error).items()}
            clock = {name: [summary.wall_seconds(p, cold.get(name)) if wall else p.seconds for p in points]
                     for name, points in found.items()}
            lines = summary.published_mean(protocol["published"], kind, summary.names(fits), error)
            named = {name: f"{name} (warm)" if wall and cold and name not in cold else name for name in found}
            published = {_whose(who, error): value for who, value in lines.items()}
            _curves(panel, summary.budgets(fits), found, clock, shades, published, named)
            panel.set_xlabel(("seconds, start and compilation included" if cold else "seconds of a fit in a "
                                                                                     "warm process")
                             if wall else "seconds of the loop", fontsize=FONT_SIZES["small"], labelpad=1)
            headed(panel, title, f"RMSE, {names_of(kind, fits)}")
    return drawing


def _once(points: Sequence[summary.Point]) -> list[summary.Point]:
    """The points, of budgets with which fits ended by themselves only the longest one: the others say the
    same again.
    """
    return [p for p in points if not p.ended or p is points[-1]]


def _whose(who: str, error: str) -> str:
    """A published line's name, short, and how it came about."""
    name = who.removesuffix(BLIND)
    return (f"{name} (blind)" if name != who else f"{who} (saw them)" if error == "left_out"
            else f"{who} (published)")


def each_figure(protocol: Mapping, kind: str) -> Figure | None:
    """Errors of each material or capture at the longest budget of all methods, a row for each; None where
    fewer than two.
    """
    fits = summary.of(protocol["records"], "methods", kind)
    names, longest, published = summary.names(fits), summary.longest(fits), protocol["published"].get(kind,
                                                                                                      {})
    if len(names) < 2:
        return None
    drawing = Figure(figsize=(WIDTH, 0.22 * len(names) + 1.5))
    height, shades, keys = drawing.get_figheight(), colours(fits), dict[str, Line2D]()
    panels = drawing.subplots(1, 2, sharey=True)
    drawing.subplots_adjust(left=0.185, right=0.985, wspace=0.07, top=1 - 1.1 / height, bottom=0.3 / height)
    for panel, (error, title) in zip(panels, summary.ERRORS[kind].items()):
        for row, name in enumerate(names):
            panel.axhline(row, color=CHART_GRID, linewidth=0.7, zorder=1)
            found = summary.curves(fits, error, [name])
            for method in reversed(shades):  # the default on top
                for point in (p for p in found.get(method, []) if p.budget == longest):
                    panel.plot([point.low, point.high], [row] * 2, color=shades[method], linewidth=1.2,
                               zorder=3)
                    keys[method], = panel.plot(point.median, row, "o", color=shades[method], markersize=5,
                                               zorder=4)
            for who, errors in published.get(name, {}).items():
                if error in errors:
                    whose = _whose(who, error)
                    mark = (keys[whose].get_marker() if whose in keys
                            else MARKS[len(keys.keys() - shades.keys()) % len(MARKS)])
                    keys[whose], = panel.plot(errors[error], row, mark, color=CHART_FAINT if unfair(who,
                                                                                                    error) else CHART_TEXT,
                                              markersize=4.5, fillstyle="none", zorder=5)
        panel.set(xscale="log", ylim=(len(names) - 0.4, -0.6), yticks=range(len(names)), yticklabels=names)
        plain(panel)
        panel.tick_params(axis="y", length=0)
        headed(panel, title, f"RMSE, {longest:g} s")
    shown = {name: keys[name] for name in (*shades, *keys) if name in keys}
    drawing.legend(shown.values(), shown, loc="upper left", ncols=5, fontsize=FONT_SIZES["tick"],
                   frameon=False,
                   bbox_to_anchor=(0.005, 1 - 0.06 / height), handlelength=1.0, columnspacing=1.4,
                   borderaxespad=0)
    return drawing


def colours(fits: Sequence[Mapping]) -> dict[str, str]:
    """Method -> its colour, in the order of the records."""
    methods = dict.fromkeys(r["method"] for r in fits)
    return {name: CHART_LINES[i % len(CHART_LINES)] for i, name in enumerate(methods)}


def names_of(kind: str, fits: Sequence[Mapping]) -> str:
    """How many materials or captures, and what the band is of."""
    count, seeds = len(summary.names(fits)), len({r["seed"] for r in fits})
    left_out = f" without {' and '.join(map(str, fits[0]['left_out']))}" if fits[0].get("left_out") else ""
    shown = ("mean, band: quartiles" if count > 1 else f"quartiles of {seeds} seeds" if seeds > 1
             else "one seed")
    return f"{count} {summary.KINDS[kind]}{'s' * (count > 1)}{left_out}; {shown}"


def _curves(panel: Axes, budgets: Sequence[float], found: Mapping[str, Sequence[summary.Point]],
            clock: Mapping[str, Sequence[float]], shades: Mapping[str, str], published: Mapping[str, float],
            named: Mapping[str, str]) -> None:
    """Lines of medians, the default's with a band; dashed lines of what was published; names at their
    ends.
    """
    taken = [seconds for each in clock.values() for seconds in each]
    right, ends = max([1.0, *taken, *budgets]) * 1.12, []
    for number, (name, points) in enumerate(reversed(list(found.items()))):  # the default method on top
        x, y = clock[name], [p.median for p in points]
        low, high = ([p.scenes[0] for p in points],
                     [p.scenes[1] for p in points]) if points[0].count > 1 else (
            [p.low for p in points], [p.high for p in points])
        if high > low and name == next(iter(found)):
            # to the right edge; and fits that end by themselves take turns in being the faster one
            on = points[-1].ended
            panel.fill_between([*accumulate(x, max), *[right] * on], low + low[-1:] * on,
                               high + high[-1:] * on, color=shades[name], alpha=0.13, linewidth=0, zorder=2)
        panel.plot(x, y, color=shades[name], linewidth=2.0, marker="o", markersize=4, zorder=3 + number,
                   solid_capstyle="round")
        if points[-1].ended:
            panel.plot([x[-1], right], [y[-1]] * 2, color=shades[name], linewidth=0.9, linestyle=(0, (1, 2)),
                       zorder=2)
        ends.append((named[name], y[-1], shades[name], "normal"))
    for who, value in published.items():
        panel.axhline(value, color=CHART_TEXT, linewidth=1.0, linestyle=(0, (5, 3)), zorder=1)
        ends.append((who, value, CHART_TEXT, "italic"))
    panel.set(xscale="log", yscale="log")
    panel.set_xlim(min([*taken, *budgets], default=1.0) / 1.25, right)
    panel.xaxis.set_major_locator(FixedLocator(budgets))
    plain(panel)
    _labels(panel, ends)


def _labels(panel: Axes, ends: Sequence[tuple[str, float, str, str]]) -> None:
    """Names beside the right edge at the height of their lines, pushed apart where they would overlap."""
    low, high = map(math.log, panel.get_ylim())
    at = sorted((((math.log(value) - low) / (high - low)), name, colour, style)
                for name, value, colour, style in ends)
    places = spaced([each[0] for each in at], 0.072)
    for (height, name, colour, style), place in zip(at, places):
        panel.annotate(name, xy=(1.0, height), xytext=(1.045, place), xycoords="axes fraction",
                       textcoords="axes fraction",
                       color=colour, fontsize=FONT_SIZES["label"], fontstyle=style, va="center",
                       annotation_clip=False,
                       arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.7, "shrinkA": 1,
                                   "shrinkB": 0})


def spaced(heights: Sequence[float], gap: float) -> list[float]:
    """Sorted heights moved as little as needed to lie at least ``gap`` apart: neighbours share their centre
    of gravity.
    """
    groups: list[list[float]] = []  # sum of (height - its rank's shift), count
    for height in heights:
        groups.append([height, 1])
        while len(groups) > 1 and groups[-2][0] / groups[-2][1] + (groups[-2][1]
                                                                   + groups[-1][1]) / 2 * gap > (
  groups[-1][0] / groups[-1][1]):
            total, count = groups.pop()
            groups[-1] = [groups[-1][0] + total, groups[-1][1] + count]
    return [total / count + (k - (count - 1) / 2) * gap for total, count in groups for k in range(int(count))]


def headed(panel: Axes, title: str, about: str) -> None:
    """Give a panel its title, and a quiet line below it."""
    panel.set_title(title, loc="left", fontsize=FONT_SIZES["title"], fontweight="bold", pad=14)
    panel.annotate(about, (0, 1), (0, 4), xycoords="axes fraction", textcoords="offset points",
                   fontsize=FONT_SIZES["small"], color=CHART_QUIET, va="bottom", annotation_clip=False)


def plain(panel: Axes) -> None:
    """Give a panel quiet axes; the numbers of logarithmic ones are written out."""
    for axis, limits, most in ((panel.xaxis, panel.get_xlim(), 60), (panel.yaxis, panel.get_ylim(), 300)):
        if axis.get_scale() == "log":
            if not isinstance(axis.get_major_locator(), FixedLocator):
                axis.set_major_locator(LogLocator(subs=(1, 2, 5) if limits[1] / limits[0] < most else (1,)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_locator(NullLocator())
            axis.grid(True, which="major", color=CHART_GRID, linewidth=0.7)
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)
    panel.spines[["left", "bottom"]].set_color(CHART_AXIS)
    panel.tick_params(labelsize=FONT_SIZES["tick"], which="both", color=CHART_AXIS, labelcolor=CHART_TEXT,
                      length=2.5)
