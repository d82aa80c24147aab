"""The loop all methods share: limits, trace, best result, checkpoints, undoing bad steps, Ctrl-C."""

from __future__ import annotations

import hashlib
import math
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor

from ..capture import Capture
from ..errors import ConfigError
from ..maps import SVBRDF
from ..metrics import photo_rmse
from ..render import Renderer
from ..views import Views
from .checkpoint import load_tensors, save_tensors
from .config import FitConfig

EVALUATE_EVERY = 10  # iterations; a fixed count, so that a resumed run keeps the same best result
CHECKPOINT_SECONDS = 30.0
MAX_UNDONE = 20


class Method(Protocol):
    """One way to fit, advanced step by step. Its whole running state is named tensors."""

    views: Views

    def step(self, progress: float) -> dict[str, float]:
        """One iteration at this share (0 to 1) of the run; returns each loss, unweighted."""
        ...

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The present material and views, detached."""
        ...

    def state(self) -> dict[str, Tensor]:
        """Everything a later :meth:`load_state` needs to go on bit by bit."""
        ...

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Continue from a saved state."""
        ...

    def cut_step(self) -> None:
        """Halve the step size, after a step was undone."""
        ...


class Loop:
    """Runs a method within its limits.

    Args:
        method: what to advance.
        capture: the photos to compare with.
        renderer: renders the comparison.
        config: limits and seed.
        checkpoint: file to save the state to now and then, and at the end; None saves nothing.
        report: called after each measurement with the trace entry and the share done (0 to 1).
    """

    def __init__(self, method: Method, capture: Capture, renderer: Renderer, config: FitConfig,
                 checkpoint: Path | None = None, report: Callable[[dict, float], None] | None = None) -> None:
        self.method, self.capture, self.renderer, self.config = method, capture, renderer, config.limited()
        self.checkpoint, self.report = checkpoint, report
        self.iteration, self.seconds, self.undone = 0, 0.0, 0
        self.trace: list[dict] = []
        self.best: tuple[float, SVBRDF, Views] | None = None

    def run(self) -> str:
        """Advance until a limit or Ctrl-C; returns "budget", "iterations" or "interrupted"."""
        stop: list[int] = []

        def asked_to_stop(*_: object) -> None:
            if len(stop) > 1:
                raise KeyboardInterrupt  # asked three times: at once
            stop.append(1)

        listens = (threading.current_thread() is threading.main_thread()
                   and signal.getsignal(signal.SIGINT) is signal.default_int_handler)
        if listens:
            signal.signal(signal.SIGINT, asked_to_stop)
            terminate = signal.signal(signal.SIGTERM, asked_to_stop)
        started, saved = time.perf_counter() - self.seconds, time.perf_counter()
        good, losses = None, dict[str, float]()
        try:
            if self.iteration == 0:
                self._measure({})
            while True:
                self.seconds = time.perf_counter() - started
                why = "interrupted" if stop else self._limit_reached()
                if why:
                    break
                if good is None or self.iteration % EVALUATE_EVERY == 0:
                    good = self.method.state()
                losses = self.method.step(self.progress)
                if not all(map(math.isfinite, losses.values())):
                    good = self._undo(good)
                    continue
                losses.pop("gradient", None)
                self.iteration += 1
                if self.iteration % EVALUATE_EVERY == 0:
                    self.seconds = time.perf_counter() - started
                    self._measure(losses)
                if self.checkpoint and time.perf_counter() - saved > CHECKPOINT_SECONDS:
                    self.save()
                    saved = time.perf_counter()
        finally:
            if listens:
                signal.signal(signal.SIGINT, signal.default_int_handler)
                signal.signal(signal.SIGTERM, terminate)
        if self.checkpoint:
            self.save()
        if self.iteration % EVALUATE_EVERY:
            self._measure(losses)
        return why

    @property
    def progress(self) -> float:
        """Share of the run that is done, by whichever limit is nearer."""
        shares = [self.iteration / self.config.iterations] if self.config.iterations else []
        shares += [self.seconds / self.config.budget] if self.config.budget else []
        return min(max(shares), 1.0)

    def _limit_reached(self) -> str | None:
        if self.config.iterations and self.iteration >= self.config.iterations:
            return "iterations"
        return "budget" if self.config.budget and self.seconds >= self.config.budget else None

    def _undo(self, good: dict[str, Tensor]) -> dict[str, Tensor]:
        self.undone += 1
        if self.undone > MAX_UNDONE:
            raise ConfigError("a fit that stays finite", f"{self.undone} steps that did not",
                              "lower the learning rate or check the photos and their calibration")
        self.method.load_state(good)
        self.method.cut_step()
        return self.method.state()  # with the smaller step, in case it has to be cut again

    def _measure(self, losses: dict[str, float]) -> None:
        svbrdf, views = self.method.estimate()
        rmse = rerender(self.renderer, svbrdf, views, self.capture)[1]
        if self.best is None or rmse < self.best[0]:
            self.best = rmse, svbrdf, views
        entry = {"seconds": round(self.seconds, 3), "iteration": self.iteration, **losses, "rerender_rmse": rmse}
        self.trace.append(entry)
        if self.report:
            self.report(entry, self.progress)

    def _task(self) -> str:
        """A fingerprint of everything that shapes the fit but its limits."""
        settings = {k: v for k, v in asdict(self.config).items() if k not in ("iterations", "budget")}
        views = self.capture.views
        digest = hashlib.sha256(repr((settings, self.renderer.name, self.capture.transfer, views.size, views.falloff)).encode())
        for tensor in (self.capture.photos, views.camera, views.light, views.intensity):
            digest.update(tensor.numpy().tobytes())
        return digest.hexdigest()

    def save(self) -> None:
        """Write the checkpoint: tensors only, with the trace as text in its header."""
        assert self.checkpoint is not None
        rmse, svbrdf, views = self.best or (math.inf, *self.method.estimate())
        tensors = {f"method.{k}": v for k, v in self.method.state().items()}
        tensors |= {f"best.{k}": v for k, v in svbrdf.maps.items()}
        tensors |= {"best_views.camera": views.camera, "best_views.light": views.light}
        note = {"iteration": self.iteration, "seconds": self.seconds, "undone": self.undone, "best_rmse": rmse,
                "trace": self.trace, "method": type(self.method).__name__, "bsdf": svbrdf.bsdf,
                "task": self._task()}
        save_tensors(self.checkpoint, tensors, note)

    def resume(self, path: Path) -> None:
        """Continue from a checkpoint of the same method and size.

        Raises:
            ConfigError: it is none, or of another kind of fit.
        """
        tensors, note = load_tensors(path)
        if note.get("method") != type(self.method).__name__ or note.get("bsdf") != self.config.bsdf:
            raise ConfigError(f"a checkpoint of {type(self.method).__name__} / {self.config.bsdf}",
                              f"{note.get('method')} / {note.get('bsdf')} in {path}", "resume with the same options")
        if note.get("task") != self._task():
            raise ConfigError("the photos, views, renderer and options of the first run", f"others than {path} was made with",
                              "resume with the same ones; only --iterations and --budget may change")
        try:
            self.method.load_state({k[7:]: v for k, v in tensors.items() if k.startswith("method.")})
        except (KeyError, RuntimeError, ValueError) as reason:
            raise ConfigError("a checkpoint of the same options", f"{path}: {str(reason).splitlines()[0]}",
                              "resume with the options of the first run") from None
        maps = {k[5:]: v for k, v in tensors.items() if k.startswith("best.")}
        views = self.method.views
        views = type(views)(tensors["best_views.camera"], tensors["best_views.light"], views.intensity, views.size,
                            views.falloff)
        self.best = note["best_rmse"], SVBRDF(self.config.bsdf, maps), views
        self.iteration, self.seconds, self.undone = note["iteration"], note["seconds"], note["undone"]
        self.trace = note["trace"]


def rerender(renderer: Renderer, svbrdf: SVBRDF, views: Views, capture: Capture) -> tuple[Tensor, float, list[float]]:
    """The material rendered for the capture's photos: linear images, RMSE over all, RMSE of each (display values)."""
    with torch.no_grad():
        images = renderer.render(svbrdf, views)
    return images, *photo_rmse(images, capture.photos, capture.transfer)


def descend(total: Tensor, *optimizers: torch.optim.Optimizer) -> float:
    """One step of each optimiser down the gradient of ``total``, unless that gradient is not finite.

    Returns:
        0, or NaN where no step was made: logged as a loss, it makes the loop undo.
    """
    for optimizer in optimizers:
        optimizer.zero_grad(set_to_none=True)
    total.backward()
    gradients = [p.grad for o in optimizers for group in o.param_groups for p in group["params"] if p.grad is not None]
    if not math.isfinite(sum(float(g.sum()) for g in gradients)):
        return math.nan
    for optimizer in optimizers:
        optimizer.step()
    return 0.0


def cosine(progress: float, floor: float = 0.02) -> float:
    """Falls from 1 to ``floor`` along half a cosine."""
    return floor + (1 - floor) * (1 + math.cos(math.pi * progress)) / 2
