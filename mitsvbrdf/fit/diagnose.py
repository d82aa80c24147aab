"""What is known of a fit once its loop has ended: light power, errors, uncertainty, views, warnings."""

import math
import statistics
from collections.abc import Mapping
from dataclasses import asdict, replace

import torch
from torch import Tensor

from ..calibrate.estimate import ESTIMATED, POWER, EstimatedViews
from ..calibrate.refine import CHANGE
from ..capture import Capture
from ..errors import BackendError
from ..io.provenance import machine, versions
from ..material.maps import COLOURS, SVBRDF
from ..measure.burn_in import burn_in, local_burn_in
from ..measure.rerender import Rerendered, rerender_errors, rerendered
from ..render.needs import Omitted
from ..views import Views, shift_lights
from .confidence import UNKNOWN, Deviations, confidence, deviations, shown_texels
from .hierarchical.rounds import Hierarchical
from .light_power import light_power_told, with_light_power
from .loop import Loop
from .methods import method_name
from .omitted import omitted_by, used
from .record import FROM, SCHEMA_VERSION
from .result import Fit
from .solved_gan import SolvedGan
from .task import FitTask
from .warnings import MIXED, SAMPLED, UNSETTLED, fit_warnings


def diagnosed(task: FitTask, loop: Loop, stopped: str, notes: tuple[str, ...]) -> Fit:
    """The fit from a loop that has ended. ``notes``: those of the capture before views were estimated."""
    method = loop.method
    task = replace(task, capture=method.capture, own_guess=task.guess)
    capture, renderer, config = task.capture, task.renderer, task.config
    assert loop.best is not None
    _, svbrdf, views = loop.best
    solver = method.solvers[0] if isinstance(method, SolvedGan) else method
    basis, own, shown = None, task, shown_texels(capture)
    if isinstance(solver, Hierarchical):
        basis, own = solver.scales.basis, replace(solver.task, capture=capture, own_guess=solver.task.guess)
    seen, spreads, alike = _looked_at(svbrdf, views, own, basis)
    told = light_power_told(svbrdf, alike or spreads, shown) if task.light_power_unknown else None
    if told:
        svbrdf, views = with_light_power(svbrdf, told), replace(views, intensity=views.intensity * told)
        seen, spreads, alike = _looked_at(svbrdf, views, own, basis)
    # The mean over all photos: cameras and flashes of single photos may move around this common offset.
    moved = (views.light - views.camera) - (capture.views.light - capture.views.camera)
    x, y = (moved.mean(dim=0)[:2] / views.size).tolist()
    calibration = views_record(capture, views, task.estimated, *method.views_deviation, told)
    stated = _stated_views(capture, views, (x, y), told)
    calibrated_rmse = rerender_errors(renderer, svbrdf, stated, capture)[0] if stated else None
    record = {"schema_version": SCHEMA_VERSION, "method": method_name(config),
        "renderer": renderer.name, "variant": renderer.variant, "bsdf": svbrdf.bsdf,
        "rerender_rmse": seen.total, "per_photo": dict(zip(capture.names, seen.each)),
        "calibrated_rmse": calibrated_rmse,
        "confidence": confidence(spreads, alike, shown), "burn_in": burn_in(svbrdf, views),
        "local_burn_in": local_burn_in(svbrdf, views), "warnings": [],
        "stopped": stopped, "undone_steps": len(loop.undone), "undone": list(loop.undone),
        "seconds": loop.trace[-1]["seconds"], "iterations": loop.trace[-1]["iteration"],
        "seed": config.seed, "config": asdict(config) | {"fix": list(config.fix)}, "command": {},
        "omitted": [each._asdict() for each in (*omitted_by(task, views), *method.omitted, *(
            [] if spreads else [Omitted("deviations", "no Mitsuba")]))],
        "used": [{"what": what, "how": how} for what, how in used(task)
                 if not isinstance(method, SolvedGan) or method.game],
        "capture": {"name": capture.name or None, "photos": list(capture.index),
                    "resolution": capture.resolution, "transfer": capture.transfer,
                    "calibrated": capture.calibrated, "notes": list(capture.notes)},
        "views": {"size": views.size, "falloff": views.falloff, "camera": views.camera.tolist(),
                  "light": views.light.tolist(), "intensity": views.intensity.tolist()},
        "flash_offset": {"x": x, "y": y, "unit": "patch sides"} if method.fits_offset else None,
        "calibration": calibration,
        **({"repeats": task.repeats._asdict()} if task.repeats else {}),
        "versions": versions(), "machine": machine(), "trace": loop.trace}
    fit = Fit(record, known={"svbrdf": svbrdf, "views": views, "guess": task.guess, "shots": capture,
                             "sample": seen.sample, "deviations": spreads, "config": config, "detail": None,
                             "deviations_with_look_alikes": alike, "seen_by": renderer,
                             **({} if seen.images is None else {"rerendered": seen.images})})
    said: tuple[str, ...] = (task.repeats.said(),) if task.repeats else ()
    if isinstance(solver, Hierarchical) and stopped != "interrupted" and solver.averages_mix():
        said += (MIXED.format(capture.resolution),)
    unsettled = isinstance(method, SolvedGan) and (method.answer is None or method.cut_short)
    said += (UNSETTLED,) if unsettled and loop.iteration else ()
    return fit.but(warnings=(*capture.notes[len(notes):], *said, *fit_warnings(fit, capture)))


