"""Checks of the renderers on a fitted material, for the page of the fit and ``report.json``."""

import math
from collections.abc import Sequence

from .. import color
from ..errors import BackendError
from ..io import Report
from ..io.provenance import machine, versions
from ..material.maps import SVBRDF
from ..render import RENDERERS, Renderer, make_renderer
from ..verify.crosscheck import crosscheck
from ..views import Views

SCHEMA_VERSION = 1
QUICK_SIDE, QUICK_VIEWS = 64, 2  # of the check after every fit, which takes less than 0.5 s
# texels a side; errors and ratios hardly depend on it. Float64 takes 50 MB a view
LARGEST, MOST_VIEWS = 256, 25


def fit_report(svbrdf: SVBRDF, views: Views, renderer: Renderer | None, *, names: Sequence[str],
               transfer: color.Transfer, quick: bool = False,
               report: Report = lambda text, share: None) -> dict:
    """Measure renderers on fitted maps, in the views of the fit.

    ``renderer`` is None if the fit used one of another package, which cannot be measured. A quick
    report checks the fit's renderer alone, at 64 px in two views, without run times. Any other report is at
    256 px at most, in 25 views at most, evenly chosen. docs/formats.md explains the record for JSON.
    """
    engines = [] if renderer is None else [renderer]
    if not quick:
        engines += [other for name in RENDERERS if renderer is None or name != renderer.name
                    for other in _available(name, renderer)]
    side = min(QUICK_SIDE if quick else LARGEST, svbrdf.resolution)
    every = 1 if quick else math.ceil(len(views) / MOST_VIEWS)
    chosen = range(0, len(views), every)[:QUICK_VIEWS if quick else None]
    shown = views.pick(chosen)
    maps = {name: {"low": float(t.min()), "high": float(t.max()), "mean": float(t.mean())}
            for name, t in svbrdf.maps.items()}
    checked = None if not engines else crosscheck(
        {"fit": svbrdf.resized(side)}, shown, [svbrdf.bsdf], engines, 1 if quick else 5,
        names=[names[k] for k in chosen], transfer=transfer,
        report=lambda text, share: report("renderers against float64", share))
    return {"schema_version": SCHEMA_VERSION, "quick": quick, "maps": maps,
            "crosscheck": checked and _figures(checked, timed=not quick),
            "machine": machine(), "versions": versions()}


def _available(name: str, beside: Renderer | None) -> list[Renderer]:
    """A list of the renderer of this name; empty if Mitsuba or libLLVM is missing."""
    try:
        return [make_renderer(name, (beside and beside.variant) or "llvm_ad_rgb")]
    except BackendError:
        return []


def _figures(record: dict, timed: bool) -> dict:
    (about,), rows = record["materials"].values(), []
    for found in record["configurations"]:
        for texels in ("rough", "smooth"):
            if found[texels]:
                part = found[texels]
                rows.append({"renderer": found["renderer"], "texels": texels, "count": part["texels"],
                             "image": part["image"],
                             "gradients": {name: {"relative_l2": g["relative_l2"], "cosine": g["cosine"]}
                                           for name, g in part["gradients"].items()},
                             "limit": part["limit"], "seconds": found["seconds"] if timed else None})
    return {"reference": record["reference"], "resolution": about["resolution"],
            "views": record["views"]["names"],
            "rough_from": record["rough_from"], "tolerances": record["tolerances"], "rows": rows,
            "violations": [{name: v[name] for name in ("renderer", "what", "value", "tolerance", "limit")}
                           for v in record["violations"]]}
