"""From a capture to a :class:`Fit`: four methods behind one function."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..capture import Capture
from ..errors import CaptureError, ConfigError
from ..io.entry import entry
from ..render import Renderer
from .config import DirectConfig, FitConfig, HierarchicalConfig, HybridConfig
from .diagnose import diagnosed
from .direct import Direct
from .gan_config import FIRST_STAGE, GanConfig
from .generator.gan import Gan
from .generator.hybrid import Hybrid
from .live import Live, LiveState
from .loop import Loop
from .method import Method
from .methods import method_name
from .result import Fit
from .solved_gan import SolvedGan, solver_of
from .task import FitTask, fit_task


@entry(gradients=True)
def fit_svbrdf(capture: Capture, renderer: Renderer, config: FitConfig | None = None, *,
               checkpoint: Path | None = None, resume: Path | None = None,
               report: Callable[[dict, float], None] | None = None,
               live: Callable[[LiveState], None] | None = None) -> Fit:
    """Recover a material from photos.

    Args:
        capture: photos and views. Missing views are first estimated from the photos, unless ``config`` holds
            them fixed (:mod:`mitsvbrdf.calibrate.estimate`). One or two photos get the default geometry.
        renderer: renders the images compared with photos; all methods but ``hierarchical`` use its gradients.
        config: the settings of a method, which choose it. Default: ``HierarchicalConfig()``.
        checkpoint: file (.safetensors) for the running state.
        resume: checkpoint to continue from; bit-equal to an uninterrupted run of the same options on a CPU.
            A fit that lacked time begins anew if ``budget`` or ``iterations`` has at least doubled.
        report: called with (trace entry, share done) after each measurement.
        live: called with the state of the fit about once a second. :class:`mitsvbrdf.report.live.LivePage` is
            an example. The fit gives identical results without it.

    Returns:
        The result with the lowest re-rendering error so far (``hierarchical``, ``gan`` from solved maps: the
        last result). Ctrl-C ends the fit early and returns the result so far.

    Raises:
        CaptureError: all pixels of all photos are masked.
        ConfigError: options out of range, a checkpoint of another fit, or a start that is not finite.
        BackendError: Mitsuba, the variant or libLLVM is missing.
        KeyboardInterrupt: Ctrl-C in a resumed fit that began anew; the earlier result stays.
    """
    config = (config or HierarchicalConfig()).limited(capture.resolution)
    config.check()
    if capture.measured is not None and not capture.measured.any():
        raise CaptureError("photos that show something", "a mask that hides all pixels", "check the mask")
    task = fit_task(capture, renderer, config)
    method = make_method(task)
    loop = Loop(method, checkpoint, report, Live(live) if live else None)
    if resume:
        loop.resume(resume)
    stopped = loop.run()
    if loop.anew and stopped == "interrupted":
        raise KeyboardInterrupt
    method.end()
    return diagnosed(task, loop, stopped, capture.notes)


@entry(gradients=True)
def pretrain(capture: Capture, renderer: Renderer, config: GanConfig, checkpoint: Path,
             report: Callable[[dict, float], None] | None = None) -> str:
    """Train the generator on one picture, the paper's first stage (III.F); returns :attr:`Fit.stopped`.

    Args:
        capture: its first photo is used.
        config: settings with one of the paper's presets; ``iterations`` defaults to the paper's 10,000.
        checkpoint: file (.safetensors) for the weights. ``report``: as in :func:`fit_svbrdf`.

    Raises:
        ConfigError: settings out of range, a preset that is not the paper's, or ``pretrained`` is given.
    """
    config.check()
    if not config.of_paper or config.pretrained:
        raise ConfigError("a preset of the paper, from untrained weights",
                          f"preset {config.preset}, pretrained {config.pretrained}",
                          'give GanConfig(preset="paper-one-stage", ...) without pretrained')
    config = replace(config, preset="paper-one-stage",
                     iterations=config.iterations or (None if config.budget else FIRST_STAGE))
    one = capture.pick(capture.index[:1])
    return Loop(make_method(FitTask(one, renderer, config)), checkpoint, report).run()


def make_method(task: FitTask[Any]) -> Method:
    """The method of a task, ready to step. ConfigError: the task's settings belong to no method."""
    match method_name(task.config):
        case "hierarchical":
            return solver_of(task)
        case "gan":
            return SolvedGan(task) if task.config.begins == "solved" else Gan(task)
        case "hybrid":
            return Hybrid(task)
    return Direct(task)


FitResult = Fit  # its name in version 1; version 2.1 drops it

__all__ = ["DirectConfig", "Fit", "FitConfig", "FitResult", "FitTask", "GanConfig", "HierarchicalConfig",
           "HybridConfig", "fit_svbrdf", "make_method", "pretrain"]
