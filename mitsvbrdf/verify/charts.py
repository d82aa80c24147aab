"""What the charts of errors share: a mark for each BSDF, and panels with a line that errors should stay
below.
"""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from ..pages.colours import CHART_BOUND, CHART_GRID

BSDF_MARKS = {"roughconductor": "o", "principled": "s"}


def bounded_panel(panel: Axes, title: str, bound: float) -> Line2D:
    """Give a panel its title, quiet axes and a dashed line at the largest error allowed; returns the line."""
    line = panel.axhline(bound, color=CHART_BOUND, linewidth=0.8, linestyle="--")
    panel.set_title(title, loc="left", fontsize=10)
    panel.grid(True, which="major", color=CHART_GRID, linewidth=0.6)
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(labelsize=8, which="both")
    return line
