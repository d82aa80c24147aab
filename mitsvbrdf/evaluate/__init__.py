"""How good a material is: against known maps, or against photos."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import torch

from .. import color
from ..capture import Capture
from ..errors import MapsError, MitsvbrdfError
from ..fit.calibration import UNKNOWNS, Priors, refine_views
from ..fit.loop import rerender
from ..fit.result import FitResult
from ..maps import SVBRDF, encodings, load_maps
from ..metrics import map_rmse
from ..render import Renderer, make_renderer
from ..views import Falloff, Views


def evaluate_maps(svbrdf: SVBRDF, material: str | Path) -> dict[str, float]:
    """RMSE of each map against a folder of known maps, counted as :func:`mitsvbrdf.metrics.map_rmse` says.

    Returns:
        ``diffuse``, ``specular``, ``roughness``, ``normal`` and their ``mean``.
    """
    encoded = encodings(material).get("roughness", "linear").replace(" ", "") == "gamma2.2"
    return map_rmse(svbrdf, load_maps(material), "gamma 2.2" if encoded else "linear")


def evaluate_capture(svbrdf: SVBRDF, capture: Capture, renderer: Renderer,
                     flash_offset: tuple[float, float] | None = None, priors: Priors | None = None) -> dict:
    """Error of the re-rendered photos in display values.

    Args:
        svbrdf: the material, brought to the photos' resolution if it differs.
        capture: the photos; they need not be those of the fit.
        renderer: draws them.
        flash_offset: (x, y) of the flash beside the lens in patch sides, as a fit found it; None leaves the views alone.
        priors: how far the views may be off, to measure with refined ones too (:mod:`mitsvbrdf.fit.calibration`).

    Returns:
        ``rerender_rmse`` over all photos and ``per_photo`` by name. With priors, the same again in ``refined``, which also has
        ``views``: by photo, ``change`` and ``deviation`` of each unknown.
    """
    material = svbrdf.resized(capture.resolution)

    def errors(views: Views) -> dict:
        _, total, each = rerender(renderer, material, views, capture)
        return {"rerender_rmse": total, "per_photo": dict(zip(capture.names, each))}

    views = shift_lights(capture.views, flash_offset)
    found = errors(views)
    if priors:
        refined = refine_views(svbrdf, views, capture, priors)
        moved = {name: {"change": dict(zip(UNKNOWNS, change)), "deviation": dict(zip(UNKNOWNS, deviation))}
                 for name, change, deviation in zip(capture.names, refined.change.tolist(), refined.deviation.tolist())}
        found["refined"] = errors(refined.views) | {"views": moved}
    return found


def evaluate_fit(result: FitResult, capture: Capture) -> dict:
    """Error of a fit on the photos of a capture, with the flash offset it found; see :func:`evaluate_capture`."""
    offset = result.flash_offset and tuple(x / result.views.size for x in result.flash_offset)
    return evaluate_capture(result.svbrdf, capture, make_renderer(result.renderer, result.variant or "llvm_ad_rgb"), offset)


def shift_lights(views: Views, flash_offset: tuple[float, float] | None) -> Views:
    """The views with every light moved sideways by this much, in patch sides."""
    if flash_offset is None:
        return views
    return replace(views, light=views.light + torch.tensor([*flash_offset, 0.0], dtype=torch.float64) * views.size)


@dataclass(frozen=True)
class Fit:
    """What has to be known of a fit to show or measure its maps as it did.

    Args:
        falloff: of its light.
        transfer: of its photos; None when unknown.
        flash_offset: (x, y) of the flash beside the lens in patch sides, or None.
        capture: name of the folder of its photos; None when unknown.
        seen: numbers of the photos it used.
        views: theirs, as fitted; None when unknown.
        method: how it was fitted; None when unknown.
    """

    falloff: Falloff = "inverse-square"
    transfer: color.Transfer | None = None
    flash_offset: tuple[float, float] | None = None
    capture: str | None = None
    seen: tuple[int, ...] = ()
    views: Views | None = None
    method: str | None = None

    def label(self, capture: Capture, number: int) -> str:
        """Name of a photo, and whether the fit saw it, where it was fitted to this capture."""
        if self.capture is None or capture.source is None or self.capture != capture.source.name:
            return f"{number:02d}"
        return f"{number:02d} ({'seen' if number in self.seen else 'left out'})"


def fit_of(maps: str | Path) -> Fit:
    """What ``fit.json`` says, in a fit's folder or beside the ``maps`` folder inside it; defaults where there is none.

    Raises:
        MapsError: it is there but cannot be understood.
    """
    folder = Path(os.path.abspath(maps))
    path = (folder.parent if folder.name == "maps" else folder) / "fit.json"
    if not path.is_file():
        return Fit()
    try:
        record = json.loads(path.read_text())
        offset, views = record["flash_offset"], record["views"]
        fit = Fit(views["falloff"], record["capture"]["transfer"],
                  None if offset is None else (float(offset["x"]), float(offset["y"])),
                  record["capture"]["name"], tuple(record["capture"]["photos"]),
                  Views.of(views["camera"], views["light"], views["intensity"], views["size"], views["falloff"]),
                  record.get("method"))
        if fit.transfer not in get_args(color.Transfer):
            raise ValueError("unknown transfer")
    except (ValueError, KeyError, TypeError, MitsvbrdfError) as reason:
        raise MapsError("a fit.json of this package", f"{path}: {reason!r}", "move it away to read the maps alone") from None
    return fit
