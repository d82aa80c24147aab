"""One picture: error against run time, a curve for every method, a line for every published number."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

from .table import Judged, published_means, summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot(groups: Sequence[Judged]) -> Figure:
    """A panel for each group: median error against median seconds of the loop, quartiles shaded."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6 * len(groups), 3.6), layout="constrained")
    for axes, group in zip(figure.subplots(1, len(groups), squeeze=False)[0], groups):
        found = summary(group.records, group.error)
        for method, points in found.groupby(level="method", sort=False):
            line, = axes.plot(points["seconds"], points["median"], marker="o", markersize=4, label=method)
            axes.fill_between(points["seconds"], points["low"], points["high"], color=line.get_color(),
                              alpha=0.2)
        for number, (who, error) in enumerate(published_means(group).items()):
            axes.axhline(error, color="0.4", linewidth=1, linestyle=("--", ":", "-.")[number % 3],
                         label=f"{who}, published")
        axes.set(xscale="log", yscale="log", xlabel="seconds of the loop", ylabel="RMSE")
        axes.set_title(group.title.replace(": ", ":\n", 1), fontsize=9)
        axes.legend(fontsize=7)
    return figure


def svg(figure: Figure) -> bytes:
    """The content of an SVG file: white ground, text as text, the same bytes for the same figure."""
    import matplotlib

    data = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "mitsvbrdf", "svg.fonttype": "none"}):
        figure.savefig(data, format="svg", metadata={"Date": None}, facecolor="white")
    return data.getvalue()
