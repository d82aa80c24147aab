"""The loop of all methods: limits, trace, best result, checkpoints, undoing of bad steps, Ctrl-C."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from torch import Tensor

from ..errors import ConfigError, MitsvbrdfError, NotFiniteError
from ..io.json import NUMBER, shape_error
from ..io.signals import stop_signals
from ..material.maps import SVBRDF, finite
from ..measure.rerender import rerender_errors
from ..views import Views
from .checkpoint import differing, fingerprints, load_tensors, part, save_tensors
from .live import SIDE, Live, LiveState
from .method import Method
from .methods import method_name
from .warnings import about_photos, about_steps

CHECKPOINT_SECONDS = 30.0
MAX_UNDONE = 20
# types of a checkpoint's note, beside its tensors
NOTE = {"iteration": int, "seconds": NUMBER, "undone": [{"iteration": int, "reason": str}],
        "best_rmse": NUMBER, "trace": [{str: NUMBER}], "lacked": [NUMBER]}

Seen = tuple[float, SVBRDF, Views]  # re-rendering error, material and views of a state


class Loop:
    """Runs a method within its limits.

    Args:
        checkpoint: file for the state, saved every 30 s and at the end; None: nothing is saved.
        report: called after each measurement with the trace entry and the share done (0 to 1).
        live: shows the fit while it runs; None: nothing is shown.
    """

    def __init__(self, method: Method, checkpoint: Path | None = None,
                 report: Callable[[dict, float], None] | None = None, live: Live | None = None) -> None:
        self.method, self.capture, self.renderer = method, method.capture, method.renderer
        self.config = method.config.limited(self.capture.resolution)
        self.checkpoint, self.report, self.live = checkpoint, report, live
        self.iteration, self.seconds = 0, 0.0
        self.undone: list[dict] = []  # iteration and reason of each undone step
        self.trace: list[dict] = []
        self.seen: Seen  # at the latest measurement
        self.best: Seen | None = None
        self.anew = False  # whether a resumed fit starts from the beginning
        self.whole = False  # whether the latest measurement was of all texels

    def run(self) -> str:
        """Advance until a limit or Ctrl-C; returns why it ended, a value of :attr:`Fit.stopped`."""
        with stop_signals() as stop:
            self.started, saved = time.perf_counter() - self.seconds, time.perf_counter()
            if self.iteration == 0:
                self._begin()
            good, losses = self.method.state(), dict[str, float]()
            while True:
                self.seconds = time.perf_counter() - self.started
                why = "interrupted" if stop else self._limit_reached()
                if why:
                    break
                if self.live:
                    self.live.offer(self._state)
                good, losses = self._advance(good)
                if self.checkpoint and time.perf_counter() - saved > CHECKPOINT_SECONDS:
                    self.save()
                    saved = time.perf_counter()
        why = "interrupted" if stop else why  # Ctrl-C may have come since we looked
        self.method.ended = True
        off_beat = self.iteration % self.method.measured_every > 0 or not self.whole
        if off_beat:
            good, losses, seen = self._checked(good, losses, whole=True)
            self.seconds = time.perf_counter() - self.started
        if self.checkpoint:
            self.save()
        if off_beat:
            self._record(seen, losses)
        if self.live:
            self.live.offer(lambda: self._state(why), ended=True)
        return why

    def _begin(self) -> None:
        seen = self._look()
        if isinstance(seen, str):
            raise ConfigError("photos and views that give a finite start", seen,
                              "check the photos and their calibration")
        self._record(seen, {})

    def _advance(self, good: dict[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, float]]:
        """One step; if its result is not finite, the method goes back to the state ``good``.

        Returns the state to go back to next time, and the losses.
        """
        try:
            losses = self.method.step(self.progress)
        except NotFiniteError as error:
            return self._undo(good, error.got), {}
        broken = [name for name, value in losses.items() if not math.isfinite(value)]
        if broken:
            return self._undo(good, f"{broken[-1]} not finite"), {}
        losses.pop("gradient", None)
        self.iteration += 1
        if self.iteration % self.method.measured_every == 0:
            good, losses, seen = self._checked(good, losses)
            self.seconds = time.perf_counter() - self.started
            self._record(seen, losses)
        return good, losses

    def _checked(self, good: dict[str, Tensor], losses: dict[str, float], whole: bool = False
                 ) -> tuple[dict[str, Tensor], dict[str, float], Seen]:
        """State, losses and measurement now; if not finite, those of the state ``good``, without losses."""
        if not isinstance(seen := self._look(whole), str):
            return self.method.state(), losses, seen
        good = self._undo(good, seen)
        seen = self._look(whole)
        if isinstance(seen, str):  # a resumed state may not give finite renderings
            assert self.best is not None
            seen = self.best
        return good, {}, seen

    def _look(self, whole: bool = False) -> Seen | str:
        """Error, maps and views of the present state, or a text that names a part that is not finite. If the
        method gives a sample, only the sample is measured, unless ``whole``.
        """
        for name, value in self.method.state().items():
            if not finite(value):
                return f"{name} not finite"
        sample = None if whole else self.method.glimpse()
        svbrdf, views, capture = sample or (*self.method.estimate(), self.method.capture)
        self.whole = sample is None
        try:
            rmse, _ = rerender_errors(self.renderer, svbrdf, views, capture)
        except NotFiniteError as error:
            return error.got
        return (rmse, svbrdf, views) if math.isfinite(rmse) else "a re-rendered photo not finite"

    def _undo(self, good: dict[str, Tensor], why: str) -> dict[str, Tensor]:
        self.undone.append({"iteration": self.iteration, "reason": why})
        if len(self.undone) > MAX_UNDONE and self.iteration == 0:
            raise ConfigError("a fit that stays finite", f"{len(self.undone)} steps that did not ({why})",
                              "lower the learning rate or check the photos and their calibration")
        self.method.load_state(good)
        self.method.cut_step()
        return self.method.state()  # with the smaller step, in case it has to be cut again

    @property
    def progress(self) -> float:
        """Share of the run that is done, by the limit that is nearer; 1 if the method has ended."""
        if self.method.done:
            return 1.0
        shares = [self.iteration / self.config.iterations] if self.config.iterations else []
        shares += [self.seconds / self.config.budget] if self.config.budget else []
        return min(max(shares), 1.0)

    def _limit_reached(self) -> str | None:
        if self.config.iterations and self.iteration >= self.config.iterations:
            return "iterations"
        if len(self.undone) > MAX_UNDONE:
            return "unstable"
        if self.method.done:
            limit = "budget" if self.config.budget else "iterations"
            return limit if self.method.cut_short else "settled"
        over = self.config.budget and self.seconds >= self.config.budget
        return "budget" if over and self.iteration else None  # a first step is made, however short the budget

    def _state(self, stopped: str | None = None) -> LiveState:
        method, capture = self.method, self.capture
        svbrdf = method.preview() or self.seen[1]
        return LiveState(
            svbrdf.detach().resized(min(SIDE, svbrdf.resolution)), capture.name, method_name(method.config),
            self.renderer.name, capture.resolution, self.iteration, self.seconds, self.progress, stopped,
            method.latest_is_best, self.trace, [*self._about_photos, *about_steps(self.undone)])

    @cached_property
    def _about_photos(self) -> list[str]:
        return [*self.capture.notes, *about_photos(self.capture)]

    def _record(self, seen: Seen, losses: dict[str, float]) -> None:
        self.seen = seen
        if self.best is None or self.method.latest_is_best or seen[0] < self.best[0]:
            self.best = seen
        entry = {"seconds": round(self.seconds, 3), "iteration": self.iteration, **losses,
                 "rerender_rmse": seen[0]}
        if self.trace and self.trace[-1]["iteration"] == self.iteration:  # measured on a sample
            entry = self.trace.pop() | entry
        self.trace.append(entry)
        if self.report:
            self.report(entry, self.progress)

    @property
    def _limits(self) -> list[float]:
        """Limits of seconds and iterations; 1e9 if there is no limit."""
        return [self.config.budget or 1e9, self.config.iterations or 1e9]

    def _task(self) -> dict[str, str]:
        return fingerprints(self.config, self.capture, self.renderer, self.method.fixed)

    def save(self) -> None:
        """Write tensors, and the trace as JSON in the header. A state with NaN or infinity is not written."""
        assert self.checkpoint is not None
        state = self.method.state()
        if not all(map(finite, state.values())):
            return
        rmse, svbrdf, views = self.best or (math.inf, *self.method.estimate())
        tensors = {f"method.{k}": v for k, v in state.items()}
        tensors |= {f"best.{k}": v for k, v in svbrdf.maps.items()}
        tensors |= {f"best_views.{name}": getattr(views, name) for name in ("camera", "light", "intensity")}
        note = {"iteration": self.iteration, "seconds": self.seconds, "undone": self.undone,
                "best_rmse": rmse, "trace": self.trace, "method": type(self.method).__name__,
                "bsdf": svbrdf.bsdf, "task": self._task(),
                "lacked": self._limits if self.method.cut_short else []}
        save_tensors(self.checkpoint, tensors, note)

    def resume(self, path: Path) -> None:
        """Continue from a checkpoint. A fit that lacked time starts from the beginning if a limit has at
        least doubled: its hurried decisions are dropped. ConfigError: no checkpoint, or one of another fit.
        """
        tensors, note = load_tensors(path)
        if note.get("method") != type(self.method).__name__ or note.get("bsdf") != self.config.bsdf:
            raise ConfigError(f"a checkpoint of {type(self.method).__name__} / {self.config.bsdf}",
                              f"{note.get('method')} / {note.get('bsdf')} in {path}",
                              "resume with the same options")
        if other := differing(note.get("task"), self._task()):
            raise ConfigError("the photos, views, renderer and options of the first run",
                              f"others than {path} was made with: {', '.join(other)}",
                              "resume with the same ones; only --iterations and --budget may change")
        try:
            if wrong := shape_error(note, NOTE):
                raise ValueError(f"{wrong} in its note")
            self.anew = any(now >= 2 * then for now, then in zip(self._limits, note["lacked"]))
            if self.anew:
                return
            self.method.load_state(part(tensors, "method."))
            lit = part(tensors, "best_views.")
            views = replace(self.method.views, camera=lit["camera"], light=lit["light"],
                            intensity=lit["intensity"])
            best = SVBRDF(self.config.bsdf, part(tensors, "best."))
            self.whole = best.resolution == self.capture.resolution
            if best.resolution > self.capture.resolution or len(views) != len(self.capture):
                raise ValueError(f"maps of {best.resolution} px for {len(views)} photos")
        except (LookupError, TypeError, ValueError, RuntimeError, AttributeError, MitsvbrdfError) as reason:
            raise ConfigError("a checkpoint of the same options",
                              f"{path}: {(str(reason).splitlines() or ['empty'])[0]}",
                              "resume with the options of the first run") from None
        self.seen = self.best = note["best_rmse"], best, views
        self.iteration, self.seconds, self.trace = note["iteration"], note["seconds"], note["trace"]
        self.undone = note["undone"]
