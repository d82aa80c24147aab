"""The edge of the Python API: public functions compute the same whatever the program around them has set.

torch's default dtype belongs to the process, gradient and inference mode to the thread. Behind the edge the
default dtype is float32, gradients are recorded where a function needs them, and no tensor is one of
inference mode, which autograd refuses. A program's own default comes back when the last call, of whatever
thread, is over. Where a program imported torch first, OpenMP's idle threads spin; torch has one thread then.
"""

import contextlib
import functools
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor

from ..kinds import check_arguments

P = ParamSpec("P")
T = TypeVar("T")

SPINS = os.environ.get("OMP_WAIT_POLICY", "").upper() != "PASSIVE"  # set where torch is not loaded yet
_lock = threading.Lock()
_calls = 0  # behind the edge, of all threads
_default = torch.float32  # the default dtype that the first of them found
_undo: dict[str, Callable[[], object]] = {}  # by what else was changed for them, what puts it back


def entry(gradients: bool = False) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Makes a function one that a program may call under defaults of its own, and with wrong arguments.

    An argument of another kind than its annotation raises ConfigError. With ``gradients`` the function
    records them even where its caller has switched that off.
    """
    def decorated(function: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(function)
        def called(*args: P.args, **kwargs: P.kwargs) -> T:
            check_arguments(function, args, kwargs)
            recorded = gradients or torch.is_grad_enabled()
            with _float32(), torch.inference_mode(False), torch.set_grad_enabled(recorded):
                return function(*_ordinary(args), **_ordinary(kwargs))

        return called

    return decorated


@contextlib.contextmanager
def _float32() -> Iterator[None]:
    """float32 is torch's default until the last call is over."""
    global _calls, _default
    with _lock:
        if not _calls:
            _default = torch.get_default_dtype()
            torch.set_default_dtype(torch.float32)
            if SPINS:
                threads = torch.get_num_threads()
                torch.set_num_threads(1)
                _undo["threads"] = functools.partial(torch.set_num_threads, threads)
        _calls += 1
    try:
        yield
    finally:
        later: list[Callable[[], object]] = []
        with _lock:
            _calls -= 1
            if not _calls:
                torch.set_default_dtype(_default)
                later += _undo.values()
                _undo.clear()
        for undo in later:
            undo()


def put_back(what: str, undo: Callable[[], object]) -> None:
    """Undo a change of what the process has once: after the last call behind the edge, or now without one. Of
    several changes of the same thing the first is undone.
    """
    with _lock:
        if _calls:
            _undo.setdefault(what, undo)
            return
    undo()


def _ordinary(value: Any) -> Any:
    """Itself; or with copies in place of the tensors that inference mode made."""
    if isinstance(value, Tensor):
        return value.clone() if value.is_inference() else value
    if is_dataclass(value) and not isinstance(value, type):
        kept = getattr(value, "__dict__", {})  # a descriptor may make something else of it, at a cost
        old = {field.name: kept[field.name] if field.name in kept else getattr(value, field.name)
               for field in fields(value) if field.init}
        new = {name: _ordinary(each) for name, each in old.items()}
        return replace(value, **new) if any(new[name] is not old[name] for name in old) else value
    if type(value) in (list, tuple):
        items = type(value)(map(_ordinary, value))
        return value if all(map(lambda a, b: a is b, items, value)) else items
    if isinstance(value, dict):
        items = {name: _ordinary(each) for name, each in value.items()}
        return value if all(items[name] is value[name] for name in value) else items
    return value
