"""Charts by matplotlib: the error of renders against seconds, and how a figure becomes an SVG."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ..io import files

# Lines on white differ in lightness, too. A bound must not be crossed.
FIRST, SECOND, FAINT, GRID, BOUND = "#c8501e", "#2a6fb0", "#9aa0a8", "#e3e5e8", "#b3261e"


def svg(drawing: Figure) -> str:
    """A figure as inline SVG text, transparent, to be marked ``|safe`` in a template."""
    text = svg_file(drawing, transparent=True).decode()
    return text[text.index("<svg"):]


def svg_file(drawing: Figure, **look: Any) -> bytes:
    """A figure as an SVG file: white ground, text as text; the same figure gives the same bytes."""
    data = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "mitsvbrdf", "svg.fonttype": "none"}):
        drawing.savefig(data, format="svg", metadata={"Date": None}, **(look or {"facecolor": "white"}))
    return data.getvalue()


def error_curve(path: str | Path, curves: Sequence[Sequence[Mapping]], target: float | None = None,
                title: str = "") -> None:
    """Write an SVG of the estimated error of renders against seconds, one line a frame, logarithmic axes.

    The target is a dashed line. A dotted line falls as the root of time through the end of the last frame's.
    A curve has points with ``seconds`` and ``error``, of which positive ones are drawn.
    """
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    axes = figure.subplots()
    lines = [[(p["seconds"], p["error"]) for p in curve if p["seconds"] > 0 and p["error"] > 0]
             for curve in curves]
    lines = [line for line in lines if line]
    label = "estimated error" if len(lines) == 1 else f"estimated error, {len(lines)} frames"
    for number, line in enumerate(lines):
        axes.plot(*zip(*line), color=FIRST, linewidth=1.4, marker="o", markersize=3,
                  label="_" * bool(number) + label, alpha=1 if len(lines) == 1 else 0.5)
    if lines:
        t, e = lines[-1][-1]  # the first frame also compiles
        ends = np.array([pick(x for line in lines for x, _ in line) for pick in (min, max)])
        axes.plot(ends, e * np.sqrt(t / ends), color=FAINT, linewidth=1, linestyle=":",
                  label="1 / \N{SQUARE ROOT}seconds")
        logarithmic(axes)  # which matplotlib refuses without a point
    if target:
        axes.axhline(target, color=SECOND, linewidth=1, linestyle="--", label=f"target {target:g}")
    axes.set_xlabel("seconds", fontsize=8)
    axes.set_ylabel("RMSE in display values", fontsize=8)
    quiet(axes, title, 9, 7)
    if lines or target:
        axes.legend(fontsize=7, frameon=False)
    files.write_bytes(Path(path), svg_file(figure))


def logarithmic(axes: Axes) -> None:
    """Make both axes logarithmic, with plain numbers such as 0.02 at their ticks."""
    axes.set(xscale="log", yscale="log")
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high / low < 100 else (1,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def quiet(axes: Axes, title: str, title_size: int, label_size: int) -> None:
    """Give axes a title, a faint grid and small labels."""
    axes.set_title(title, loc="left", fontsize=title_size)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True, which="major", color=GRID, linewidth=0.6)
    axes.tick_params(labelsize=label_size, which="both", color=FAINT)
