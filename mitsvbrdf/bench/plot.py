"""One picture: error against run time, a curve for every method."""

import io
from collections.abc import Sequence

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from .table import Judged, summary


def plot(groups: Sequence[Judged]) -> Figure:
    """A panel for each group: median error against median seconds of the loop, quartiles shaded."""
    figure = Figure(figsize=(4.6 * len(groups), 3.6), layout="constrained")
    for axes, group in zip(figure.subplots(1, len(groups), squeeze=False)[0], groups):
        for method, each in summary(group.records, group.error).groupby(level="method", sort=False):
            points = each.sort_values("seconds")
            line, = axes.plot(points["seconds"], points["median"], marker="o", markersize=4, label=method)
            axes.fill_between(points["seconds"], points["low"], points["high"], color=line.get_color(),
                              alpha=0.2)
        axes.set(xscale="log", yscale="log", xlabel="seconds of the loop", ylabel="RMSE")
        for axis in (axes.xaxis, axes.yaxis):
            low, high = axis.get_data_interval()
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)) if high > 5 * low else MaxNLocator(5))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_locator(NullLocator())
        axes.set_title(group.title.replace(": ", ":\n", 1), fontsize=9)
        if axes.lines:  # some fit of the group counts
            axes.legend(fontsize=7)
    return figure


def svg(drawing: Figure) -> bytes:
    """A figure as an SVG file: white ground, text as text; the same figure gives the same bytes."""
    data = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "mitsvbrdf", "svg.fonttype": "none"}):
        drawing.savefig(data, format="svg", metadata={"Date": None}, facecolor="white")
    return data.getvalue()
