"""How the errors fall along the paper's schedule, as SVG. It shows numbers of the record and computes
none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from matplotlib.figure import Figure

from ...report.charts import PlainNumbers
from ...report.colours import CHART_GRID, CHART_LINES, CHART_TEXT
from ..plots import FONT_SIZES
from .tables import SCHEDULE_ERRORS, schedule_title, schedules

ACROSS = 2  # panels in a row


def schedule_figure(record: Mapping) -> Figure | None:
    """The error of each map, or of photos, against the iteration, one panel a run; None without runs."""
    runs = [(run, errors) for kind, errors in SCHEDULE_ERRORS.items() for run in schedules(record, kind)]
    if not runs:
        return None
    down, across = math.ceil(len(runs) / ACROSS), min(ACROSS, len(runs))
    drawing = Figure(figsize=(10, 3.1 * down), layout="constrained")
    panels = drawing.subplots(down, across, squeeze=False, sharey=True).flatten()
    for panel, (run, errors) in zip(panels, runs):
        for (name, label), colour in zip(errors.items(), CHART_LINES):
            points = [(entry["iteration"], entry[name]) for entry in run["trace"] if name in entry]
            panel.plot([x for x, _ in points], [y for _, y in points], color=colour, linewidth=1.4,
                       label=label)
        panel.set_title(schedule_title(run).replace("`", ""), loc="left", fontsize=FONT_SIZES["label"])
        panel.set_xlabel("iteration", fontsize=FONT_SIZES["small"])
        panel.set_yscale("log")
        for formatter in (panel.yaxis.set_major_formatter, panel.yaxis.set_minor_formatter):
            formatter(PlainNumbers())
        panel.grid(True, which="major", color=CHART_GRID, linewidth=0.7)
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(labelsize=FONT_SIZES["tick"], which="both", labelcolor=CHART_TEXT)
        panel.legend(fontsize=FONT_SIZES["tick"], frameon=False)
    for panel in panels[len(runs):]:
        panel.set_visible(False)
    panels[0].set_ylabel("RMSE", fontsize=FONT_SIZES["small"])
    return drawing
