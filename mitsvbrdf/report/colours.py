"""The colours of what Python draws: sheets of pictures and charts. Those of HTML are in ``base.html``."""

from __future__ import annotations

# A sheet of pictures is dark, so that the pictures are the brightest on it.
SHEET_BACK, SHEET_TEXT, SHEET_QUIET, SHEET_ACCENT = "#131519", "#eceef1", "#9198a3", "#f2b84b"

# Lines of a chart inside a page, seen on black and on white.
PAGE_LINES = ("#d1651f", "#2b7fc4", "#3a9a54", "#b453b0", "#a98417", "#6673dc", "#c9485c", "#1f9c9c")

# Charts on white: lines differ in lightness too; the first is the default method's.
CHART_LINES = ("#c8501e", "#2a6fb0", "#7fb2dd", "#1b8a5a", "#5b6270", "#8a4fa3", "#b8860b")
CHART_FAINT, CHART_GRID = "#9aa0a8", "#e3e5e8"
CHART_BOUND = "#b3261e"  # a line that must not be crossed
