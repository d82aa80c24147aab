"""Where the time of a fit goes: wall-clock seconds of its named parts.

    with profiled("renderer"):
        rendered = renderer.render(svbrdf, views)
    switch_at("renderer, backward", rendered)

Scopes may be nested. A second counts once, for the innermost scope, so the parts sum up to the time in
scopes. Autograd runs the parts backward in one call: :func:`switch_at` marks where each begins. Without
:func:`profiling`, a scope costs 0.3 us. Kernels of a GPU count where the thread waits for them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from time import perf_counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

_active: ContextVar[Profile | None] = ContextVar("profile", default=None)
_off = contextlib.nullcontext()


def profiled(part: str) -> contextlib.AbstractContextManager:
    """A scope whose time counts for this part."""
    profile = _active.get()
    return _off if profile is None else profile.scope(part)


def switch_at(part: str, *tensors: Tensor) -> None:
    """The rest of the innermost scope counts for this part, once autograd has the gradient of a tensor."""
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


def profile_seconds() -> dict[str, float] | None:
    """Seconds by part of the profile that is collected, in the order in which the parts began; else None."""
    profile = _active.get()
    return None if profile is None else dict(profile.seconds)


class Profile:
    """Seconds by part."""

    def __init__(self) -> None:
        self.seconds = dict[str, float]()
        self._scopes, self._since = list[str](), 0.0

    @contextlib.contextmanager
    def scope(self, part: str) -> Iterator[None]:
        """Count the time within for this part, without that of inner scopes."""
        self._turn()
        self._scopes.append(part)
        try:
            yield
        finally:
            self._turn()
            self._scopes.pop()

    def switch(self, part: str) -> None:
        """The rest of the innermost scope counts for this part."""
        if self._scopes:
            self._turn()
            self._scopes[-1] = part

    def _turn(self) -> None:
        """Book the time since the last turn."""
        now = perf_counter()
        if self._scopes:
            part = self._scopes[-1]
            self.seconds[part] = self.seconds.get(part, 0.0) + now - self._since
        self._since = now
