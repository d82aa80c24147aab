"""The maps of a fit against photos: errors with the views they belong to, seen and held-out photos apart."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from torch import Tensor

from ..calibrate.refine import Priors
from ..capture import Capture
from ..fit.result import Fit
from ..material.maps import SVBRDF
from ..measure.rerender import rerender
from ..render import Renderer
from ..views import Views, shift_lights
from . import evaluate_capture


def evaluate_photos(svbrdf: SVBRDF, fit: Fit, capture: Capture, renderer: Renderer,
                    priors: Priors | None = None) -> tuple[dict, Tensor]:
    """Errors of the re-rendered photos in display values.

    A photo that the fit saw is rendered with the view that the fit ended with, so its error is the one that
    the fit reports; all others with the calibration and the flash offset of the fit. Refined views make an
    error smaller that maps without a ``fit.json`` cannot have, so what
    :func:`mitsvbrdf.evaluate.evaluate_capture` finds for all of them stands beside it.

    Args:
        svbrdf: the material, brought to the photos' resolution if it differs.
        fit: how it saw its photos; the defaults for maps without a ``fit.json``.
        capture: N photos, as :func:`~mitsvbrdf.evaluate.placement.placed` leaves them.
        priors: measure a third time, with views refined beside frozen maps.

    Returns:
        ``views`` (how they were taken, in words), ``fitted_views`` and ``held_out`` (names of photos),
        ``rerender_rmse``, ``per_photo``, ``rmse_seen`` and ``rmse_held_out`` (None without such photos);
        ``calibrated`` (``views`` in words) and, without priors None, ``refined`` (``views`` as
        :func:`~mitsvbrdf.evaluate.evaluate_capture` has them) have these four too. And the images, linear N x
        R x R x 3.
    """
    views, fitted = fitted_views(fit, capture)
    here = fit.of(capture)
    seen = [name for name, number in zip(capture.names, capture.index) if here and number in fit.seen]
    held_out = [name for name in capture.names if here and name not in seen]
    images, total, each = rerender(renderer, svbrdf.resized(capture.resolution), views, capture)

    def apart(found: dict) -> dict:
        errors = found["per_photo"]
        return found | {"rmse_seen": _together(errors, seen), "rmse_held_out": _together(errors, held_out)}

    stated = evaluate_capture(svbrdf, capture, renderer, fit.flash_offset, priors)
    refined = stated.pop("refined", None)
    shown = apart({"rerender_rmse": total, "per_photo": dict(zip(capture.names, each))})
    return {"views": _words(fit, fitted, capture), "fitted_views": fitted, "held_out": held_out} | shown | {
        "calibrated": {"views": _words(fit, [], capture)} | apart(stated), "refined": refined
        and apart(refined)}, images


def fitted_views(fit: Fit, capture: Capture) -> tuple[Views, list[str]]:
    """The views to show a fit's maps with, and the names of the photos whose view is the fit's.

    These are the photos that it saw, where it was fitted to this capture; the others have the capture's view
    and the flash offset of the fit. Lengths are in patch sides.
    """
    views = shift_lights(capture.views, fit.flash_offset).in_patch_sides()
    names: list[str] = []
    if fit.known_views is None or not fit.of(capture):
        return views, names
    stored = fit.views.in_patch_sides()
    camera, light, intensity = views.camera.clone(), views.light.clone(), views.intensity.clone()
    for row, (name, number) in enumerate(zip(capture.names, capture.index)):
        if number in fit.seen[:len(stored)]:
            at = fit.seen.index(number)
            for mine, theirs in ((camera, stored.camera), (light, stored.light),
                                 (intensity, stored.intensity)):
                mine[row] = theirs[at].to(mine.dtype)
            names.append(name)
    return replace(views, camera=camera, light=light, intensity=intensity), names


def _together(errors: Mapping[str, float], names: list[str]) -> float | None:
    return math.sqrt(sum(errors[name]**2 for name in names) / len(names)) if names else None


def _words(fit: Fit, fitted: list[str], capture: Capture) -> str:
    offset = fit.flash_offset
    beside = f" and the fit's flash offset ({offset[0]:.3f}, {offset[1]:.3f})" if offset else ""
    unknown = ("views estimated from the photos" if fit.estimated or fit.known_views is None
               else "default geometry")
    if not fitted:
        return f"{'calibrated views' if capture.calibrated else unknown}{beside}"
    if len(fitted) == len(capture):
        return "views as fitted"
    others = "the calibration" if capture.calibrated else unknown
    return f"views as fitted for {', '.join(fitted)}, the others with {others}{beside}"