def _looked_at(svbrdf: SVBRDF, views: Views, task: FitTask, basis: Tensor | None
               ) -> tuple[Rerendered, Deviations, Deviations]:
    """Re-rendered photos with their errors; deviations by own photos; deviations with look-alikes."""
    seen = rerendered(task.renderer, svbrdf, views, task.capture, SAMPLED)
    try:
        both = deviations(svbrdf, views, task, basis)
    except BackendError:  # deviations need Mitsuba; the analytic renderer does not
        both = {}, {}
    if task.light_doubted:  # an unknown light leaves colours unknown
        for spreads in both:
            spreads |= {name: torch.full_like(spreads[name], UNKNOWN) for name in COLOURS if name in spreads}
    return seen, *both


def _stated_views(capture: Capture, views: Views, offset: tuple[float, float],
                  told: float | None) -> Views | None:
    """The stated views with the changes common to all; None if no view moved otherwise, or none is stated."""
    given = capture.views
    stated = replace(shift_lights(given, offset), intensity=given.intensity * (told or 1.0))
    pairs = ((stated.camera, views.camera), (stated.light, views.light), (stated.intensity, views.intensity))
    moved = any(not torch.allclose(one, other.to(one.dtype), rtol=1e-6) for one, other in pairs)
    return stated if capture.calibrated and moved else None


def views_record(capture: Capture, views: Views, estimated: EstimatedViews | None, refined: Tensor | None,
                 flash: Tensor | None, light_power_factor: float | None = None) -> dict:
    """Views of a fit and their standard deviations, in patch sides, for ``fit.json`` (docs/formats.md).

    Args:
        capture: the photos, with the views that the fit began with.
        estimated: the estimate of these views from the photos; None if they were stated.
        refined: standard deviations N x 7 of the fit's changes (:data:`mitsvbrdf.calibrate.refine.CHANGE`).
        flash: standard deviations (x, y) of the flash offset that all photos share; None if not fitted.
        light_power_factor: factor on the light power, found from the maps; None if there is none.
    """
    sides, begun = views.in_patch_sides(), capture.views.in_patch_sides()
    told = [ESTIMATED.unpack(estimated.deviation)] if estimated else []
    told += [CHANGE.unpack(refined)] if refined is not None else []
    offset = ((sides.light - sides.camera) - (begun.light - begun.camera)).mean(dim=0)[:2].tolist()
    moved = refined is not None or not torch.allclose(sides.camera.double(), begun.camera.double())
    return {"from": capture.calibration, "estimated": estimated is not None, "refined": moved,
        "camera": dict(zip(capture.names, sides.camera.tolist())),
        "camera_sd": dict(zip(capture.names, _together([sure.camera for sure in told]))) if told else None,
        "log_exposure_sd": dict(zip(capture.names, _together([sure.log_exposure for sure in told]))) if told
        else None, "flash_offset": offset, "flash_offset_sd": None if flash is None else flash.tolist(),
        "light_power": float(sides.intensity.mean()),
        "power_told": light_power_factor, "log_power_sd": POWER if estimated
        or capture.calibration == "photos" else None}


def _together(deviations: list[Tensor]) -> list:
    """Standard deviations of sums of independent numbers."""
    return torch.stack(deviations).square().sum(dim=0).sqrt().tolist()


def about_views(calibration: Mapping) -> str:
    """Origin and uncertainty of the views of :func:`views_record`, in words; empty if unknown."""
    if not calibration:
        return ""
    said = FROM["estimated" if calibration["estimated"] else calibration["from"]]
    said += ", refined by the fit." if calibration["refined"] else "."
    if calibration.get("camera_sd"):
        x, y, z = (statistics.median(place) for place in zip(*calibration["camera_sd"].values()))
        exposure = math.exp(statistics.median(calibration["log_exposure_sd"].values())) - 1
        said += (f" Standard deviations (median, in patch sides): cameras ({x:.3f}, {y:.3f}, {z:.3f}), "
                 f"light of a photo relative to the others {exposure:.1%}")
        if calibration.get("flash_offset_sd"):
            said += ", flash offset ({:.3f}, {:.3f})".format(*calibration["flash_offset_sd"])
        said += "; they include what the photos leave open, not errors of the model."
    if calibration.get("log_power_sd"):
        said += (" The light power of all photos is known to a factor of "
                 f"{math.exp(calibration['log_power_sd']):.1f}, and "
                 "so are the diffuse and the specular map: it was chosen so that F0 and albedo are usual.")
    return said
