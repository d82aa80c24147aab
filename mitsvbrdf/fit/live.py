"""The state of a running fit, shown about once a second. Showing it does not change the fit."""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass

from ..errors import OutputError
from ..material.maps import SVBRDF

SIDE = 256  # texels a side of the maps shown, at most
SECONDS = 1.0  # from one state to the next, at least
SHARE = 0.05  # of the time that showing may take, at most


@dataclass(frozen=True)
class LiveState:
    """A running fit at one moment."""

    svbrdf: SVBRDF  # the maps of the latest measurement, or the method's preview; at most 256 px
    capture: str  # name of the folder of the photos; empty without one
    method: str  # its name
    renderer: str  # its name
    resolution: int  # pixels a side of the photos
    iteration: int  # steps done
    seconds: float  # run time
    share: float  # used share of the limits, 0 to 1
    stopped: str | None  # why the fit ended; None while it runs
    latest_is_best: bool  # whether the fit returns its latest maps; False: those with the lowest error
    trace: list[dict]  # one dict a measurement
    warnings: list[str]  # so far


class Live:
    """Shows the state of a fit, at most once every :data:`SECONDS`, for at most :data:`SHARE` of the time.

    Args:
        show: called with each state. If it raises OutputError, the state is not shown.
    """

    def __init__(self, show: Callable[[LiveState], None]) -> None:
        self.show, self.due = show, 0.0

    def offer(self, state: Callable[[], LiveState], ended: bool = False) -> None:
        """Show the fit if the last state is long enough ago, or if it has ended."""
        began = time.perf_counter()
        if began < self.due and not ended:
            return
        with contextlib.suppress(OutputError):
            self.show(state())
        now = time.perf_counter()
        self.due = now + max(SECONDS, (now - began) * (1 / SHARE - 1))
