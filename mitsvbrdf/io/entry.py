"""The entry of the Python API: public functions give the same results under all global settings of torch.

torch's default dtype is global; gradient and inference mode are set per thread. During a call the default
dtype is float32, functions that need gradients record them, and copies replace inference tensors, which
autograd cannot use. When the last call of all threads ends, the program's own default dtype is restored.
If the program imported torch first, OpenMP's idle threads spin; torch then uses one thread during calls.
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

SPINS = os.environ.get("OMP_WAIT_POLICY", "").upper() != "PASSIVE"  # we set it if torch is not loaded yet
_lock = threading.Lock()
_calls = 0  # number of calls that run now, in all threads
_default = torch.float32  # the default dtype before the first of these calls
_threads: dict[int, int] = {}  # calling thread: torch's number of threads before its call
_undo: dict[str, Callable[[], object]] = {}  # name of another global change: how to undo it


def entry(gradients: bool = False) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a public function: it works under any defaults of torch, and checks its arguments.

    An argument that does not match its annotation raises ConfigError. With ``gradients`` the function
    records gradients even if its caller has switched them off.
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
    """Keep float32 as torch's default dtype until the last running call ends."""
    global _calls, _default
    with _lock:
        if not _calls:
            _default = torch.get_default_dtype()
            torch.set_default_dtype(torch.float32)
        _calls += 1
        me = threading.get_ident()
        outermost = SPINS and me not in _threads
        if outermost:  # a new thread starts with the number set last; during another call this is our 1
            threads = torch.get_num_threads()
            _threads[me] = max(_threads.values()) if threads == 1 and _threads else threads
            torch.set_num_threads(1)
    try:
        yield
    finally:
        later: list[Callable[[], object]] = []
        with _lock:
            if outermost:
                torch.set_num_threads(_threads.pop(me))
            _calls -= 1
            if not _calls:
                torch.set_default_dtype(_default)
                later += _undo.values()
                _undo.clear()
        for undo in later:
            undo()


def put_back(what: str, undo: Callable[[], object]) -> None:
    """Undo a global change when the last running call ends, or now if no call runs. Of several changes with
    the same name ``what``, only the first ``undo`` is called.
    """
    with _lock:
        if _calls:
            _undo.setdefault(what, undo)
            return
    undo()


def _ordinary(value: Any) -> Any:
    """The value itself, or a new one in which copies replace inference tensors."""
    if isinstance(value, Tensor):
        return value.clone() if value.is_inference() else value
    if is_dataclass(value) and not isinstance(value, type):
        kept = getattr(value, "__dict__", {})  # getattr may call a descriptor that computes something else
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
