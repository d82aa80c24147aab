"""Maps of several methods for the photos of one capture, measured and rendered alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from .. import color
from ..calibrate.refine import Priors
from ..capture import Capture
from ..errors import ConfigError
from ..fit.record import SavedFit
from ..material.maps import SVBRDF
from ..measure.rerender import rerender
from ..render import Renderer
from ..views import Views
from . import evaluate_capture
from .placement import placed, shift_lights

MapErrors = Callable[[SVBRDF], Mapping[str, float]]


@dataclass(frozen=True)
class Entry:
    """What one method found.

    Args:
        name: the method, as captions call it.
        folder: where its maps were read from.
        svbrdf: its maps, of any resolution.
        fit: how it saw its photos; the defaults for maps without a ``fit.json``.
        guess: its own guessed diffuse map, R x R x 3 linear, or None.
    """

    name: str
    folder: str
    svbrdf: SVBRDF
    fit: SavedFit = field(default_factory=SavedFit)
    guess: Tensor | None = None


def compare(entries: Sequence[Entry], capture: Capture, renderer: Renderer, map_errors: MapErrors | None = None,
            transfer: color.Transfer | None = None, priors: Priors | None = None,
            index: Sequence[int] | None = None) -> tuple[dict, list[Tensor]]:
    """Measure every method at the photos' resolution; maps of another one are brought to it (:meth:`SVBRDF.resized`).

    A photo that a fit saw is rendered with the view that the fit ended with, all else with the calibration and the flash offset
    of the fit. What :func:`mitsvbrdf.evaluate.evaluate_capture` finds for the photos, seen or not, stands beside it, since
    refined views make a method's error smaller that maps without a ``fit.json`` cannot have.

    Args:
        entries: one or more, each with a name of its own.
        capture: the photos.
        renderer: draws all of them.
        map_errors: gives the RMSE of maps against known ones, by map; None where none are known.
        transfer: how display values encode radiance; None: as each fit took it, else as the capture states.
        priors: measure a third time, with views refined beside frozen maps, which treats all methods alike.
        index: numbers of the N photos to show; None: all. Where views are unknown, all photos help to estimate them.

    Returns:
        The record, ready for JSON, and for each method the pictures N x R x R x 3 in display values. A method's entry in
        ``methods`` has ``name``, ``folder``, ``resolution`` of its maps, ``views`` (how they were taken, in words),
        ``fitted_views`` and ``left_out`` (names of photos), ``transfer``, ``falloff``, ``flash_offset``, ``map_rmse`` (or
        None), ``rerender_rmse`` and ``per_photo`` of the pictures, ``calibrated`` and ``refined`` (None without priors) with
        the same two.

    Raises:
        ConfigError: no entry, or a name that stands twice.
    """
    names = [entry.name for entry in entries]
    if not names or len(set(names)) < len(names):
        raise ConfigError("methods with a name of their own", str(names or "none"), "write NAME=FOLDER")
    all_photos, capture = capture, capture if index is None else capture.pick(index)
    methods, pictures = [], []
    for entry in entries:
        fit = entry.fit
        shots = replace(all_photos, transfer=transfer or fit.transfer or capture.transfer,
                        views=replace(all_photos.views, falloff=fit.falloff))
        shots = placed(shots, fit).pick(capture.index)
        svbrdf, (views, fitted) = entry.svbrdf.resized(capture.resolution), fitted_views(fit, shots)
        found = evaluate_capture(svbrdf, shots, renderer, fit.flash_offset, priors)
        images, total, each = rerender(renderer, svbrdf, views, shots)
        pictures.append(color.to_display(images, shots.transfer))
        left_out = [] if not fit.of(capture) else [n for n, i in zip(capture.names, capture.index) if i not in fit.seen]
        methods.append({
            "name": entry.name, "folder": entry.folder, "resolution": entry.svbrdf.resolution, "bsdf": entry.svbrdf.bsdf,
            "views": _words(fit, fitted, capture), "fitted_views": fitted, "left_out": left_out, "transfer": shots.transfer,
            "falloff": fit.falloff, "flash_offset": fit.flash_offset,
            "map_rmse": None if map_errors is None else dict(map_errors(svbrdf)),
            "rerender_rmse": total, "per_photo": dict(zip(capture.names, each)),
            "calibrated": {name: found[name] for name in ("rerender_rmse", "per_photo")},
            "refined": {name: found["refined"][name] for name in ("rerender_rmse", "per_photo")} if priors else None})
    return {"capture": capture.source.name if capture.source else None, "photos": list(capture.names),
            "resolution": capture.resolution, "renderer": renderer.name, "methods": methods}, pictures


def fitted_views(fit: SavedFit, capture: Capture) -> tuple[Views, list[str]]:
    """The views to show a fit's maps with, and the names of the photos among them whose view comes from the fit.

    These are the photos that it saw, where it was fitted to this capture; the others have the capture's view and the flash
    offset of the fit. Lengths are in patch sides.
    """
    views = shift_lights(capture.views, fit.flash_offset).in_patch_sides()
    names: list[str] = []
    if fit.views is None or not fit.of(capture):
        return views, names
    stored = fit.views.in_patch_sides()
    camera, light, intensity = views.camera.clone(), views.light.clone(), views.intensity.clone()
    for row, (name, number) in enumerate(zip(capture.names, capture.index)):
        if number in fit.seen[:len(stored)]:
            at = fit.seen.index(number)
            for mine, theirs in ((camera, stored.camera), (light, stored.light), (intensity, stored.intensity)):
                mine[row] = theirs[at].to(torch.float64)
            names.append(name)
    return replace(views, camera=camera, light=light, intensity=intensity), names


def _words(fit: SavedFit, fitted: list[str], capture: Capture) -> str:
    offset = fit.flash_offset
    beside = f" and the fit's flash offset ({offset[0]:.3f}, {offset[1]:.3f})" if offset else ""
    unknown = "views estimated from the photos" if fit.estimated or fit.views is None else "default geometry"
    if not fitted:
        return f"{'calibrated views' if capture.calibrated else unknown}{beside}"
    if len(fitted) == len(capture):
        return "views as fitted"
    others = "the calibration" if capture.calibrated else unknown
    return f"views as fitted for {', '.join(fitted)}, the others with {others}{beside}"
