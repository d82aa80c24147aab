"""What a running fit shows of itself, about once a second. Looking at a fit does not change it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..errors import OutputError
from ..io.profile import profiled
from ..material.maps import SVBRDF
from .methods import method_name
from .warnings import about_photos, about_steps

if TYPE_CHECKING:
    from .loop import Loop

SIDE = 256  # texels a side of the maps shown, at most
SECONDS = 1.0  # from one state to the next, at least
SHARE = 0.05  # of the time that showing may take, at most


@dataclass(frozen=True)
class LiveState:
    """A running fit at one moment."""

    svbrdf: SVBRDF  # the maps of the latest measurement, or what a method shows in between; at most 256 px
    capture: str  # name of the folder of the photos; empty without one
    method: str  # how it fits
    renderer: str  # its name
    resolution: int  # pixels a side of the photos
    iteration: int  # steps done
    seconds: float  # run time
    share: float  # of the limits that is used, 0 to 1
    stopped: str | None  # why the fit ended; None while it runs
    latest_is_best: bool  # whether the fit will return the latest maps, not those of the lowest error
    trace: list[dict]  # one dict a measurement
    warnings: list[str]  # so far


class Live:
    """Passes the state of a fit on, at most once in :data:`SECONDS`, and in :data:`SHARE` of the time.

    Args:
        show: what gets each state. If it raises OutputError, that state is not shown.
    """

    def __init__(self, show: Callable[[LiveState], None]) -> None:
        self.show, self.due = show, 0.0
        self.about_photos: list[str] | None = None

    def offer(self, loop: Loop, stopped: str | None = None) -> None:
        """Show the fit if the last state is long enough ago, or if it has ended."""
        began = time.perf_counter()
        if began < self.due and not stopped:
            return
        with profiled("live page"), contextlib.suppress(OutputError):
            self.show(self._state(loop, stopped))
        ended = time.perf_counter()
        self.due = ended + max(SECONDS, (ended - began) * (1 / SHARE - 1))

    def _state(self, loop: Loop, stopped: str | None) -> LiveState:
        method, capture = loop.method, loop.capture
        if self.about_photos is None:
            self.about_photos = [*capture.notes, *about_photos(capture)]
        svbrdf = method.preview() or loop.seen[1]
        return LiveState(
            svbrdf.detach().resized(min(SIDE, svbrdf.resolution)),
            capture.source.name if capture.source else "", method_name(method.config), loop.renderer.name,
            capture.resolution, loop.iteration, loop.seconds, loop.progress, stopped, loop.latest_is_best,
            loop.trace, [*self.about_photos, *about_steps(loop.undone)])
