"""Views and lights in which the maps of a fit are re-rendered, for photos of the fit or other photos."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from .. import color
from ..calibrate.estimate import self_calibrated, why_not
from ..calibrate.readings import Reading
from ..capture import Capture, read_capture
from ..errors import CaptureError
from ..fit.result import Fit, Thumbnail
from ..views import Falloff, Views, nine_view_grid, shift_lights

# Photos of two sizes, averaged to 4 x 4, look alike if their median difference is less. In real captures
# a photo at 37 px differs from itself at 256 px by 0.008 at most; photos of another capture differ, at least
# one by 0.07 or more. The median, because a mask changes less than half of the values.
SAME = 0.02
# Pixels of one photo differ by STEP at most, as a fit keeps 8 bits; by other decoders and CPUs, FEW by more.
STEP, FEW = 1 / 255, 0.01


def is_of(fit: Fit, capture: Capture) -> bool:
    """Whether the fit was made from photos of this capture.

    If the fit keeps its photos, those with the same number must be equal, but for few of the measured pixels.
    If their sizes differ, they must look alike, and the folders must have the same name.
    """
    kept, named = fit.small_photos, (fit.capture or "") == capture.name
    both = [row for row, number in enumerate(capture.index) if number in kept]
    for row in both:
        here = Thumbnail.of(capture.stored[row], None if capture.measured is None else capture.measured[row])
        there = kept[capture.index[row]]
        if here.side == there.side and (np.abs(here.pixels - there.pixels) > STEP).mean() > FEW:  # not NaN
            return False
        if here.side != there.side and not (named and np.median(np.abs(here.means - there.means)) < SAME):
            return False
    return bool(both) or named and bool(fit.capture or kept)


def placed(capture: Capture, fit: Fit, transfer: color.Transfer | None = None) -> Capture:
    """The capture with its stated views. If it states none, views are estimated from all of its photos.

    If the fit saw some of these photos, all estimated views are moved together until the views of the seen
    photos agree with the fit in the mean: sideways by an offset, heights and light power by a factor. So
    unseen photos can be predicted, though their views are estimated from the photos themselves. A fit in
    the default geometry is rendered in it. If the fit is of this capture, stated views are read with its
    axes, side and light factor, and get its light power. Photos of the same response get its curve.

    Args:
        capture: all photos: those that the fit saw and those held out.
        transfer: how display values encode radiance; None: the fit's, if of this capture, else as stated.

    Raises:
        CaptureError: the fit estimated views, and these photos do not allow an estimate.
    """
    ours = is_of(fit, capture)
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
                           f"{len(capture)} photos: {why}", "give all photos of the capture")
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

    If the fit is of this capture, photos that it saw have its views. All other photos have the view of
    the capture and the flash offset of the fit. Lengths are in patch sides.
    """
    views = shift_lights(capture.views, fit.flash_offset).in_patch_sides()
    if fit.known_views is None or not is_of(fit, capture):
        return views, []
    stored = fit.views.in_patch_sides()
    rows = {row: fit.seen.index(number) for row, number in enumerate(capture.index)
            if number in fit.seen[:len(stored)]}
    parts = {part: getattr(views, part).clone() for part in ("camera", "light", "intensity")}
    for part, values in parts.items():
        values[list(rows)] = getattr(stored, part)[list(rows.values())].to(values.dtype)
    return replace(views, **parts), [capture.names[row] for row in rows]


def named_views(source: str, falloff: Falloff, fit: Fit | None = None) -> tuple[list[str], Views, list[str]]:
    """Names, views and notes of ``source``: a capture, with the fit's flash offset, or ``builtin:grid``."""
    if source == "builtin:grid":
        views = replace(nine_view_grid(), falloff=falloff)
        return [f"{i:02d}" for i in range(len(views))], views, []
    if source.startswith("builtin:"):
        raise CaptureError("a capture folder or builtin:grid", source, "check --views")
    read = read_capture(Path(source), falloff=falloff)
    shots = placed(read, fit := fit or Fit())
    views = (shift_lights(shots.views, fit.flash_offset) if shots.calibrated or fit.estimated
             else fitted_views(fit, shots)[0])
    return list(shots.names), views, list(shots.notes[len(read.notes):])
