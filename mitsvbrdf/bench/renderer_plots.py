"""The picture of a benchmark's renderers: error against run time, as SVG. It shows numbers of the records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..measure.tolerances import TOLERANCES
from ..report.colours import CHART_LINES, CHART_QUIET, CHART_TEXT
from .plots import FONT_SIZES, WIDTH, headed, plain

# The twin has no error to show.
RENDERER_LINES = {"mitsuba": CHART_LINES[0], "mitsuba-scene": CHART_LINES[1], "analytic": CHART_LINES[3]}
OVER_SIDES: dict = {"linestyle": "-", "marker": "o", "linewidth": 1.6, "markersize": 4}
OVER_VIEWS: dict = {"linestyle": ":", "marker": "s", "linewidth": 0.9, "markersize": 3.2}


def renderers_figure(record: Mapping) -> Figure | None:
    """Error of image and gradient against seconds, over sizes and numbers of views, and of jittered
    pixels.
    """
    cases = [r for r in record["records"] if r["suite"] == "renderers"]
    if not cases:
        return None
    bsdfs = list(dict.fromkeys(r["bsdf"] for r in cases))
    drawing = Figure(figsize=(WIDTH, 2.6 * len(bsdfs) + 0.8))
    height = drawing.get_figheight()
    panels = drawing.subplots(len(bsdfs), 3, squeeze=False, sharex="col", sharey="col")
    drawing.subplots_adjust(left=0.07, right=0.985, wspace=0.3, hspace=0.42, top=1 - 1.05 / height,
                            bottom=0.45 / height)
    whose = {row["renderer"] for r in cases for row in r["rows"]}
    shades = {name: colour for name, colour in RENDERER_LINES.items() if name in whose}
    tolerances = {"image": TOLERANCES["image"]["mean"], "gradient": TOLERANCES["gradients"]["relative_l2"]}
    for row, bsdf in zip(panels, bsdfs):
        texels = [r for r in cases if r["bsdf"] == bsdf and r["truth"] == "texels"]
        for panel, (error, time, title) in zip(row, (("image", "forward", "Image, forward"),
                                                     ("gradient", "both", "Gradient, forward and backward"))):
            _sweeps(panel, texels, error, time, shades)
            panel.axhline(tolerances[error], color=CHART_TEXT, linewidth=1.0, linestyle=(0, (5, 3)), zorder=1)
            panel.annotate("stated tolerance", (0.985, tolerances[error]), (0, 2),
                           xycoords=("axes fraction", "data"),
                           textcoords="offset points", ha="right", fontsize=6.5, fontstyle="italic",
                           color=CHART_TEXT)
            panel.set_ylim(2e-8, 1e-5)
            plain(panel)
            headed(panel, title, f"relative error, {bsdf}")
        jittered = next((r for r in cases if r["bsdf"] == bsdf and r["truth"] == "pixels"), None)
        if jittered:
            _samples(row[2], jittered, shades)
        row[2].set_visible(jittered is not None)
    for panel in panels[-1]:
        panel.set_xlabel("seconds", fontsize=FONT_SIZES["small"])
    handles = _renderer_keys(cases, shades)
    drawing.legend(handles=handles, loc="upper left", ncols=3, fontsize=FONT_SIZES["tick"], frameon=False,
                   bbox_to_anchor=(0.062, 1 - 0.08 / height), handlelength=1.8, columnspacing=1.6,
                   borderaxespad=0)
    return drawing


def _renderer_keys(cases: Sequence[Mapping], shades: Mapping[str, str]) -> list[Line2D]:
    """What the legend explains: the renderers by colour, the sweeps by line, the ray to the centre by its
    mark.
    """
    keys = [Line2D([], [], color=colour, linewidth=2, label=name) for name, colour in shades.items()]
    sides, counts = _grown([r for r in cases if r["truth"] == "texels"])
    if sides:
        keys.append(Line2D([], [], color=CHART_QUIET, **OVER_SIDES,
                           label=f"9 views of {sides[0]['resolution']} to {sides[-1]['resolution']} px"))
    if counts:
        keys.append(Line2D([], [], color=CHART_QUIET, **OVER_VIEWS,
                           label=f"{counts[0]['views']} to {counts[-1]['views']} views of "
                                 f"{counts[0]['resolution']} px"))
    return [*keys, Line2D([], [], color=CHART_QUIET, linestyle="none", marker="D", markersize=4.5,
                          label="one ray to the centre")]


def _sweeps(panel: Axes, cases: Sequence[Mapping], error: str, time: str, shades: Mapping[str, str]) -> None:
    """One line a renderer over growing sides, one over growing numbers of views, with the quartiles of their
    times.
    """
    sides, counts = _grown(cases)
    for name, colour in shades.items():
        for sweep, style in ((counts, OVER_VIEWS), (sides, OVER_SIDES)):
            rows = [row for r in sweep for row in r["rows"] if row["renderer"] == name and row[error] > 0]
            panel.plot([row[time]["median"] for row in rows], [row[error] for row in rows], color=colour,
                       **style)
            for row in rows:
                panel.hlines(row[error], row[time]["low"], row[time]["high"], color=colour, linewidth=4,
                             alpha=0.3)
    panel.set(xscale="log", yscale="log")
    plain(panel)


def _grown(cases: Sequence[Mapping]) -> tuple[list[Mapping], list[Mapping]]:
    """The cases of nine views by their side, and those of one side by their number of views."""
    sizes = {r["resolution"] for r in cases if r["views"] != 9}
    return (sorted((r for r in cases if r["views"] == 9), key=lambda r: r["resolution"]),
            sorted((r for r in cases if r["resolution"] in sizes), key=lambda r: r["views"]))


def _samples(panel: Axes, case: Mapping, shades: Mapping[str, str]) -> None:
    """The traced scene with more and more jittered rays a pixel, and what one ray through each centre
    does.
    """
    jittered = [row for row in case["rows"] if row["samples"] > 1]
    panel.plot([r["forward"]["median"] for r in jittered], [r["image"] for r in jittered],
               color=shades.get("mitsuba-scene"), marker="o", markersize=4, linewidth=1.6)
    for row in jittered:
        panel.annotate(str(row["samples"]), (row["forward"]["median"], row["image"]), (5, 4),
                       fontsize=FONT_SIZES["small"],
                       textcoords="offset points", color=shades.get("mitsuba-scene"))
    for row in case["rows"]:
        if row["samples"] == 1 and row["renderer"] in shades:
            panel.plot(row["forward"]["median"], row["image"], "D", color=shades[row["renderer"]],
                       markersize=5, zorder=4)
    panel.set(xscale="log", yscale="log")
    panel.margins(0.12, 0.15)
    headed(panel, "Whole pixels, forward", f"{case['bsdf']}, {case['resolution']} px; number: jittered rays")
    plain(panel)
