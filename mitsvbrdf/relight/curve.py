"""The error of renders over time, as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ..io import files
from ..pages.canvas import PlainNumbers
from ..pages.colours import CHART_FAINT, CHART_GRID, CHART_LINES
from ..pages.page import svg_file


def error_curve(path: str | Path, curves: Sequence[Sequence[Mapping]], target: float | None = None,
                title: str = "") -> None:
    """An SVG of the estimated error against seconds, one line a frame, both axes logarithmic.

    The target is a dashed line; a dotted one falls as the root of time through the end of the last frame's.

    Args:
        path: the SVG to write or replace.
        curves: of each frame, points with ``seconds`` > 0 and ``error``; points whose error is 0 are left
            out.
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
    alone = len(lines) == 1
    label = "estimated error" if alone else f"estimated error, {len(lines)} frames"
    for number, line in enumerate(lines):
        axes.plot(*zip(*line), color=CHART_LINES[0], linewidth=1.8 if alone else 0.8,
                  alpha=1 if alone else 0.5, marker="o", markersize=3, label=None if number else label)
    if lines:
        t, e = lines[-1][-1]  # the first frame also compiles
        ends = np.array([min(x for line in lines for x, _ in line),
                         max(x for line in lines for x, _ in line)])
        axes.plot(ends, e * np.sqrt(t / ends), color=CHART_FAINT, linewidth=1, linestyle=":",
                  label="1 / \N{SQUARE ROOT}seconds")
        axes.set(xscale="log", yscale="log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(PlainNumbers())
            axis.set_minor_formatter(PlainNumbers())
    if target:
        axes.axhline(target, color=CHART_LINES[1], linewidth=1, linestyle="--", label=f"target {target:g}")
    axes.set_title(title, loc="left", fontsize=9)
    axes.set_xlabel("seconds", fontsize=8)
    axes.set_ylabel("RMSE in display values", fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True, which="major", color=CHART_GRID, linewidth=0.6)
    axes.tick_params(labelsize=7, which="both", color=CHART_FAINT)
    if lines or target:
        axes.legend(fontsize=7, frameon=False)
    files.write_bytes(Path(path), svg_file(figure))
