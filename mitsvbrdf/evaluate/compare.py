"""Maps of several methods for the photos of one capture, measured and rendered alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from torch import Tensor

from .. import color
from ..calibrate.refine import Priors
from ..capture import Capture
from ..errors import ConfigError
from ..fit.result import Fit
from ..material.maps import SVBRDF
from ..render import Renderer
from .photos import evaluate_photos
from .placement import placed

MapErrors = Callable[[SVBRDF], Mapping[str, float]]


@dataclass(frozen=True)
class Entry:
    """What one method found.

    Args:
        name: the method, as captions call it.
        folder: where its maps were read from.
        svbrdf: its maps, of any resolution.
        fit: how it saw its photos; the defaults for maps without a ``fit.json``.
    """

    name: str
    folder: str
    svbrdf: SVBRDF
    fit: Fit = field(default_factory=Fit)


def compare(entries: Sequence[Entry], capture: Capture, renderer: Renderer, map_errors: MapErrors
            | None = None, transfer: color.Transfer | None = None, priors: Priors | None = None,
            index: Sequence[int] | None = None) -> tuple[dict, list[Tensor]]:
    """Measure every method at the photos' resolution, to which maps are brought.

    Photos are rendered, and errors counted, as :func:`~mitsvbrdf.evaluate.photos.evaluate_photos` says.

    Args:
        entries: one or more, each with a name of its own.
        map_errors: gives the RMSE of maps against known ones, by map; None where none are known.
        transfer: how display values encode radiance; None: as each fit took it, else as the capture states.
        priors: measure a third time, with views refined beside frozen maps, which treats all methods alike.
        index: numbers of the N photos to show; None: all. Where views are unknown, all photos help to
            estimate them.

    Returns:
        The record, ready for JSON, and for each method the pictures N x R x R x 3 in display values. A
        method's entry in ``methods`` has ``name``, ``folder``, ``resolution`` of its maps, ``transfer``,
        ``falloff``, ``flash_offset``, ``map_rmse`` (or None), and what
        :func:`~mitsvbrdf.evaluate.photos.evaluate_photos` returns.

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
        svbrdf = entry.svbrdf.resized(capture.resolution)
        found, images = evaluate_photos(svbrdf, fit, shots, renderer, priors)
        pictures.append(color.to_display(images, shots.transfer))
        methods.append({"name": entry.name, "folder": entry.folder, "resolution": entry.svbrdf.resolution,
            "bsdf": entry.svbrdf.bsdf,
            "transfer": shots.transfer, "falloff": fit.falloff, "flash_offset": fit.flash_offset,
            "map_rmse": None if map_errors is None else dict(map_errors(svbrdf)), **found})
    return {"capture": capture.source.name if capture.source else None, "photos": list(capture.names),
            "resolution": capture.resolution, "renderer": renderer.name, "methods": methods}, pictures
