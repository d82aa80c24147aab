"""The page of the plausible detail of a fit, which is for pictures only."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import torch

from .. import color
from ..fit.result import Fit
from ..material.maps import CHANNELS, TITLES, shown_map
from ..render.analytic import AnalyticRenderer
from ..views import Views
from .header import material_name
from .page import write_page
from .pictures import at_most, picture_uri
from .viewer import viewer_html

PAGE = "detail.html"
LARGEST = 512  # pixels a side on the page


def write_detail_page(found: Fit, into: Path) -> str | None:
    """Write ``detail.html`` of a fit: maps, a new light and the live viewer, all of its plausible detail.

    Returns:
        The page's name; None where the fit has none.
    """
    if found.detail is None:
        return None
    assert found.transfer is not None  # a fit's record has it
    view, settings = unseen_view(found.views), found.record["detail"]
    engine, transfer = found.engine() or AnalyticRenderer(), found.transfer
    with torch.no_grad():
        relit = [(title, picture_uri(at_most(color.to_display(engine.render(svbrdf, view)[0], transfer),
                                             LARGEST)))
                 for title, svbrdf in (("maps/", found.svbrdf), ("detail/", found.detail))]
    maps = [(TITLES[name], picture_uri(at_most(shown_map(name, found.detail[name]), LARGEST)))
            for name in CHANNELS[found.detail.bsdf]]
    write_page(into / PAGE, "report/detail.html", title=f"{material_name(found)}: plausible detail",
               detail=settings, maps=maps, relit=relit, solved_rmse=found.rerender_rmse,
               viewer=viewer_html(found.detail))
    return PAGE


def unseen_view(views: Views) -> Views:
    """The view half way between two photos that is farthest from every camera: the means of theirs."""
    pairs = torch.combinations(torch.arange(len(views)), with_replacement=True)
    camera, light, intensity = (x[pairs].mean(dim=1) for x in (views.camera, views.light, views.intensity))
    farthest = int(torch.cdist(camera, views.camera).amin(dim=1).argmax())
    between = dataclasses.replace(views, camera=camera, light=light, intensity=intensity)
    return between.pick([farthest])
