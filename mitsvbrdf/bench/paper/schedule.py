"""The paper's schedule (III.F) at a stated size: how far its maps are off, again and again, until its last
iteration.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from ...errors import ConfigError
from ...evaluate.placement import predict
from ...fit import FitTask, GanConfig, make_method
from ...fit.loop import Loop
from ...io.timing import timed
from ...material.maps import SVBRDF
from ...render import Renderer
from ..methods import Fitted, as_lit, settings_of
from ..tasks import Task

POINTS = 50  # of the curve, besides the start
SECONDS = 2e-4  # of an iteration, a texel at width 64: a guess, only to say how long it will take
# seconds of an iteration, however small; on a busy machine 0.26 (32 px, width 8) and 0.50 (64 px, width 16)
AT_LEAST = 0.2


@dataclass(frozen=True)
class ScheduleJob:
    """One long run.

    Args:
        method: its name.
        config: a preset of the paper, with the ``iterations`` and the ``width`` of this run.
        task: what is fitted.
        seed: of the fit.
        renderer: carries the gradients.
    """

    method: str
    config: GanConfig
    task: Task
    seed: int
    renderer: Renderer

    @property
    def key(self) -> dict:
        """What identifies the record."""
        return {"suite": "schedule", "method": self.method, **self.task.key, "seed": self.seed}

    @property
    def settings(self) -> dict:
        """What else shapes the record."""
        return settings_of(self.config, __name__) | {"resolution": self.task.photos.resolution,
                                                     "width": self.config.width,
                                                     "iterations": self.iterations}

    @property
    def title(self) -> str:
        """For the progress line."""
        return f"{self.method}, {self.task.name}, {self.iterations} iterations, seed {self.seed}"

    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
        return "schedule"

    @property
    def iterations(self) -> int:
        """How many it makes."""
        return (self.config.default_limit["iterations"] if self.config.iterations is None
                else self.config.iterations)

    @property
    def cost(self) -> float:
        """A guess of its seconds."""
        each = SECONDS * self.task.photos.resolution**2 * (self.config.width / 64) ** 2
        return self.iterations * max(AT_LEAST, each)

    def run(self, report: Callable[[float], object] = lambda share: None) -> dict:
        """The figures: ``errors`` of the result, ``trace`` with those of the state at some fifty iterations.

        The seconds have what counting these errors took in them.
        """
        trace: list[dict[str, float]] = []
        found, wall = timed(self._fit, trace, report)
        return {"seconds": found.seconds, "wall": wall, "iterations": found.iterations,
                "stopped": found.stopped,
                "errors": self.task.errors(found), "trace": trace}

    def _fit(self, trace: list[dict[str, float]], report: Callable[[float], object]) -> Fitted:
        config = replace(self.config, iterations=self.iterations, budget=None, seed=self.seed)
        config.check()
        lit = as_lit(self.task.photos, config)
        method = make_method(FitTask(lit, self.renderer, config))
        method.measured_every = max(1, self.iterations // POINTS)

        def kept(entry: dict, share: float) -> None:
            rmse, svbrdf, _ = loop.seen
            now = self._fitted(svbrdf, rmse, entry["seconds"], entry["iteration"], "going on")
            trace.append({"iteration": entry["iteration"], "seconds": entry["seconds"]}
                         | self.task.errors(now))
            report(share)

        loop = Loop(method, lit, self.renderer, config, report=kept)
        stopped = loop.run()
        if stopped == "interrupted":
            raise KeyboardInterrupt
        if loop.best is None or not loop.iteration:
            raise ConfigError("a fit of one iteration or more", "none", "give more iterations")
        rmse, svbrdf, _ = loop.best
        return self._fitted(svbrdf, rmse, loop.trace[-1]["seconds"], loop.iteration, stopped)

    def _fitted(self, svbrdf: SVBRDF, rmse: float, seconds: float, iterations: int, stopped: str) -> Fitted:
        return Fitted(svbrdf.detach(), rmse, lambda shots: predict(svbrdf, as_lit(shots, self.config),
                                                                   self.renderer, None)[:2],
                      seconds, math.nan, iterations, stopped)
