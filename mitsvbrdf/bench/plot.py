"""One picture: error against run time, a curve for every method."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from ..report.charts import svg_file as svg
from .table import Judged, summary

__all__ = ["plot", "svg"]


def plot(groups: Sequence[Judged]) -> Figure:
    """A panel for each group: median error against median seconds of the loop, quartiles shaded."""
    figure = Figure(figsize=(4.6 * len(groups), 3.6), layout="constrained")
    for axes, group in zip(figure.subplots(1, len(groups), squeeze=False)[0], groups):
        found = summary(group.records, group.error)
        for method, points in found.groupby(level="method", sort=False):
            line, = axes.plot(points["seconds"], points["median"], marker="o", markersize=4, label=method)
            axes.fill_between(points["seconds"], points["low"], points["high"], color=line.get_color(),
                              alpha=0.2)
        axes.set(xscale="log", yscale="log", xlabel="seconds of the loop", ylabel="RMSE")
        axes.set_title(group.title.replace(": ", ":\n", 1), fontsize=9)
        axes.legend(fontsize=7)
    return figure
