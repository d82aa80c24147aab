"""Charts by matplotlib: the losses of a fit, the error of renders, and how a figure becomes an SVG."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from ..io import files
from .colours import CHART_FAINT, CHART_GRID, CHART_LINES
from .curves import losses_of

# of one width; GitHub shows an SVG without fonts from elsewhere
SVG_FONTS = ["DejaVu Sans", "Verdana", "sans-serif"]
SVG_PLACES = re.compile(r' (?:d|x|y|transform)="[^"]*"')
LONG_NUMBER = re.compile(r"-?\d+\.\d{3,}(?:e-\d+)?")


class PlainNumbers(LogFormatter):
    """Numbers as 0.02, at the ticks that matplotlib would label."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The tick at x; empty where matplotlib labels none."""
        return f"{x:g}" if super().__call__(x, pos) else ""


def svg(drawing: Figure) -> str:
    """A figure as inline SVG text, transparent, to be marked ``|safe`` in a template."""
    text = _svg_text(drawing, transparent=True)
    return text[text.index("<svg"):]


def svg_file(drawing: Figure) -> bytes:
    """A figure as an SVG file: white ground, text as text; the same figure gives the same bytes."""
    return _svg_text(drawing, facecolor="white").encode()


def _svg_text(drawing: Figure, **look: Any) -> str:
    """SVG whose places and paths have two decimals: hundredths of a pixel."""
    data = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "mitsvbrdf", "svg.fonttype": "none",
                                "font.sans-serif": SVG_FONTS}):
        drawing.savefig(data, format="svg", metadata={"Date": None}, **look)
    return SVG_PLACES.sub(lambda places: LONG_NUMBER.sub(lambda number: f"{float(number[0]):.2f}", places[0]),
                          data.getvalue().decode())


def loss_curve(path: str | Path, trace: Sequence[Mapping]) -> None:
    """Write an SVG of the re-rendering error, and below it of each loss, against seconds.

    All axes are logarithmic. Points at 0 seconds and values that are not positive are not drawn.

    Args:
        path: the SVG to write or replace.
        trace: one dict a measurement: ``seconds``, ``rerender_rmse``, and each loss under its name.

    Raises:
        OutputError: the file cannot be written.
    """
    losses = losses_of(trace)
    figure = Figure(figsize=(6.4, 4.6 if losses else 2.8), layout="constrained")
    panels = figure.subplots(2 if losses else 1, 1, sharex=True, squeeze=False)[:, 0]
    names = [["rerender_rmse"], losses]
    for panel, title, shown in zip(panels, ("Re-rendering RMSE", "Losses"), names):
        for number, name in enumerate(shown):
            points = [(row["seconds"], row[name]) for row in trace
                      if row["seconds"] > 0 and row.get(name, 0) > 0]
            _line(panel, points, CHART_LINES[number % len(CHART_LINES)], name)
        quiet(panel, title, 9, 7)
    if losses:
        panels[1].legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    panels[-1].set_xlabel("seconds", fontsize=8)
    files.write_bytes(Path(path), svg_file(figure))


def error_curve(path: str | Path, curves: Sequence[Sequence[Mapping]], target: float | None = None,
                title: str = "") -> None:
    """Write an SVG of the estimated error of renders against seconds, one line a frame, logarithmic axes.

    The target is a dashed line. A dotted line falls as the root of time through the end of the last frame's.

    Args:
        path: the SVG to write or replace.
        curves: of each frame, points with ``seconds`` and ``error``; only positive ones are drawn.
        target: the error asked for.
        title: the heading.

    Raises:
        OutputError: the file cannot be written.
    """
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    axes = figure.subplots()
    lines = [[(p["seconds"], p["error"]) for p in curve if p["seconds"] > 0 and p["error"] > 0]
             for curve in curves]
    lines = [line for line in lines if line]
    label = "estimated error" if len(lines) == 1 else f"estimated error, {len(lines)} frames"
    for number, line in enumerate(lines):
        _line(axes, line, CHART_LINES[0], "_" * bool(number) + label, marker="o", markersize=3,
              alpha=1 if len(lines) == 1 else 0.5)
    if lines:
        t, e = lines[-1][-1]  # the first frame also compiles
        ends = np.array([pick(x for line in lines for x, _ in line) for pick in (min, max)])
        axes.plot(ends, e * np.sqrt(t / ends), color=CHART_FAINT, linewidth=1, linestyle=":",
                  label="1 / \N{SQUARE ROOT}seconds")
    if target:
        axes.axhline(target, color=CHART_LINES[1], linewidth=1, linestyle="--", label=f"target {target:g}")
    axes.set_xlabel("seconds", fontsize=8)
    axes.set_ylabel("RMSE in display values", fontsize=8)
    quiet(axes, title, 9, 7)
    if lines or target:
        axes.legend(fontsize=7, frameon=False)
    files.write_bytes(Path(path), svg_file(figure))


def _line(axes: Axes, points: Sequence[tuple[float, float]], colour: str, label: str, **how: Any) -> None:
    """Points as a line on logarithmic axes, which matplotlib refuses without a point."""
    how = {"linewidth": 1.4, "marker": "o" if len(points) == 1 else None, **how}
    axes.plot([x for x, _ in points], [y for _, y in points], color=colour, label=label, **how)
    if points:
        axes.set(xscale="log", yscale="log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(PlainNumbers())
            axis.set_minor_formatter(PlainNumbers())


def quiet(axes: Axes, title: str, title_size: int, label_size: int) -> None:
    """Give axes a title, a faint grid and small labels."""
    axes.set_title(title, loc="left", fontsize=title_size)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True, which="major", color=CHART_GRID, linewidth=0.6)
    axes.tick_params(labelsize=label_size, which="both", color=CHART_FAINT)
