"""The edge of the Python API: what a public function computes with, whatever the program around it has set.

torch's default dtype belongs to the process, gradient and inference mode to the thread. Behind the edge
numbers are float32 where nothing else is said, gradients are recorded where a function needs them, and no
tensor is one of inference mode, which autograd refuses. All is left as it was found.
"""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor

from ..kinds import check_arguments

P = ParamSpec("P")
T = TypeVar("T")

_counting = threading.Lock()
_inside: set[object] = set()  # the calls behind the edge, of all threads
_found = torch.float32  # the default dtype before the first of them
_later: dict[str, Callable[[], object]] = {}  # by what it is about, what puts it back after the last of them


def entry(gradients: bool = False) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Makes a function one that a program may call under defaults of its own, and with wrong arguments.

    An argument of another kind than its annotation raises ConfigError.

    Args:
        gradients: whether the function needs gradients and records them even where its caller has switched
            that off; else they are recorded as the caller has it.
    """
    def decorated(function: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(function)
        def called(*args: P.args, **kwargs: P.kwargs) -> T:
            check_arguments(function, args, kwargs)
            with _float32(), _recording(gradients or torch.is_grad_enabled()):
                return function(*_ordinary(args), **_ordinary(kwargs))

        return called

    return decorated


@contextlib.contextmanager
def _recording(gradients: bool) -> Iterator[None]:
    with torch.inference_mode(False), torch.set_grad_enabled(gradients):
        yield


@contextlib.contextmanager
def _float32() -> Iterator[None]:
    """float32 is torch's default until the last call, of whatever thread, is over."""
    global _found
    call = object()
    try:
        with _counting:
            if not _inside:
                _found = torch.get_default_dtype()
            _inside.add(call)
            torch.set_default_dtype(torch.float32)
        yield
    finally:
        over = list[Callable[[], object]]()
        with _counting:
            _inside.discard(call)
            if not _inside:
                torch.set_default_dtype(_found)
                over += _later.values()
                _later.clear()
        for undo in over:
            undo()


def put_back(what: str, undo: Callable[[], object]) -> None:
    """Undo a change of what the process has once: after the last call behind the edge, or now where there is
    none.

    Args:
        what: was changed; of several changes the first is undone.
        undo: puts back what was found.
    """
    with _counting:
        if _inside:
            _later.setdefault(what, undo)
            return
    undo()


def _ordinary(value: Any) -> Any:
    """Itself; or with copies in place of the tensors that inference mode made."""
    if isinstance(value, Tensor):
        return value.clone() if value.is_inference() else value
    if is_dataclass(value) and not isinstance(value, type):
        old = {field.name: getattr(value, field.name) for field in fields(value) if field.init}
        new = _ordinary(old)
        return value if new is old else replace(value,
                                                **{name: new[name] for name in new
                                                   if new[name] is not old[name]})
    if type(value) in (list, tuple):
        items = type(value)(map(_ordinary, value))
        return value if all(map(lambda a, b: a is b, items, value)) else items
    if isinstance(value, dict):
        items = {name: _ordinary(each) for name, each in value.items()}
        return value if all(items[name] is value[name] for name in value) else items
    return value
