"""The picture of docs/stability-fits.md: what is reached, and how soon, against the condition of the texels'
Jacobians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from ...report.colours import CHART_AXIS, CHART_LINES, CHART_QUIET, CHART_TEXT
from ..plots import FONT_SIZES, headed, plain
from .scenes import SERIES
from .tables import fits_of

LOOKS = dict(zip(SERIES, zip(CHART_LINES, ("o", "s", "D"))))  # colour and mark of each series


def convergence_figure(record: Mapping) -> Figure | None:
    """A column for each method: error of the maps, and seconds to within a tenth of the photos' final error;
    None without fits.

    Scenes whose photos leave a number of a texel open, condition infinite, stand apart at the right. A fit
    whose start is that near its end already has no time to show.
    """
    columns = {head: [r for r in fits if r["why"] is None] for head, fits in fits_of(record,
                                                                                     "series").items()}
    columns = {head: fits for head, fits in columns.items() if fits}
    if not columns:
        return None
    known = [r["condition"]["median"] for fits in columns.values() for r in fits
             if r["condition"]["median"] is not None]
    edge = 3 * max(known, default=1.0)
    drawing = Figure(figsize=(2.55 * len(columns) + 0.6, 5.6))
    panels = drawing.subplots(2, len(columns), squeeze=False, sharex=True, sharey="row")
    drawing.subplots_adjust(left=0.62 / drawing.get_figwidth(), right=0.985, wspace=0.1, hspace=0.22,
                            top=0.91, bottom=0.165)
    for (error, time), (head, fits) in zip(panels.T, columns.items()):
        _points(error, fits, [r["errors"]["mean"] for r in fits], edge)
        _points(error, fits, [r["attainable"]["mean"] for r in fits], edge, attainable=True)
        _points(time, fits, [r["near"]["seconds"] or math.nan for r in fits], edge)
        for panel in (error, time):
            panel.set(xscale="log", yscale="log")
            panel.set_xlim(min(known, default=1.0) / 2, edge * 6)
            # every second decade: few, short words
            panel.xaxis.set_major_locator(FixedLocator([100.0**k for k in range(8)]))
        headed(error, head, "")
        time.set_xlabel("condition, median texel", fontsize=FONT_SIZES["small"], color=CHART_TEXT)
    for panel in panels.flatten():
        plain(panel)
        panel.minorticks_off()
        panel.axvline(edge, color=CHART_AXIS, linewidth=0.8, linestyle=(0, (2, 2)))
        panel.text(edge * 2.3, 0.015, "∞", transform=panel.get_xaxis_transform(),
                   fontsize=FONT_SIZES["label"], color=CHART_QUIET, ha="center", va="bottom")
    panels[0, 0].set_ylabel("RMSE of the maps", fontsize=FONT_SIZES["label"], color=CHART_TEXT)
    panels[1, 0].set_ylabel("s to within 10 % of the end", fontsize=FONT_SIZES["label"], color=CHART_TEXT)
    handles = [Line2D([], [], color=colour, marker=mark, markersize=4.5, linewidth=1.4, label=series)
               for series, (colour, mark) in LOOKS.items()]
    handles.append(Line2D([], [], color=CHART_QUIET, marker="_", markersize=9, linestyle="none",
                          label="attainable, each texel by itself"))
    drawing.legend(handles=handles, loc="lower center", ncols=4, fontsize=FONT_SIZES["label"], frameon=False)
    return drawing


def _points(panel: Axes, fits: Sequence[Mapping], values: Sequence[float], edge: float,
            attainable: bool = False) -> None:
    """One line a series in the order of its members; those of infinite condition side by side behind the
    edge.
    """
    for series, (colour, mark) in LOOKS.items():
        here = [(r["condition"]["median"], value) for r, value in zip(fits, values)
                if r["name"].startswith(f"{series}: ")]
        open_ones = iter((1.4, 2.0, 2.8, 3.9, 5.2))
        x = [edge * next(open_ones) if condition is None else condition for condition, _ in here]
        y = [value for _, value in here]
        if attainable:
            panel.plot(x, y, color=CHART_QUIET, marker="_", markersize=9, linestyle="none", zorder=2)
        else:
            panel.plot(x, y, color=colour, marker=mark, markersize=4.5, linewidth=1.4, zorder=3)
