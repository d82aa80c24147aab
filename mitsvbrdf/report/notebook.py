"""How materials, captures and results show themselves in a notebook: small pictures, at most 14 of 128 px, below 1 MB."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from .. import color
from ..capture import Capture
from ..fit.result import FitResult
from ..maps import CHANNELS, SVBRDF
from .fit_page import about_views
from .folder import METHODS
from .page import at_most, figure, page_text, png_uri
from .sheet import SHOWN, TITLES, shown_map

LARGEST = 128  # pixels along a side of a picture
LISTED = 10  # notes and warnings
KNOWN = {"given": "as calibrated", "sheet": "from a sheet of tags", "photos": "from features that the photos share",
         "none": "of no calibration"}

Picture = tuple[str, str]  # caption and address


def svbrdf_html(svbrdf: SVBRDF) -> str:
    """The maps, each with the smallest and the largest of its values, as an HTML fragment."""
    side = svbrdf.resolution
    return _html(f"SVBRDF · {svbrdf.bsdf} · {side} × {side} px", [("", _maps(svbrdf))])


def capture_html(capture: Capture) -> str:
    """The photos with the positions of camera and light in patch sides, at most nine, as an HTML fragment."""
    sides, photos = capture.views.in_patch_sides(), []
    for name, photo, view in zip(capture.names, capture.photos[:SHOWN], sides):
        light = "light the same" if view.light == view.camera else f"light {_point(view.light)}"
        photos.append((f"{name} · camera {_point(view.camera)}, {light}", _uri(photo)))
    height, width = capture.photos.shape[1:3]
    facts = [f"transfer {capture.transfer}, falloff {capture.views.falloff}; positions in patch sides, "
             f"{KNOWN[capture.calibration]}"]
    name = capture.source.name if capture.source else "without a folder"
    return _html(f"Capture · {name} · {_count(len(capture))}, {width} × {height} px", [("", photos)], facts, capture.notes)


def result_html(result: FitResult) -> str:
    """Error and why the fit ended, maps, guessed diffuse map, at most nine re-rendered photos, and warnings, as HTML."""
    end = result.trace[-1] if result.trace else {}
    took = f" after {end['seconds']:.1f} s, {end['iteration']} iterations" if {"seconds", "iteration"} <= set(end) else ""
    again = [(f"#{number} · {error:.4f}", _uri(color.to_display(image, "srgb")))
             for number, (image, error) in enumerate(zip(result.rerendered[:SHOWN], result.per_photo), 1)]
    method = METHODS.get(type(result.config).__name__, type(result.config).__name__)
    return _html(f"FitResult · {method} · {result.renderer} · {result.svbrdf.bsdf}",
                 [("Maps", _maps(result.svbrdf) + [("Guessed diffuse", _uri(shown_map("diffuse", result.guess)))]),
                  ("Re-rendered, in sRGB, with the RMSE in display values", again)],
                 [f"re-rendering RMSE {result.rerender_rmse:.4f} over {_count(len(result.per_photo))}; "
                  f"stopped: {result.stopped}{took}", *filter(None, [about_views(result.calibration)])],
                 [f"warning: {warning}" for warning in result.warnings])


def _html(title: str, groups: Sequence[tuple[str, list[Picture]]], facts: Sequence[str] = (), notes: Sequence[str] = ()) -> str:
    return page_text("notebook.html", title=title, groups=groups, facts=facts, notes=notes[:LISTED], side=LARGEST)


def _maps(svbrdf: SVBRDF) -> list[Picture]:
    found = []
    for name in CHANNELS[svbrdf.bsdf]:
        value = svbrdf[name].detach()
        span = "" if name == "normal" else f" {figure(float(value.min()))} to {figure(float(value.max()))}"
        found.append((TITLES[name] + span, _uri(shown_map(name, value))))
    return found


def _uri(display: Tensor) -> str:
    """A picture for ``<img src>``; magenta where it is not a number."""
    small = at_most(display.detach().cpu().float(), LARGEST)
    return png_uri(torch.where(small.isnan().any(dim=-1, keepdim=True), torch.tensor([1.0, 0.0, 1.0]), small))


def _point(position: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{x:.2f}" for x in position) + ")"


def _count(photos: int) -> str:
    return "1 photo" if photos == 1 else f"{photos} photos" + (f", {SHOWN} shown" if photos > SHOWN else "")
