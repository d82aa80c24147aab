"""What ``fit.json`` says of the views."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping

import torch
from torch import Tensor

from ..calibrate.estimate import ESTIMATED, POWER, EstimatedViews
from ..calibrate.refine import CHANGE
from ..capture import Capture
from ..views import Views

FROM = {"given": "The views are those of the capture's calibration", "sheet": "The views come from a sheet "
                                                                              "of tags",
        "photos": "The views come from features that the photos share",
        "none": "The views are a stated default geometry",
        "estimated": "The views were estimated from the rectified photos alone"}


def views_record(capture: Capture, views: Views, estimated: EstimatedViews | None, refined: Tensor | None,
                 flash: Tensor | None, light_power_factor: float | None = None) -> dict:
    """What a fit knows of its views and how surely, lengths in patch sides, for ``fit.json``.

    Args:
        capture: the photos, with the views that the fit began with.
        views: as fitted.
        estimated: how the former were estimated from the photos; None where they were stated.
        refined: standard deviations N x 7 of the changes since (:data:`mitsvbrdf.calibrate.refine.CHANGE`);
            None for none.
        flash: standard deviations (x, y) of the flash offset that all photos share; None where it was not
            fitted.
        light_power_factor: by what the maps changed the light power (:mod:`mitsvbrdf.fit.light_power`); None
            where they do not tell it.

    Returns:
        ``from`` (the kind of calibration), ``estimated`` and ``refined`` (whether), by photo name ``camera``,
        ``camera_sd`` and ``log_exposure_sd``; ``flash_offset`` and ``flash_offset_sd``; ``light_power``, the
        mean over photos and channels, ``power_told`` and ``log_power_sd``, None where a calibration or a
        sheet tells it. Other deviations are None where nothing was estimated.
    """
    sides, begun = views.in_patch_sides(), capture.views.in_patch_sides()
    told = [ESTIMATED.unpack(estimated.deviation)] if estimated else []
    told += [CHANGE.unpack(refined)] if refined is not None else []
    offset = ((sides.light - sides.camera) - (begun.light - begun.camera)).mean(dim=0)[:2].tolist()
    return {
        "from": capture.calibration, "estimated": estimated is not None, "refined": refined is not None,
        "camera": dict(zip(capture.names, sides.camera.tolist())),
        "camera_sd": dict(zip(capture.names, _together([sure.camera for sure in told]))) if told else None,
        "log_exposure_sd": dict(zip(capture.names, _together([sure.log_exposure for sure in told]))) if told
        else None,
        "flash_offset": offset, "flash_offset_sd": None if flash is None else flash.tolist(),
        "light_power": float(sides.intensity.mean()),
        "power_told": light_power_factor, "log_power_sd": POWER if estimated
        or capture.calibration == "photos" else None}


def _together(deviations: list[Tensor]) -> list:
    """Standard deviations of sums of independent numbers."""
    return torch.stack(deviations).square().sum(dim=0).sqrt().tolist()


def about_views(calibration: Mapping) -> str:
    """Where the views of a fit come from and how sure they are, in a sentence or two; empty of fits that do
    not say.

    Args:
        calibration: see :func:`mitsvbrdf.fit.view_record.views_record`.
    """
    if not calibration:
        return ""
    said = FROM["estimated" if calibration["estimated"] else calibration["from"]]
    said += ", refined by the fit." if calibration["refined"] else "."
    if calibration["camera_sd"]:
        x, y, z = (statistics.median(place) for place in zip(*calibration["camera_sd"].values()))
        exposure = math.exp(statistics.median(calibration["log_exposure_sd"].values())) - 1
        said += (f" Standard deviations (median, in patch sides): cameras ({x:.3f}, {y:.3f}, {z:.3f}), "
                 f"light of a photo beside the others {exposure:.1%}")
        if calibration["flash_offset_sd"]:
            said += ", flash offset ({:.3f}, {:.3f})".format(*calibration["flash_offset_sd"])
        said += "; they count what the photos tell, not what the model lacks."
    if calibration["log_power_sd"]:
        said += (" The light power of all photos is known to a factor of "
                 f"{math.exp(calibration['log_power_sd']):.1f}, and "
                 "so are the diffuse and the specular map: it is what makes the material a usual one.")
    return said
