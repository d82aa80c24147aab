"""Errors of a fit's maps on photos, each rendered in its own view; seen and held-out photos apart.

:func:`compare` does the same for maps of several methods.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from torch import Tensor

from .. import color
from ..calibrate.refine import Priors
from ..capture import Capture
from ..errors import ConfigError
from ..fit.result import Fit
from ..io.entry import entry
from ..material.maps import SVBRDF
from ..measure.metrics import of_all
from ..measure.rerender import rerendered
from ..render import Renderer
from . import evaluate_capture
from .placement import fitted_views, is_of, placed


def evaluate_photos(svbrdf: SVBRDF, fit: Fit, capture: Capture, renderer: Renderer,
                    priors: Priors | None = None, index: Sequence[int] | None = None,
                    pictures: list[Tensor] | None = None) -> dict:
    """Errors of the re-rendered photos in display values.

    Views are :func:`fitted_views`. ``calibrated``, ``refined``: :func:`mitsvbrdf.evaluate.evaluate_capture`.

    Args:
        svbrdf: the material, of any resolution.
        fit: gives views and light. For maps without a ``fit.json``: ``Fit()``.
        capture: N photos, as :func:`~mitsvbrdf.evaluate.placement.placed` returns them.
        priors: if given, errors are also measured with refined views and frozen maps.
        index: numbers of the photos to measure; None: all. :func:`is_of` compares all N.
        pictures: a list; the re-rendered photos, N x R x R x 3 display values, are appended. None: not kept.

    Returns:
        ``views`` (in words), ``fitted_views`` and ``held_out`` (names of photos), ``rerender_rmse``,
        ``per_photo``, ``rmse_seen`` and ``rmse_held_out`` (None without such photos). ``calibrated`` and
        ``refined`` (None without priors) also have these four errors, and ``views``.
    """
    here, (views, fitted) = is_of(fit, capture), fitted_views(fit, capture)
    if index is not None:
        capture, rows = capture.pick(index), [capture.index.index(number) for number in index]
        views, fitted = views.pick(rows), [name for name in fitted if name in capture.names]
    seen = [row for row, number in enumerate(capture.index) if here and number in fit.seen]
    held_out = [row for row in range(len(capture)) if here and row not in seen]
    total, each, images, _ = rerendered(renderer, svbrdf.resized(capture.resolution), views, capture,
                                        1 if pictures is None else capture.resolution)
    if pictures is not None:
        pictures.append(color.to_display(images, capture.transfer))

    def apart(found: dict) -> dict:
        each, told = list(found["per_photo"].values()), capture.measured
        return found | {part: of_all([each[k] for k in rows], told if told is None else told[rows]) if rows
                        else None for part, rows in (("rmse_seen", seen), ("rmse_held_out", held_out))}

    stated = evaluate_capture(svbrdf, capture, renderer, fit.flash_offset, priors)
    refined = stated.pop("refined", None)
    shown = apart({"rerender_rmse": total, "per_photo": dict(zip(capture.names, each))})
    return {"views": _words(fit, fitted, capture), "fitted_views": fitted,
            "held_out": [capture.names[row] for row in held_out]} | shown | {
        "calibrated": {"views": _words(fit, [], capture)} | apart(stated),
        "refined": refined and apart(refined)}


@entry()
def evaluate_fit(fit: Fit, capture: Capture) -> dict:
    """Errors of a fit on photos of its capture or other photos, as :func:`evaluate_photos` returns them.

    The views are those of :func:`~mitsvbrdf.evaluate.placement.placed`; renderer and falloff are those of the
    fit. ConfigError: the fit had no renderer of ours.
    """
    engine = fit.engine()
    if engine is None:
        raise ConfigError("a fit of one of our renderers", fit.renderer, "give a renderer")
    capture = capture.but(views=replace(capture.views, falloff=fit.falloff))
    return evaluate_photos(fit.svbrdf, fit, placed(capture, fit), engine)


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


@dataclass(frozen=True)
class Entry:
    """The result of one method."""

    name: str  # name of the method in captions
    folder: str  # where its maps were read from
    svbrdf: SVBRDF  # its maps, of any resolution
    fit: Fit = field(default_factory=Fit)  # gives views and light; default: for maps without a fit.json


def compare(entries: Sequence[Entry], capture: Capture, renderer: Renderer,
            map_errors: Callable[[SVBRDF], Mapping[str, float]] | None = None,
            transfer: color.Transfer | None = None, priors: Priors | None = None,
            index: Sequence[int] | None = None) -> tuple[dict, list[Tensor]]:
    """Measure every method at the resolution of the photos. Maps are resized to it.

    Args:
        entries: one or more, each with a name of its own.
        map_errors: gives the RMSE of each map against the known one; None if no maps are known.
        transfer: how display values encode radiance; None: see :func:`placed`.
        priors: if given, errors are also measured with refined views and frozen maps, for all methods alike.
        index: numbers of the N photos to show; None: all. Unknown views are estimated from all.

    Returns:
        The record, for JSON, and for each method the pictures N x R x R x 3 in display values. An entry
        of ``methods`` describes the maps and the fit, and has ``map_rmse`` (or None) and what
        :func:`evaluate_photos` returns. ``same_views``: whether all places are equal before flash offsets.

    Raises:
        ConfigError: there is no entry, or two entries have the same name.
    """
    names = [one.name for one in entries]
    if not names or len(set(names)) < len(names):
        raise ConfigError("methods with a name of their own", str(names or "none"), "write NAME=FOLDER")
    methods, pictures, lit = [], list[Tensor](), set[str]()
    for one in entries:
        fit = one.fit
        shots = placed(capture.but(views=replace(capture.views, falloff=fit.falloff)), fit, transfer)
        lit.add(str([shots.views.camera.tolist(), shots.views.light.tolist()]))
        svbrdf = one.svbrdf.resized(capture.resolution)
        methods.append({"name": one.name, "folder": one.folder, "resolution": one.svbrdf.resolution,
            "bsdf": one.svbrdf.bsdf, "transfer": shots.transfer, "falloff": fit.falloff,
            "flash_offset": fit.flash_offset, "map_rmse": map_errors and dict(map_errors(svbrdf)),
            **evaluate_photos(svbrdf, fit, shots, renderer, priors, index, pictures)})
    return {"capture": capture.name or None, "photos": list(methods[0]["per_photo"]),
            "resolution": capture.resolution, "renderer": renderer.name, "same_views": len(lit) == 1,
            "methods": methods}, pictures
