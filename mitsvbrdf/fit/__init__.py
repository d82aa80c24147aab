"""From a capture to a :class:`FitResult`: four methods behind one function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from ..capture import Capture
from ..errors import ConfigError
from ..io.entry import entry
from ..io.profile import profile_summary, profiled
from ..material.maps import SVBRDF
from ..measure.rerender import rerender
from ..render import Renderer
from ..views import Views, shift_lights
from .confidence import deviations
from .config import DirectConfig, FitConfig, HierarchicalConfig, HybridConfig
from .gan_config import GanConfig
from .light_power import light_power_told, with_light_power
from .live import Live, LiveState
from .loop import Loop
from .methods import make_method
from .omitted import omitted_by, used
from .result import FitResult
from .task import FitTask, fit_task
from .view_record import views_record
from .warnings import fit_warnings


@entry(gradients=True)
def fit_svbrdf(capture: Capture, renderer: Renderer, config: FitConfig | None = None, *,
               checkpoint: Path | None = None, resume: Path | None = None,
               report: Callable[[dict, float], None] | None = None,
               live: Callable[[LiveState], None] | None = None) -> FitResult:
    """Recover a material from photos.

    Args:
        capture: photos and views. Where it has none, they are estimated from the photos first, but for the
            paper's method (:mod:`mitsvbrdf.calibrate.estimate`); of one or two photos the default geometry
            stays.
        renderer: carries the gradients and draws the comparison.
        config: which method and its settings; left out, ``HierarchicalConfig()``.
        checkpoint: file (.safetensors) to keep the running state in.
        resume: checkpoint to continue from; bit-equal to an uninterrupted run of the same options on a CPU.
        report: called with (trace entry, share done) after each measurement.
        live: called with the state of the fit about once a second, such as
            :class:`mitsvbrdf.report.live.LivePage`. The fit gives identical results without it.

    Returns:
        The result with the lowest re-rendering error met (``hierarchical``: the last); Ctrl-C ends the fit
        early with it.

    Raises:
        ConfigError: options out of range, or a checkpoint of another fit.
    """
    config = (config or HierarchicalConfig()).limited()
    config.check()
    stated = capture.notes
    with profiled("setting up"):
        task = fit_task(capture, renderer, config)
        capture, method = task.capture, make_method(task)
    loop = Loop(method, capture, renderer, config, checkpoint, report, Live(live) if live else None)
    if resume:
        loop.resume(resume)
    stopped = loop.run()
    assert loop.best is not None
    _, svbrdf, views = loop.best
    images, total, each = rerender(renderer, svbrdf, views, capture)
    with profiled("uncertainty"):
        spreads = deviations(svbrdf, views, images, task)
        told = light_power_told(svbrdf, spreads) if task.light_power_unknown else None
        if told:
            svbrdf, views = with_light_power(svbrdf, told), replace(views, intensity=views.intensity * told)
            images, total, each = rerender(renderer, svbrdf, views, capture)
            spreads = deviations(svbrdf, views, images, task)
    # Of all photos: where each has a camera and a flash of its own besides, they move around what is common.
    moved = (views.light - views.camera) - (capture.views.light - capture.views.camera)
    offset = moved.mean(dim=0)[:2].tolist() if method.fits_offset else None
    result = FitResult(
        svbrdf=svbrdf, views=views, guess=task.guess, rerendered=images, rerender_rmse=total, per_photo=each,
        calibrated_rmse=_calibrated_rmse(svbrdf, views, capture, renderer, moved.mean(dim=0), told),
        trace=loop.trace, config=config, renderer=renderer.name, variant=renderer.variant,
        omitted=(*omitted_by(task, views), *method.omitted), used=tuple(used(task)), stopped=stopped,
        undone=tuple(loop.undone), restarts=tuple(loop.restarts), deviations=spreads,
        flash_offset=tuple(offset) if offset else None, profile=profile_summary(),
        calibration=views_record(capture, views, task.estimated, *method.views_deviation, told))
    return replace(result, warnings=(*capture.notes[len(stated):], *fit_warnings(result, capture)))


def _calibrated_rmse(svbrdf: SVBRDF, views: Views, capture: Capture, renderer: Renderer, offset: Tensor,
                     told: float | None) -> float | None:
    """The error with stated views and what all photos share; None where the fit moved no view by itself, or
    none is stated.
    """
    given = capture.views
    x, y = (offset[:2] / given.size).tolist()
    stated = replace(shift_lights(given, (x, y)), intensity=given.intensity * (told or 1.0))
    pairs = ((stated.camera, views.camera), (stated.light, views.light), (stated.intensity, views.intensity))
    if not capture.calibrated or all(torch.allclose(one, other.to(one.dtype), rtol=1e-6)
                                     for one, other in pairs):
        return None
    return rerender(renderer, svbrdf, stated, capture)[1]


@entry(gradients=True)
def pretrain(capture: Capture, renderer: Renderer, config: GanConfig, checkpoint: Path,
             report: Callable[[dict, float], None] | None = None) -> None:
    """The paper's first stage (III.F): train the generator on one picture and keep its weights in
    ``checkpoint``.

    Args:
        capture: its first photo is used.
        config: of one of the paper's presets; ``iterations`` defaults to the paper's 10,000.

    Raises:
        ConfigError: another preset, or a checkpoint to start from.
    """
    if not config.of_paper or config.pretrained:
        raise ConfigError("a preset of the paper, from untrained weights",
                          f"preset {config.preset}" + (f" from {config.pretrained}" if config.pretrained
                                                       else ""),
                          'give GanConfig(preset="paper-one-stage", ...) without pretrained')
    config = replace(config, preset="paper-one-stage",
                     iterations=config.iterations or (None if config.budget else 10_000))
    one = capture.pick(capture.index[:1])
    Loop(make_method(FitTask(one, renderer, config)), one, renderer, config, checkpoint, report).run()


__all__ = ["DirectConfig", "FitConfig", "FitResult", "FitTask", "GanConfig", "HierarchicalConfig",
           "HybridConfig",
           "fit_svbrdf", "make_method", "pretrain"]
