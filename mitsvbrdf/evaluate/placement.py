"""The views and lights that the photos of a fit, or other photos, are rendered again with."""

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from .. import color
from ..calibrate.estimate import self_calibrated, why_not
from ..calibrate.readings import Reading
from ..capture import Capture, read_capture
from ..errors import CaptureError
from ..fit.result import Fit
from ..material.maps import SVBRDF
from ..measure.metrics import of_all
from ..measure.rerender import rerender
from ..render import Renderer
from ..views import Falloff, Views, nine_view_grid, shift_lights


def placed(capture: Capture, fit: Fit, transfer: color.Transfer | None = None) -> Capture:
    """The capture with its stated views. If it states none, views are estimated from all of its photos.

    If the fit saw some of these photos, all estimated views are moved together until the views of the seen
    photos agree with the fit in the mean: sideways by an offset, heights and light power by a factor. So
    unseen photos can be predicted, though only the photos themselves tell where they were taken. A fit that
    took the default geometry is shown with it. Stated views are read as the fit was told to. Only their light
    power changes, if the maps of the fit told another one. All photos have the response curve of the fit.

    Args:
        capture: all photos, those held out and those it saw.
        transfer: how display values encode radiance; None: as in the fit, for other captures as stated.

    Raises:
        CaptureError: the fit estimated views, and these photos do not allow it.
    """
    ours = fit.of(capture)
    taken = transfer or (fit.transfer if ours else None) or capture.transfer
    capture = (capture if taken == capture.transfer else capture.but(transfer=taken)).through(fit.transfer)
    if ours:
        capture = Reading.told(fit.record.get("command", {})).of(capture)
    if capture.calibrated and fit.light_power_factor != 1 and not fit.estimated and ours:
        lights = capture.views.intensity * fit.light_power_factor
        return capture.but(views=replace(capture.views, intensity=lights))
    if capture.calibrated or not (fit.estimated or fit.known_views is None):
        return capture
    if fit.estimated and (why := why_not(capture)):
        raise CaptureError("photos from which views can be estimated, as for this fit",
                           f"{len(capture)} of which {why}", "give all photos of the capture")
    capture, _ = self_calibrated(capture)
    both = [(capture.index.index(number), row) for row, number in enumerate(fit.seen)
            if number in capture.index]
    if fit.known_views is None or not both or not ours:
        return capture
    here, there = (views.in_patch_sides().pick(rows)
                   for views, rows in zip((capture.views, fit.views), zip(*both)))
    shift = torch.cat([(there.camera - here.camera).mean(dim=0)[:2], torch.zeros(1)]) * capture.views.size
    higher = (there.camera[:, 2] / here.camera[:, 2]).log().mean().exp()
    brighter = (there.intensity.sum(dim=1) / here.intensity.sum(dim=1)).log().mean().exp()
    camera = capture.views.camera * torch.stack([torch.ones(()), torch.ones(()), higher]) + shift
    return capture.but(views=replace(capture.views, camera=camera, light=camera.clone(),
                                          intensity=capture.views.intensity * brighter))


def fitted_views(fit: Fit, capture: Capture) -> tuple[Views, list[str]]:
    """The views to render a fit's maps with, and the names of the photos that have a view of the fit.

    Photos that the fit saw have its view, if it was fitted to this capture. All other photos have the view of
    the capture and the flash offset of the fit. Lengths are in patch sides.
    """
    views = shift_lights(capture.views, fit.flash_offset).in_patch_sides()
    if fit.known_views is None or not fit.of(capture):
        return views, []
    stored = fit.views.in_patch_sides()
    rows = {row: fit.seen.index(number) for row, number in enumerate(capture.index)
            if number in fit.seen[:len(stored)]}
    parts = {part: getattr(views, part).clone() for part in ("camera", "light", "intensity")}
    for part, values in parts.items():
        values[list(rows)] = getattr(stored, part)[list(rows.values())].to(values.dtype)
    return replace(views, **parts), [capture.names[row] for row in rows]


def named_views(source: str, falloff: Falloff, fit: Fit | None = None) -> tuple[list[str], Views, list[str]]:
    """Names and views of a capture (from :func:`placed`; if its views are neither stated nor estimated, from
    :func:`fitted_views`) or of ``builtin:grid``; and notes.
    """
    if source == "builtin:grid":
        views = replace(nine_view_grid(), falloff=falloff)
        return [f"{i:02d}" for i in range(len(views))], views, []
    if source.startswith("builtin:"):
        raise CaptureError("a capture folder or builtin:grid", source, "check --views")
    read = read_capture(Path(source), falloff=falloff)
    shots = placed(read, fit := fit or Fit())
    views = shots.views if shots.calibrated or fit.estimated else fitted_views(fit, shots)[0]
    return list(shots.names), views, list(shots.notes[len(read.notes):])


def predict(svbrdf: SVBRDF, capture: Capture, renderer: Renderer,
            flash_offset: tuple[float, float] | None) -> tuple[Tensor, float, list[float]]:
    """Photos that a fit did not use, rendered as in :func:`mitsvbrdf.evaluate.evaluate_capture`: linear
    radiance N x R x R x 3, the RMSE over all photos in display values, and the RMSE of each photo.
    """
    material, lit = svbrdf.resized(capture.resolution), shift_lights(capture.views, flash_offset)
    found = [rerender(renderer, material, lit.pick([k]), capture.pick([number]))
             for k, number in enumerate(capture.index)]
    each = [error for _, error, _ in found]
    return torch.cat([images for images, _, _ in found]), of_all(each), each
