"""The JSON of a benchmark, version 2: which record is which, and whether a file is one
(:mod:`mitsvbrdf.bench.records`).
"""

from __future__ import annotations

import functools
import math
import types
from collections.abc import Sequence
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints, is_typeddict

from ..errors import ConfigError
from .records import Benchmark

SCHEMA_VERSION: Literal[2] = 2
# suites whose records are of an :class:`OfTask`
OF_TASKS = "methods", "ablation", "gan", "references", "schedule"
# numbers of the photos that fits of real captures do not see, where nothing else is said
USUAL_LEFT_OUT = (4, 7)


def identity(record: dict) -> tuple:
    """What no two records of a file share."""
    names = {"renderers": ("suite", "bsdf", "resolution", "views", "truth"),
             "capture": ("suite", "kind", "name", "sheet"),
             "references": ("suite", "kind", "name"), "sheets": ("suite", "kind", "name"),
             "schedule": ("suite", "method", "kind", "name", "seed"), "start": ("suite", "method", "kind",
                                                                                "name"),
             "steps": ("suite", "preset", "resolution", "width"), "leave-out": ("suite", "method", "kind",
                                                                                "name"),
             "leave-out-renders": ("suite", "where", "name")}
    own = names.get(record["suite"], ("suite", "method", "kind", "name", "budget", "seed"))
    return (*(record[name] for name in own), tuple(record.get("left_out", ())))


def capture_kind(left_out: Sequence[int]) -> str:
    """The kind under which numbers published for captures stand, where these photos are left out."""
    return f"capture {','.join(map(str, left_out))}"


def check_benchmark(value: Any, where: str) -> Benchmark:
    """The value itself, when it is a benchmark of this version.

    Args:
        value: what a JSON file held.
        where: the name of that file, for the message.

    Raises:
        ConfigError: naming the first place that is wrong.
    """
    if not isinstance(value, dict) or value.get("schema_version") != SCHEMA_VERSION:
        version = value.get("schema_version") if isinstance(value, dict) else None
        raise ConfigError(f"a benchmark of schema version {SCHEMA_VERSION}", f"version {version} in {where}",
                          "choose another file, or --anew to forget it")
    problem = _problem(value, Benchmark, where)
    records = [] if problem else [identity(record) for record in value["records"]]
    if len(set(records)) < len(records):
        twice = next(r for r in records if records.count(r) > 1)
        problem = f"{where}.records", "each fit and case once", f"{twice} twice"
    for number, record in enumerate([] if problem else value["records"]):
        if record["suite"] in OF_TASKS and ("left_out" in record) != (record["kind"] == "capture"):
            problem = f"{where}.records.{number}", "left_out of a capture, and of nothing else", str(
                record["kind"])
    if problem:
        place, expected, got = problem
        raise ConfigError(f"{expected} at {place}", got, "choose another file, or --anew to forget it")
    return value  # type: ignore[return-value]


def _problem(value: Any, kind: Any, place: str) -> tuple[str, str, str] | None:
    """Where a value is not of a type: place, expected, got; None where it is."""
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return None
    if is_typeddict(kind):
        return _of_dict(value, kind, place)
    if origin in (Union, types.UnionType):
        if all(map(is_typeddict, arguments)):  # the suite tells which
            suite = value.get("suite") if isinstance(value, dict) else None
            arguments = tuple(a for a in arguments if suite in get_args(_hints(a)["suite"])) or arguments[:1]
        problems = [_problem(value, a, place) for a in arguments]
        return None if None in problems else problems[0]
    if origin is Literal:
        return None if value in arguments else (place, f"one of {list(arguments)}", repr(value))
    if origin in (list, dict):
        if not isinstance(value, origin):
            return place, f"a {origin.__name__}", repr(value)[:60]
        inside = value.items() if origin is dict else enumerate(value)
        return next(filter(None, (_problem(v, arguments[-1], f"{place}.{k}") for k, v in inside)), None)
    if kind is float:
        right = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    else:
        right = value is None if kind in (None, type(None)) else type(value) is kind
    return None if right else (place, getattr(kind, "__name__", str(kind)), repr(value)[:60])


_hints = functools.cache(get_type_hints)


def _of_dict(value: Any, kind: Any, place: str) -> tuple[str, str, str] | None:
    hints = _hints(kind)
    if not isinstance(value, dict) or not kind.__required_keys__ <= set(value) <= set(hints):
        got = sorted(value) if isinstance(value, dict) else repr(value)[:60]
        return place, f"the fields {sorted(hints)}", str(got)
    return next(filter(None, (_problem(value[name], hint, f"{place}.{name}") for name, hint in hints.items()
                              if name in value)), None)
