"""Charts by matplotlib: how they look, and how a figure becomes an SVG."""

import io
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

# Of lines on white. A bound must not be crossed.
FAINT, GRID, BOUND = "#9aa0a8", "#e3e5e8", "#b3261e"


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


def logarithmic(axes: Axes) -> None:
    """Make both axes logarithmic, with plain numbers such as 0.02 at their ticks."""
    axes.set(xscale="log", yscale="log")
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high / low < 100 else (1,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def quiet(axes: Axes, title: str) -> None:
    """Give axes a title, a faint grid and small labels."""
    axes.set_title(title, loc="left", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True, which="major", color=GRID, linewidth=0.6)
    axes.tick_params(labelsize=8, which="both", color=FAINT)
