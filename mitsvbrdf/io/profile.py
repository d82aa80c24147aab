"""Where the time of a fit goes: wall-clock seconds of the named parts of its steps.

    with profiled("renderer"):
        rendered = renderer.render(svbrdf, views)
    switch_at("renderer, backward", rendered)

Scopes may be nested. A second of a step counts once, for the innermost scope, so the parts sum up to the
step. Time that no scope names is "other". Autograd runs the parts backward in one call: :func:`switch_at`
marks where each begins. Without :func:`profiling`, a scope costs 0.3 us. Kernels of a GPU count where the
thread waits for them.
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


def switch(part: str) -> None:
    """The rest of the innermost scope counts for this part."""
    if profile := _active.get():
        profile.switch(part)


def switch_at(part: str, *tensors: Tensor) -> None:
    """:func:`switch`, as soon as autograd has the gradient of one of these tensors."""
    if profile := _active.get():
        for tensor in tensors:
            if tensor.requires_grad:
                tensor.register_hook(lambda _: profile.switch(part))


@contextlib.contextmanager
def profiling() -> Iterator[Profile]:
    """Collect the scopes that are entered inside."""
    token = _active.set(profile := Profile())
    try:
        yield profile
    finally:
        _active.reset(token)


def profile_summary() -> dict | None:
    """:meth:`Profile.summary` of the profile being collected, else None."""
    profile = _active.get()
    return None if profile is None else profile.summary()


class Profile:
    """Seconds by part: ``steps`` has a dict for each step, ``beside`` the outermost scopes between them."""

    def __init__(self) -> None:
        self.steps: list[dict[str, float]] = []
        self.beside: dict[str, float] = {}
        self._counts, self._scopes, self._since = self.beside, list[str](), 0.0

    @contextlib.contextmanager
    def scope(self, part: str) -> Iterator[None]:
        """Count the time within for this part, without that of inner scopes."""
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

    def summary(self) -> dict:
        """Statistics over the steps, without the first of each kind (set of parts), which compiles kernels.

        Returns:
            ``steps``: their number. ``step``: :func:`~mitsvbrdf.io.timing.spread` of their seconds.
            ``parts``: the same of each part, over the steps that have it, and its ``share`` of all their
            time. ``warm_up``: seconds of the other steps; all steps count where there are no others.
            ``beside``: seconds between the steps by part.
        """
        kinds = dict[frozenset[str], dict[str, float]]()
        counted = [step for step in self.steps if kinds.setdefault(frozenset(step), step) is not step]
        warm_up = sum(sum(step.values()) for step in kinds.values()) if counted else 0
        counted = counted or self.steps
        seconds = [sum(step.values()) for step in counted]
        names = [*dict.fromkeys(name for step in counted for name in step if name != OTHER), OTHER]
        parts = {}
        for name in names if counted else []:
            each = [step[name] for step in counted if name in step]
            parts[name] = spread(each) | {"share": sum(each) / sum(seconds)}
        return {"steps": len(counted), "step": spread(seconds) if counted else None, "parts": parts,
                "warm_up": warm_up, "beside": dict(self.beside)}
