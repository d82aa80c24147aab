"""What a fit leaves on disk."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from torch import Tensor

from .. import color, files
from ..capture import Capture
from ..errors import OutputError
from ..evaluate.burn_in import burn_in
from ..export.mitsuba import write_scene
from ..fit.confidence import confidence
from ..fit.result import FitResult
from ..maps import save_maps
from ..progress import say
from ..provenance import machine, versions
from .fit_page import keep_photos, write_report
from .sheet import loss_curve, write_sheet

SCHEMA_VERSION = 1
METHODS = {"HierarchicalConfig": "hierarchical", "HybridConfig": "hybrid", "GanConfig": "gan", "DirectConfig": "direct"}


def write_fit(result: FitResult, capture: Capture, out: str | Path, command: dict | None = None,
              left_out: Capture | None = None) -> None:
    """Write a fit: maps, their uncertainty, guess, photos and re-renderings, sheet, curve, Mitsuba scene, ``fit.json``, page.

    Args:
        result: what :func:`mitsvbrdf.fit.fit_svbrdf` gave.
        capture: the photos it was fitted to.
        out: the folder, made when missing.
        command: options of the command line, kept in ``fit.json``.
        left_out: photos that the fit did not use, for the page to predict; see :func:`.fit_page.write_report`.

    Raises:
        OutputError: ``out`` cannot be written, or its ``photos/`` is where the capture came from.
    """
    out = Path(out)
    keep_photos(out, capture)
    save_maps(result.svbrdf, out / "maps")
    write_linear(out / "guess" / "diffuse", result.guess, "srgb")
    for name, spread in result.deviations.items():
        files.write_exr(out / "uncertainty" / f"{name}.exr", spread.square().mean(dim=-1, keepdim=True).sqrt())
    for name, image in zip(capture.names, result.rerendered):
        write_linear(out / "rerendered" / name, image, capture.transfer)
    method = METHODS[type(result.config).__name__]
    title = f"{capture.source.name if capture.source else 'capture'}: {method}, {result.svbrdf.bsdf}"
    sure = confidence(result.deviations)
    remarks = {name: f"{sure[name]['determined_share']:.0%} determined" if name in sure else "held fixed"
               for name in result.svbrdf.maps}
    title = title.encode(errors="replace").decode()  # of a folder whose name is not UTF-8
    write_sheet(out / "sheet.png", result.svbrdf, capture.photos,
                color.to_display(result.rerendered, capture.transfer), rmse=result.rerender_rmse,
                per_photo=result.per_photo, guess=result.guess, names=capture.names, title=title,
                remarks=remarks)
    loss_curve(out / "curve.svg", result.trace)
    write_scene(out, result.svbrdf, result.views)
    files.write_json(out / "fit.json", fit_record(result, capture, command or {}))
    (out / "report.json").unlink(missing_ok=True)  # photos that an earlier fit left out are none of this one's
    try:
        write_report(out, quick=True, left_out=left_out)
    except OutputError:
        raise
    except Exception as reason:  # whatever it is: the result of a long fit is worth more than its page
        say(f"report.html could not be made ({type(reason).__name__}: {reason}); `mitsvbrdf report` tries again")


def write_linear(stem: Path, image: Tensor, transfer: color.Transfer) -> None:
    """A linear image as ``stem.exr`` (float32) and as ``stem.png`` (8-bit display values)."""
    files.write_exr(stem.with_suffix(".exr"), image)
    files.write_png(stem.with_suffix(".png"), color.to_display(image, transfer))


def fit_record(result: FitResult, capture: Capture, command: dict) -> dict:
    """Everything about a fit that fits into JSON; ``docs/formats.md`` explains each field."""
    views = result.views
    offset = result.flash_offset
    return {
        "schema_version": SCHEMA_VERSION,
        "method": METHODS[type(result.config).__name__],
        "renderer": result.renderer, "variant": result.variant, "bsdf": result.svbrdf.bsdf,
        "rerender_rmse": result.rerender_rmse,
        "per_photo": dict(zip(capture.names, result.per_photo)),
        "confidence": confidence(result.deviations), "burn_in": burn_in(result.svbrdf, views),
        "warnings": list(result.warnings),
        "stopped": result.stopped, "undone_steps": len(result.undone), "undone": list(result.undone),
        "restarts": list(result.restarts),
        "seconds": result.trace[-1]["seconds"], "iterations": result.trace[-1]["iteration"],
        "seed": result.config.seed, "config": asdict(result.config), "command": command,
        "left_out": [{"what": what, "why": why} for what, why in result.left_out],
        "capture": {"name": capture.source.name if capture.source else None, "photos": list(capture.index),
                    "resolution": capture.resolution, "transfer": capture.transfer,
                    "calibrated": capture.calibrated, "notes": list(capture.notes)},
        "views": {"size": views.size, "falloff": views.falloff, "camera": views.camera.tolist(),
                  "light": views.light.tolist(), "intensity": views.intensity.tolist()},
        "flash_offset": None if offset is None else {"x": offset[0] / views.size, "y": offset[1] / views.size,
                                                     "unit": "patch sides"},
        "calibration": result.calibration,
        **({"profile": result.profile} if result.profile else {}),
        "versions": versions(),
        "machine": machine(),
        "trace": result.trace,
    }
