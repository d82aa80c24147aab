"""The time budget: a step begins only if it will end within the budget, judged by the steps so far.

Work is counted in texels times steps of Levenberg-Marquardt. The time per unit of work is measured in the run
itself, so nobody has to state the speed of the machine. A slow machine does less work. Without a budget,
all work is done. Work that ends within a budget has the same results as without one.
"""

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Literal

import torch
from torch import Tensor

from .stages import Stage, Stages

STEPS, OTHER_STEPS = 6, 4  # Levenberg-Marquardt steps of a round, and of another start
FAR_STEPS = 10  # of another start if texels have lobes: their priors are narrow
ROUND_STEPS = STEPS + 4 * OTHER_STEPS  # of a round with all starts
LAST_STEPS = 8  # at the end of the fit

Kind = Literal["solver", "views", "turns"]  # "turns": fits with one photo held out
KINDS: tuple[Kind, ...] = ("solver", "views", "turns")


class TimeBudget:
    """The clock of a run, and the least seconds per unit of each kind of work (first calls also compile).

    Args:
        budget: seconds that the run may take; None for no limit.
        full: texels at full size.
    """

    def __init__(self, budget: float | None, stages: Stages, full: int,
                 clock: Callable[[], float] = time.perf_counter) -> None:
        self.budget, self.stages, self.full, self.clock = budget, stages, full, clock
        self.end = math.inf  # by the clock
        self.rates: dict[Kind, float] = {}

    def begin(self, progress: float) -> None:
        """At the first step, set the end of the run; the share ``progress`` of the run is over."""
        if self.budget and math.isinf(self.end):
            self.end = self.clock() + self.budget * (1 - progress)

    @contextlib.contextmanager
    def timed(self, kind: Kind, work: float) -> Iterator[None]:
        """Measure how long ``work`` takes."""
        began = self.clock()
        yield
        if work:
            self.rates[kind] = min((self.clock() - began) / work, self.rates.get(kind, math.inf))

    @property
    def to_come(self) -> int:
        """Steps of the solver at full size that must follow what is done in the present stage."""
        if self.stages.stage != Stage.FINE:
            return STEPS + LAST_STEPS
        return LAST_STEPS if self.stages.tied else 0

    def in_time(self, work: float, kind: Kind = "solver", beside: int = 0) -> bool:
        """Whether ``work``, and the steps that must follow it, can end in time.

        Args:
            work: texels times steps of the solver, or times renderings from all views. A kind not measured
                yet is assumed to take as long per unit as the solver.
            beside: further steps of the solver at full size.
        """
        solver = self.rates.get("solver", 0.0)
        return (self.end - self.clock() >= self.rates.get(kind, solver) * work
                + solver * (self.to_come + beside) * self.full)

    def steps(self, most: int, keep: int = 0) -> int:
        """Number of full-size solver steps in the time left, minus ``keep`` steps; from 1 to ``most``."""
        seconds = self.rates.get("solver", 0.0) * self.full
        return max(1, int(min(most, (self.end - self.clock()) / seconds - keep))) if seconds else most

    def state(self) -> dict[str, Tensor]:
        """Everything :meth:`load_state` needs."""
        spent = self.budget - (self.end - self.clock()) if self.budget and math.isfinite(self.end) else 0.0
        return {"time_budget": torch.tensor([spent, *(self.rates.get(kind, -1.0) for kind in KINDS)],
                                     dtype=torch.float64)}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Go on from a saved state."""
        spent, *rates = state["time_budget"].tolist()
        self.rates = {kind: rate for kind, rate in zip(KINDS, rates, strict=True) if rate >= 0}
        if self.budget and math.isinf(self.end) and spent:
            self.end = self.clock() + self.budget - spent
