"""Checks of the Python API: ConfigError for arguments whose type does not match their annotation."""

import functools
import inspect
import numbers
import os
import types
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from .errors import ConfigError

P = ParamSpec("P")
T = TypeVar("T")

# wider types that an annotation accepts
_WIDER: dict[Any, Any] = {float: numbers.Real, Path: os.PathLike, tuple: (tuple, list)}


def kinds_checked(function: Callable[P, T]) -> Callable[P, T]:
    """The function, wrapped: it raises ConfigError for an argument that does not match its annotation."""
    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> T:
        check_arguments(function, args, kwargs)
        return function(*args, **kwargs)

    return called


def check_arguments(function: Callable, args: tuple, kwargs: Mapping[str, Any]) -> None:
    """Raise ConfigError for the first argument that does not match its annotation."""
    _check(function, (*zip(_about(function)[1], args), *kwargs.items()))


def check_fields(instance: Any, *names: str) -> None:
    """Raise ConfigError for the first of the fields (default: all) that does not match its annotation."""
    wanted = names or [field.name for field in fields(instance)]
    _check(type(instance), ((name, getattr(instance, name)) for name in wanted))


def _check(owner: Any, values: Iterable[tuple[str, object]]) -> None:
    hints, _ = _about(owner)
    for name, value in values:
        if name in hints and not _fits(value, hints[name]):
            got = repr(value)
            raise ConfigError(f"{name}: {inspect.formatannotation(hints[name]).replace('mitsvbrdf.', '')}",
                              f"{got if len(got) < 60 else got[:60] + '...'} ({type(value).__name__})",
                              f"see help({owner.__name__})")


@functools.cache
def _about(owner: Any) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Annotations (a dict, argument to type; empty if only type checkers know one), and positional names."""
    try:
        hints = get_type_hints(owner)
    except NameError:
        hints = {}
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return hints, tuple(name for name, each in inspect.signature(owner).parameters.items()
                        if each.kind in positional)


def _fits(value: object, hint: Any) -> bool:
    """Whether a value matches an annotation; contents of collections, words of a Literal are not checked."""
    origin = get_origin(hint) or hint
    if origin in (Union, types.UnionType):
        return any(_fits(value, each) for each in get_args(hint))
    if origin is Literal:
        return isinstance(value, tuple({type(each) for each in get_args(hint)}))
    if origin is None or origin is type(None):
        return value is None
    if not isinstance(origin, type):
        return True
    if getattr(origin, "_is_protocol", False):
        return all(callable(getattr(value, name, None)) for name, member in vars(origin).items()
                   if inspect.isfunction(member) and not name.startswith("_"))
    if isinstance(value, bool) and origin in (int, float):
        return False
    return isinstance(value, _WIDER.get(origin, origin))
