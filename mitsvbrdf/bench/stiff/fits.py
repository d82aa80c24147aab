"""The fits of stiff scenes: each one record of a benchmark's file, so that a run can stop anywhere and go on
later.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ...errors import ConfigError
from ...fit import FitResult, fit_svbrdf
from ...fit.methods import METHODS
from ...io.timing import timed
from ...measure.metrics import map_rmse
from ...render import Renderer, RendererName, make_renderer
from ..jobs import FitJob, check_finite
from .scenes import CONTROL, StiffTask, digest, stated, stiff_tasks

SUITE = "stiff"
# What shapes these records, beside what shapes those of the benchmark.
SHAPING = ("bench/stiff/fits.py", "bench/stiff/scenes.py", "verify/stability/conditioning.py")
# methods whose result follows their seed; `direct` draws no random number
SEEDED = ("hierarchical", "hybrid", "gan")
# Cases that `gan` also has its own budget for.
GAN_AT_LENGTH = (CONTROL, "metal of roughness 0.05", "metal of roughness 0.05, deep relief, 30 % clipped")
NEAR = 1.1  # times the final error of the photos: where a fit counts as nearly done

NO_FIGURES: dict[str, Any] = {"seconds": 0.0, "wall": 0.0, "iterations": 0, "errors": {}, "stated": {},
                              "near": {}, "undone": 0, "restarts": 0, "warnings": []}


@dataclass(frozen=True)
class StiffFit(FitJob):
    """One fit of a stiff scene."""

    task: StiffTask  # type: ignore[assignment]  # as a task of other fits, it has kind, name and photos

    def run(self, report: Callable[[float], None] = lambda share: None) -> dict:
        """The figures. Whatever ends the fit is one, too, and ``why`` says what; but for Ctrl-C."""
        config = replace(self.config, budget=self.budget, seed=self.seed)
        try:
            result, wall = timed(fit_svbrdf, self.task.photos, self.renderer, config, report=lambda entry,
                                 share: report(share))
            if result.stopped == "interrupted":
                raise KeyboardInterrupt
            found = figures(result, self.task) | {"wall": wall, "why": None}
        except Exception as reason:  # also one that nobody expects: that is what is looked for
            found = NO_FIGURES | {"stopped": "failed", "why": f"{type(reason).__name__}: {reason}"}
        return self.task.known | found


def figures(result: FitResult, task: StiffTask) -> dict[str, Any]:
    """How a fit ended, as numbers and texts for JSON: see :class:`mitsvbrdf.bench.records.StiffRecord`.

    Raises:
        MapsError: maps that are not finite, or out of range.
        ConfigError: another figure that is not finite.
    """
    result.svbrdf.check()
    last, trace = result.trace[-1], result.trace
    errors = {"photos": result.rerender_rmse, "photos_start": trace[0]["rerender_rmse"]}
    errors |= {} if task.scene.grey else map_rmse(result.svbrdf, task.truth)
    near = next((entry for entry in trace if entry["rerender_rmse"] <= NEAR * result.rerender_rmse), last)
    spread = stated(result.deviations)
    check_finite(errors)
    check_finite(spread)
    return {"seconds": last["seconds"], "iterations": last["iteration"], "stopped": result.stopped,
            "errors": errors,
            "stated": spread, "near": {"seconds": near["seconds"], "iterations": near["iteration"]},
            "undone": len(result.undone), "restarts": len(result.restarts), "warnings": list(result.warnings)}


def stiff_jobs(resolution: int, budget: float, seeds: Sequence[int], renderer: Renderer,
               methods: Sequence[str] = (), at_length: bool = True) -> list[StiffFit]:
    """Every case with every method and seed, every member of a series with every method, and some cases at
    ``gan``'s budget.

    Args:
        resolution: of maps and photos.
        budget: seconds of a fit at most.
        seeds: of the methods that have one; series have the first.
        renderer: carries the gradients.
        methods: names; none for all.
        at_length: whether ``gan`` has some cases with its own budget as well.

    Raises:
        ConfigError: no such method, or a resolution or budget that no fit has.
    """
    unknown = [name for name in methods if name not in METHODS]
    if unknown:
        raise ConfigError(f"methods of {list(METHODS)}", ", ".join(unknown), "check --methods")
    if resolution < 8 or not 0 < budget < math.inf:
        raise ConfigError("a resolution of 8 or more and a budget above 0", f"{resolution} and {budget:g}",
                          "try 64 and 20")
    configs = {name: entry.config() for name, entry in METHODS.items() if name in (methods or METHODS)}
    cases, series = stiff_tasks(resolution)

    def fit(name: str, task: StiffTask, seed: int, seconds: float = budget) -> StiffFit:
        return StiffFit(SUITE, name, configs[name], task, seconds, seed, renderer)

    jobs = [fit(name, task, seed) for seed in seeds for task in cases for name in configs
            if seed == seeds[0] or name in SEEDED]
    jobs += [fit(name, task, seeds[0]) for task in series for name in configs]
    if at_length and "gan" in configs:
        jobs += [fit("gan", task, seed, configs["gan"].default_budget)
                 for task in cases if task.name in GAN_AT_LENGTH for seed in seeds]
    return list({str(job.key): job for job in jobs}.values())  # where the budget is gan's own, each once


@dataclass(frozen=True)
class StiffPlan:
    """What was asked for; plain values, so that another process can be told.

    Args:
        quick: one seed, and no longer budget for ``gan``.
        methods: names; none for all.
        budget: seconds of a fit at most; None is 20, 5 where it is quick.
        resolution: of maps and photos.
        renderer: carries the gradients.
        variant: Mitsuba's.
    """

    quick: bool
    methods: Sequence[str] = ()
    budget: float | None = None
    resolution: int = 64
    renderer: RendererName = "mitsuba"
    variant: str = "llvm_ad_rgb"

    def jobs(self) -> tuple[list[StiffFit], dict, dict]:
        """All fits, what their records share, and nothing published.

        Raises:
            ConfigError: no such method, or a resolution or budget that no fit has.
        """
        seconds = (5.0 if self.quick else 20.0) if self.budget is None else self.budget
        jobs = stiff_jobs(self.resolution, seconds, (0,) if self.quick else (0, 1, 2),
                          make_renderer(self.renderer, self.variant), self.methods, at_length=not self.quick)
        return jobs, {"resolution": self.resolution, "views": "builtin:grid", "renderer": self.renderer,
                      "variant": self.variant, "quick": self.quick, "scenes": digest()}, {}
