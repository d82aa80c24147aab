"""Materials, captures and fits in a notebook: small pictures, at most 14 of 128 px, below 1 MB."""

import functools
from collections.abc import Sequence

import torch
from torch import Tensor

from .. import color
from ..capture import Capture
from ..fit.diagnose import about_views
from ..fit.record import FROM
from ..fit.result import Fit
from ..material.maps import CHANNELS, SVBRDF, TITLES, shown_map
from .page import figure, page_text
from .pictures import at_most, png_uri

SHOWN = 9  # photos
PICTURE_SIDE = 128  # pixels along a side of a picture
NOTES_SHOWN = 10  # notes and warnings

Picture = tuple[str, str]  # caption and address


@functools.singledispatch
def html_of(value: object) -> str:
    """A material, a capture or a fit as an HTML fragment."""
    raise TypeError(f"no HTML of {type(value).__name__}")


@html_of.register
def _(svbrdf: SVBRDF) -> str:
    side = svbrdf.resolution
    return _html(f"SVBRDF · {svbrdf.bsdf} · {side} × {side} px", [("", _maps(svbrdf))])


@html_of.register
def _(capture: Capture) -> str:
    photos = []
    for name, photo, view in zip(capture.names[:SHOWN], capture.photos, capture.views.in_patch_sides()):
        light = "light the same" if view.camera == view.light else f"light {_point(view.light)}"
        photos.append((f"{name} · camera {_point(view.camera)}, {light}", _uri(photo)))
    height, width = capture.photos.shape[1:3]
    name = capture.name or "without a folder"
    return _html(f"Capture · {name} · {_count(len(capture))}, {width} × {height} px", [("", photos)],
                 [f"transfer {capture.transfer}, falloff {capture.views.falloff}; positions in patch sides",
                  FROM[capture.calibration]], capture.notes)


@html_of.register
def _(fit: Fit) -> str:
    end = fit.trace[-1] if fit.trace else {}
    took = (f" after {end['seconds']:.1f} s, {end['iteration']} iterations"
            if {"seconds", "iteration"} <= set(end) else "")
    stated = ("" if fit.calibrated_rmse is None
              else f" with views as fitted, {fit.calibrated_rmse:.4f} as calibrated")
    again = [(f"#{number} · {error:.4f}", _uri(color.to_display(image, "srgb")))
             for number, (image, error) in enumerate(zip(fit.rerendered[:SHOWN], fit.per_photo), 1)]
    guess = ("Guessed diffuse", _uri(shown_map("diffuse", fit.guess)))
    return _html(f"{type(fit).__name__} · {fit.method} · {fit.renderer} · {fit.svbrdf.bsdf}",
                 [("Maps", [*_maps(fit.svbrdf), guess]),
                  ("Re-rendered, in sRGB, with the RMSE in display values", again)],
                 [f"re-rendering RMSE {fit.rerender_rmse:.4f} over {_count(len(fit.per_photo))}{stated}; "
                  f"stopped: {fit.stopped}{took}", *filter(None, [about_views(fit.calibration)])],
                 [f"warning: {warning}" for warning in fit.warnings])


def _html(title: str, groups: Sequence[tuple[str, list[Picture]]], facts: Sequence[str] = (),
          notes: Sequence[str] = ()) -> str:
    """A heading, facts, rows of pictures each with its own heading, and the first notes."""
    return page_text("report/notebook.html", title=title, groups=groups, facts=facts,
                     notes=notes[:NOTES_SHOWN], side=PICTURE_SIDE)


def _maps(svbrdf: SVBRDF) -> list[Picture]:
    found = []
    for name in CHANNELS[svbrdf.bsdf]:
        value = svbrdf[name].detach()
        span = "" if name == "normal" else f" {figure(float(value.min()))} to {figure(float(value.max()))}"
        found.append((TITLES[name] + span, _uri(shown_map(name, value))))
    return found


def _uri(display: Tensor) -> str:
    """A picture for ``<img src>``; magenta where a value is NaN."""
    small = at_most(display.detach().cpu().float(), PICTURE_SIDE)
    return png_uri(torch.where(small.isnan().any(dim=-1, keepdim=True), torch.tensor([1.0, 0.0, 1.0]), small))


def _point(position: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{x:.2f}" for x in position) + ")"


def _count(photos: int) -> str:
    return "1 photo" if photos == 1 else f"{photos} photos" + (f", {SHOWN} shown" if photos > SHOWN else "")
