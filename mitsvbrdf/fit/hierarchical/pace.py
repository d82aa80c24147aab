"""What the time left allows: a step is begun only where the steps made so far say that it can end within the budget.

Work is counted in texels times steps of Levenberg-Marquardt, and what it takes is learned from the run itself, so that a slow
machine does less and none is told how fast it is. Without a budget everything is allowed, and nothing that fits comes out
otherwise for being timed.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Literal

import torch
from torch import Tensor

Kind = Literal["solver", "views"]
KINDS: tuple[Kind, ...] = ("solver", "views")


class Pace:
    """The clock of a run, and the seconds that each kind of work took the last time.

    Args:
        budget: seconds that the run may take; None for no limit.
        clock: tells seconds.
    """

    def __init__(self, budget: float | None, clock: Callable[[], float] = time.perf_counter) -> None:
        self.budget, self.clock = budget or math.inf, clock
        self.end = math.inf  # by the clock
        self.rates: dict[Kind, float] = {}  # seconds of a unit of work

    def begin(self, progress: float) -> None:
        """Learn from the first step when the run ends: this share of it is over."""
        if math.isinf(self.end) and math.isfinite(self.budget):
            self.end = self.clock() + self.budget * (1 - progress)

    @property
    def left(self) -> float:
        """Seconds until the budget is used up."""
        return self.end - self.clock()

    @contextlib.contextmanager
    def timed(self, kind: Kind, work: float) -> Iterator[None]:
        """Learn what so much work takes."""
        began = self.clock()
        yield
        self.rates[kind] = (self.clock() - began) / work

    def seconds(self, kind: Kind, work: float) -> float:
        """What so much work will take; of a kind not done yet, as if it were the solver's."""
        return self.rates.get(kind, self.rates.get("solver", 0.0)) * work

    def allows(self, *works: tuple[Kind, float]) -> bool:
        """Whether all this can end in time."""
        return self.left >= sum(self.seconds(*work) for work in works)

    def steps(self, texels: int, most: int, keep: int = 0) -> int:
        """How many of at most so many steps of the solver end in time, with some more to follow; at least one is made."""
        step = self.seconds("solver", texels)
        fitting = self.left / step - keep if step else math.inf
        return max(1, int(min(most, fitting)))

    def state(self) -> dict[str, Tensor]:
        """Everything :meth:`load_state` needs."""
        return {"pace": torch.tensor([self.rates.get(kind, -1.0) for kind in KINDS], dtype=torch.float64)}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Go on from a saved state."""
        self.rates = {kind: rate for kind, rate in zip(KINDS, state["pace"].tolist(), strict=True) if rate >= 0}
