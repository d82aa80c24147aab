"""Curves on logarithmic axes, as numbers from which a template draws an inline SVG."""

import math
from collections.abc import Mapping, Sequence

# visible on black and on white
COLOURS = ("#d1651f", "#2b7fc4", "#3a9a54", "#b453b0", "#a98417", "#6673dc", "#c9485c", "#1f9c9c")
CHART_WIDTH, CHART_HEIGHT = 460, 270
# left, top, right, bottom; ticks and their numbers are outside
FRAME = (58, 10, CHART_WIDTH - 12, CHART_HEIGHT - 38)
MOST_MARKED = 40  # up to this many points of a line, each is marked
MOST_POINTS = 1000  # of a line; of a longer trace only every k-th is shown


def curves(trace: Sequence[Mapping], names: Sequence[str]) -> dict | None:
    """The named columns of a trace (one dict a measurement) against its ``seconds``, both logarithmic.

    Points at 0 seconds, and values that are not positive or beyond 1e99, are omitted. Returns None if no
    point is left, else ``width``, ``height``, ``frame`` (left, top, right, bottom), ``x`` and ``y`` ((place,
    label) of each tick), and ``lines``: ``name``, ``colour``, ``points`` (x, y, seconds, value), ``marked``.
    """
    rows = list(trace[::max(1, math.ceil(len(trace) / MOST_POINTS))])
    rows += [trace[-1]] if trace and rows[-1] is not trace[-1] else []
    lines = {name: [(row["seconds"], row[name]) for row in rows if _drawable(row["seconds"])
                    and _drawable(row.get(name))] for name in names}
    lines = {name: points for name, points in lines.items() if points}
    if not lines:
        return None
    x = _Axis([s for points in lines.values() for s, _ in points], FRAME[0], FRAME[2])
    y = _Axis([v for points in lines.values() for _, v in points], FRAME[3], FRAME[1])
    return {"width": CHART_WIDTH, "height": CHART_HEIGHT, "frame": FRAME,
            "x": x.ticks(), "y": y.ticks(),
            "lines": [{"name": name, "colour": COLOURS[i % len(COLOURS)],
                       "marked": len(points) <= MOST_MARKED,
                       "points": [(x(s), y(v), s, v) for s, v in points]}
                      for i, (name, points) in enumerate(lines.items())]}


def error_and_losses(trace: Sequence[Mapping]) -> list[tuple[str, dict]]:
    """(title, drawing) of the error, and of the losses; a drawing without points is omitted."""
    losses = [name for name in dict.fromkeys(name for row in trace for name in row)
              if name not in ("seconds", "iteration", "stage", "rerender_rmse")]
    drawn = (("Re-rendering RMSE", curves(trace, ["rerender_rmse"])), ("Losses", curves(trace, losses)))
    return [(title, drawing) for title, drawing in drawn if drawing]


def _drawable(value: float | None) -> bool:
    return value is not None and 1e-99 < value < 1e99  # beyond, ticks would not be finite


class _Axis:
    """A logarithmic axis between two places of the picture, with a little room at both ends."""

    def __init__(self, values: Sequence[float], start: float, end: float) -> None:
        low, high = math.log10(min(values)), math.log10(max(values))
        room = max(0.04 * (high - low), 0.02)
        self.low, self.high, self.start, self.end = low - room, high + room, start, end

    def __call__(self, value: float) -> float:
        share = (math.log10(value) - self.low) / (self.high - self.low)
        return round(self.start + share * (self.end - self.start), 1)

    def ticks(self) -> list[tuple[float, str]]:
        """(place, label) of each tick: about eight powers of ten at most; if under three, finer steps."""
        from matplotlib.ticker import LogLocator, MaxNLocator

        low, high = 10**self.low, 10**self.high
        for ticks in (LogLocator(numticks=9), LogLocator(subs=(1, 2, 5)), MaxNLocator(8)):
            values = [float(value) for value in ticks.tick_values(low, high) if low <= value <= high]
            if len(values) > 2:
                break
        return [(self(value), f"{value:.6g}") for value in values]
