"""Where the time of a fit goes: wall-clock seconds of the named parts of its steps, and nothing while nobody
asks.

    with profiled("renderer"):
        rendered = renderer.render(svbrdf, views)
    switch_at("renderer, backward", rendered)

Scopes may lie in each other: a second of a step counts once, for the innermost, so that the parts sum up to
the step; what no scope names is "other". Autograd runs the parts backward in one call: :func:`switch_at`
marks where each begins.

Off, a scope is one look at a context variable, 0.3 us, and a step of a fit has ten to fifteen. Times are the
calling thread's: a GPU's kernels count where the thread waits for them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from time import perf_counter
from typing import TYPE_CHECKING

from .timing import spread

if TYPE_CHECKING:
    from torch import Tensor

STEP = "step"  # the scope around one step of a method; what else is measured counts beside the steps
OTHER = "other"

_active: ContextVar[Profile | None] = ContextVar("profile", default=None)
_off = contextlib.nullcontext()


def profiled(part: str) -> contextlib.AbstractContextManager:
    """A scope whose time counts for this part."""
    profile = _active.get()
    return _off if profile is None else profile.scope(part)


def switch_at(part: str, *tensors: Tensor) -> None:
    """From when autograd has the gradient of one of these tensors, the rest of the innermost scope counts for
    this part.
    """
    profile = _active.get()
    if profile is not None:
        for tensor in tensors:
            if tensor.requires_grad:
                tensor.register_hook(lambda _: profile.switch(part))


def switch(part: str) -> None:
    """From here on, the rest of the innermost scope counts for this part."""
    profile = _active.get()
    if profile is not None:
        profile.switch(part)


@contextlib.contextmanager
def profiling() -> Iterator[Profile]:
    """Collect the scopes that are entered inside."""
    profile = Profile()
    token = _active.set(profile)
    try:
        yield profile
    finally:
        _active.reset(token)


def profile_summary() -> dict | None:
    """:meth:`Profile.summary` of what is being collected, or None while nobody asked for it."""
    profile = _active.get()
    return None if profile is None else profile.summary()


class Profile:
    """Seconds by part: ``steps``, one dict for each, and ``beside``, for the outermost scopes between
    them.
    """

    def __init__(self) -> None:
        self.steps: list[dict[str, float]] = []
        self.beside: dict[str, float] = {}
        self._counts, self._scopes, self._since = self.beside, list[str](), 0.0

    @contextlib.contextmanager
    def scope(self, part: str) -> Iterator[None]:
        """Count what happens within for this part, but for what inner scopes take."""
        self._turn()
        self._scopes.append(part)
        if part == STEP:
            self._counts = {}
            self.steps.append(self._counts)
        try:
            yield
        finally:
            self._turn()
            self._scopes.pop()
            if part == STEP:
                self._counts = self.beside

    def switch(self, part: str) -> None:
        """The rest of the innermost scope counts for this part."""
        if self._scopes:
            self._turn()
            self._scopes[-1] = part

    def _turn(self) -> None:
        """Book the time since the last turn."""
        now = perf_counter()
        if self._scopes:
            part = self._scopes[0 if self._counts is self.beside else -1]
            part = OTHER if part == STEP else part
            self._counts[part] = self._counts.get(part, 0.0) + now - self._since
        self._since = now

    def totals(self) -> dict[str, float]:
        """Seconds by part, of all steps and between them."""
        found: dict[str, float] = {}
        for counts in (*self.steps, self.beside):
            for part, seconds in counts.items():
                found[part] = found.get(part, 0.0) + seconds
        return found

    def summary(self) -> dict:
        """Statistics over the steps; the first of each kind (set of parts) compiles kernels and is left out
        if others follow.

        Returns:
            ``steps``: how many count. ``step``: ``median``, ``low`` and ``high`` (quartiles) of their
            seconds, and ``repeats``. ``parts``: the same for each part, over the steps that have it, and its
            ``share`` of all their time. ``warm_up``: seconds of the steps left out. ``beside``: seconds
            between the steps, by what ran then.
        """
        kinds = set[frozenset[str]]()
        first, later = list[dict[str, float]](), list[dict[str, float]]()
        for step in self.steps:
            (later if frozenset(step) in kinds else first).append(step)
            kinds.add(frozenset(step))
        counted, left = (later, first) if later else (first, [])
        names = dict.fromkeys(name for step in counted for name in step if name != OTHER)
        total = sum(map(_seconds, counted))
        parts = {}
        for name in [*names, OTHER] if counted else []:
            seconds = [step[name] for step in counted if name in step]
            parts[name] = spread(seconds) | {"share": sum(seconds) / total}
        return {"steps": len(counted), "step": spread(list(map(_seconds, counted))) if counted else None,
                "parts": parts,
                "warm_up": sum(map(_seconds, left)), "beside": dict(self.beside)}


def _seconds(step: dict[str, float]) -> float:
    return sum(step.values())
