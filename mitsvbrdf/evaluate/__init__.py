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
from ..errors import CaptureError, MapsError, MitsvbrdfError
from ..fit.calibration import UNKNOWNS, Priors, refine_views
from ..fit.loop import rerender
from ..fit.result import FitResult
from ..fit.self_calibration import self_calibrated, why_not
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
    """Error of a fit on the photos of its capture, placed by :func:`placed`, with the flash offset it found; see
    :func:`evaluate_capture`."""
    offset = result.flash_offset and tuple(x / result.views.size for x in result.flash_offset)
    fit = Fit(capture=_name(capture), seen=tuple(map(int, result.calibration.get("camera", ()))), views=result.views,
              estimated=result.calibration.get("estimated", False), power=result.calibration.get("power_told") or 1.0)
    renderer = make_renderer(result.renderer, result.variant or "llvm_ad_rgb")
    return evaluate_capture(result.svbrdf, placed(capture, fit), renderer, offset)


def shift_lights(views: Views, flash_offset: tuple[float, float] | None) -> Views:
    """The views with every light moved sideways by this much, in patch sides."""
    if flash_offset is None:
        return views
    return replace(views, light=views.light + torch.tensor([*flash_offset, 0.0], dtype=torch.float64) * views.size)


def placed(capture: Capture, fit: Fit) -> Capture:
    """A capture that states no views, with views estimated from all of its photos; any other as it is.

    Where the fit saw some of these photos, all are moved together until those are, in the mean, where the fit has them:
    sideways by an offset, heights and light power by a factor. So photos that it did not see can be predicted, though nothing
    but the photos themselves says where they were taken. A fit that took the default geometry is shown with that. Of stated
    views the light power alone changes, where the fit's maps told another one.

    Args:
        capture: all photos, those left out of the fit and those it saw.
        fit: what is known of it.

    Raises:
        CaptureError: the fit estimated views, and these photos do not allow it.
    """
    if capture.calibrated and fit.power != 1 and not fit.estimated and fit.of(capture):
        return replace(capture, views=replace(capture.views, intensity=capture.views.intensity * fit.power))
    if capture.calibrated or not (fit.estimated or fit.views is None):
        return capture
    if fit.estimated and (why := why_not(capture)):
        raise CaptureError("photos from which views can be estimated, as for this fit", f"{len(capture)} of which {why}",
                           "give all photos of the capture")
    capture, _ = self_calibrated(capture)
    both = [(capture.index.index(number), row) for row, number in enumerate(fit.seen) if number in capture.index]
    if fit.views is None or not both or not fit.of(capture):
        return capture
    here, there = (views.in_patch_sides().pick(rows) for views, rows in zip((capture.views, fit.views), zip(*both)))
    shift = torch.cat([(there.camera - here.camera).mean(dim=0)[:2], torch.zeros(1)]) * capture.views.size
    higher = (there.camera[:, 2] / here.camera[:, 2]).log().mean().exp()
    brighter = (there.intensity.sum(dim=1) / here.intensity.sum(dim=1)).log().mean().exp()
    camera = capture.views.camera * torch.stack([torch.ones(()), torch.ones(()), higher]) + shift
    return replace(capture, views=replace(capture.views, camera=camera, light=camera.clone(),
                                          intensity=capture.views.intensity * brighter))


def _name(capture: Capture) -> str:
    return capture.source.name if capture.source else ""


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
        estimated: whether the views were estimated from the photos.
        power: what the light power that the capture states is to be multiplied by, as its maps told.
    """

    falloff: Falloff = "inverse-square"
    transfer: color.Transfer | None = None
    flash_offset: tuple[float, float] | None = None
    capture: str | None = None
    seen: tuple[int, ...] = ()
    views: Views | None = None
    method: str | None = None
    estimated: bool = False
    power: float = 1.0

    def of(self, capture: Capture) -> bool:
        """Whether it was fitted to photos of this capture, as the names of the folders tell."""
        return self.capture == _name(capture)

    def label(self, capture: Capture, number: int) -> str:
        """Name of a photo, and whether the fit saw it, where it was fitted to this capture."""
        if not self.of(capture):
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
        offset, views, known = record["flash_offset"], record["views"], record.get("calibration", {})
        fit = Fit(views["falloff"], record["capture"]["transfer"],
                  None if offset is None else (float(offset["x"]), float(offset["y"])),
                  record["capture"]["name"], tuple(record["capture"]["photos"]),
                  Views.of(views["camera"], views["light"], views["intensity"], views["size"], views["falloff"]),
                  record.get("method"), known.get("estimated", False) is True, float(known.get("power_told") or 1.0))
        if fit.transfer not in get_args(color.Transfer):
            raise ValueError("unknown transfer")
    except (ValueError, KeyError, TypeError, MitsvbrdfError) as reason:
        raise MapsError("a fit.json of this package", f"{path}: {reason!r}", "move it away to read the maps alone") from None
    return fit
