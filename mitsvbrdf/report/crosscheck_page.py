"""The page of a cross-check."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import torch
from matplotlib.figure import Figure
from torch import Tensor

from ..verify.crosscheck import omitted
from .charts import BOUND, FAINT, logarithmic, quiet, svg
from .page import figure, write_page
from .pictures import error_picture, png_uri

# Error maps of all configurations share these ends of their log scale, so that they can be compared by eye.
LEAST_SHOWN, MOST_SHOWN = 1e-8, 1e-4
BSDF_MARKS = {"roughconductor": "o", "principled": "s"}


def write_crosscheck_page(path: str | Path, record: dict,
                          error_maps: Mapping[tuple[str, str, str], Tensor]) -> None:
    """One self-contained HTML file: figures, error against run time, error maps, worst texels.

    The record and the error maps (R x R, by material, BSDF and renderer) are those of one call of
    :func:`mitsvbrdf.verify.crosscheck.crosscheck`.
    """
    maps = {key: png_uri(error_picture(error, MOST_SHOWN, LEAST_SHOWN)) for key, error in error_maps.items()}
    ramp = torch.logspace(-8, -4, 256, dtype=torch.float64).expand(16, 256)
    converted = {bsdf: how for material in record["materials"].values()
                 for bsdf, how in material["converted"].items()}
    materials = {name: [c for c in record["configurations"] if c["material"] == name]
                 for name in record["materials"]}
    write_page(path, "report/crosscheck.html", title="Renderers against float64", record=record,
               materials=materials, error_maps=maps,
               ramp=png_uri(error_picture(ramp, MOST_SHOWN, LEAST_SHOWN)),
               darkest=LEAST_SHOWN, brightest=MOST_SHOWN, plot=svg(error_against_time(record)),
               omitted=omitted(record), converted=converted, cosine=_cosine, digits=_digits)


def error_against_time(record: dict) -> Figure:
    """Image error, and gradient error of the worst map, against the seconds of a forward and a backward pass.

    One point for each configuration, over all texels of roughness 0.1 and more; hollow over those below, for
    a material without such. Bars reach from the first to the third quartile of the run times. An error of 0
    has no place on such axes.
    """
    drawing = Figure(figsize=(9, 4), layout="constrained")
    panels = drawing.subplots(1, 2, sharex=True)
    renderers = list(dict.fromkeys(c["renderer"] for c in record["configurations"]))
    colours = {name: matplotlib.colormaps["tab10"](i % 10) for i, name in enumerate(renderers)}
    named = set()
    for c in record["configurations"]:
        texels, label = c["rough"] or c["smooth"], f"{c['renderer']}, {c['bsdf']}"
        low, median, high = (sum(way[name] for way in c["seconds"].values())
                             for name in ("low", "median", "high"))
        worst = max((g["relative_l2"] for g in texels["gradients"].values() if g["relative_l2"] is not None),
                    default=None)
        look = {"fmt": BSDF_MARKS[c["bsdf"]], "color": colours[c["renderer"]], "markersize": 4, "alpha": 0.8,
                "elinewidth": 0.8, "markerfacecolor": None if c["rough"] else "none"}
        for panel, error in zip(panels, (texels["image"]["mean"], worst)):
            if error:
                panel.errorbar(median, error, xerr=[[max(median - low, 0)], [max(high - median, 0)]], **look,
                               label=None if label in named else label)
                named.add(label)
    tolerances = record["tolerances"]["image"]["mean"], record["tolerances"]["gradients"]["relative_l2"]
    titles = "Mean relative image error", "Gradient of the worst map, relative L2"
    for panel, title, tolerance in zip(panels, titles, tolerances):
        line = panel.axhline(tolerance, color=BOUND, linewidth=0.8, linestyle="--")
        quiet(panel, title)
        panel.set_xlabel("seconds, forward and backward")
        logarithmic(panel)
    line.set_label("stated tolerance")
    if not all(c["rough"] for c in record["configurations"]):
        panels[0].plot([], [], "o", color=FAINT, markerfacecolor="none", markersize=4,
                       label=f"hollow: all texels below roughness {record['rough_from']}, no tolerance")
    drawing.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return drawing


def _digits(value: float | None) -> str:
    """A float32 with all its digits, for values that differ in the last ones."""
    return figure(None) if value is None else f"{value:.9g}"


def _cosine(value: float | None) -> str:
    """A cosine close to 1 by how much it lacks: 1 - 2.3e-13."""
    return figure(None) if value is None else f"1 − {figure(max(1 - value, 0.0))}"
