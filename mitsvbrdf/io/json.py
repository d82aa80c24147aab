"""Read JSON of any origin strictly, up to a size limit; :mod:`mitsvbrdf.io.files` writes JSON."""

import json
import math
from pathlib import Path
from typing import Any, TypedDict

import msgspec

from .files import read_regular

MOST_BYTES = 2**28
LARGEST = 2**63  # whole numbers must be below; larger ones overflow tensors and floats
NUMBER = int | float  # a number in a shape, see :func:`shape_error`


def load(path: Path, kind: type | tuple[type, ...] = dict, links: bool = True) -> Any:
    """The value of a JSON file, of type ``kind``; a symbolic link is followed only with ``links``.

    OSError: the file cannot be read, or is no regular file. ValueError: it is larger than 256 MiB, or
    :func:`parsed` raises the error.
    """
    return parsed(read_regular(path, MOST_BYTES, links), kind)


def parsed(text: str | bytes, kind: type | tuple[type, ...] = dict) -> Any:
    """The value of a JSON text, given as a string or as bytes in UTF-8.

    ValueError: it is no JSON, is nested too deeply, has a key twice in an object, has a number that is not
    finite or does not fit into 64 bits, or is of another type than ``kind``.
    """
    odd: list[float] = []

    def number(digits: str) -> float:
        value = float(digits)
        if not math.isfinite(value):
            odd.append(value)
        return value

    def whole(digits: str) -> int | float:
        return int(digits) if len(digits) <= 20 and abs(int(digits)) < LARGEST else number("inf")

    try:
        value = json.loads(text.decode("utf-8-sig") if isinstance(text, bytes) else text, parse_float=number,
                           parse_int=whole, parse_constant=number, object_pairs_hook=_each_once)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if odd:
        raise ValueError(f"{_place(value)} is no finite number of 64 bits")
    if not isinstance(value, kind):
        raise ValueError(f"{'a list' if kind is list else 'an object'} was expected, not "
                         f"{type(value).__name__}")
    return value


def error_text(reason: Exception) -> str:
    """The message of an error; that of an OSError is without the file's name."""
    return (isinstance(reason, OSError) and reason.strerror) or str(reason)


def shape_error(value: object, shape: object, where: str = "") -> str:
    """The first place where a value does not match a shape, and the reason; empty if it matches.

    A shape is a type that msgspec supports, such as ``list[X]`` or ``dict[str, X]``. ``[X]`` is a list of X,
    ``{str: X}`` an object whose values are X, ``{"name": X, ...}`` an object with these keys.
    """
    try:
        msgspec.convert(value, _type_of(shape))
    except msgspec.ValidationError as reason:
        what, _, place = str(reason).replace("`", "").partition(" - at $")
        return f"{(where + place).lstrip('.') or 'the whole'} ({what[:1].lower()}{what[1:]})"
    return ""


def _type_of(shape: Any) -> Any:
    if isinstance(shape, list):
        return list[_type_of(shape[0])]  # type: ignore[misc]
    if isinstance(shape, dict):
        if list(shape) == [str]:
            return dict[str, _type_of(shape[str])]  # type: ignore[misc]
        return TypedDict("Shape", {name: _type_of(each) for name, each in shape.items()})  # type: ignore[operator]
    return Any if shape is object else shape


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the key {next(name for name in names if names.count(name) > 1)!r} twice in an "
                         "object")
    return found


def _place(value: Any) -> str:
    """The path to the first float in a value that is not finite, such as ``camera_pos[5][1]``."""
    left = [("", value)]
    while left:
        where, each = left.pop()
        if isinstance(each, float) and not math.isfinite(each):
            return where or "the value"
        parts = each.items() if isinstance(each, dict) else enumerate(each) if isinstance(each, list) else ()
        left += reversed([(f"{where}[{key}]" if isinstance(key, int) else f"{where}.{key}".lstrip("."), part)
                          for key, part in parts])
    return "a number"
