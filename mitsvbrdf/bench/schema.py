"""The JSON of a benchmark, version 2: what it holds, and whether a file is one."""

from __future__ import annotations

import functools
import math
import types
from collections.abc import Sequence
from typing import Any, Literal, TypedDict, Union, get_args, get_origin, get_type_hints, is_typeddict

from ..errors import ConfigError

SCHEMA_VERSION: Literal[2] = 2
OF_TASKS = "methods", "ablation", "gan", "references", "schedule"  # suites whose records are of an :class:`OfTask`
LEFT_OUT = (4, 7)  # numbers of the photos that fits of real captures do not see, where nothing else is said


class Spread(TypedDict):
    """Repeated timings, in seconds: median and quartiles."""

    median: float
    low: float
    high: float
    repeats: int


class Made(TypedDict, total=False):
    """How a record was made; ``workers``: how many jobs were done at a time, left out where it was one."""

    workers: int


class OfTask(Made, total=False):
    """What is fitted; ``left_out``: numbers of the photos of a real capture that the fit does not see, part of its key."""

    left_out: list[int]


class RenderRow(TypedDict):
    """One renderer of a case.

    ``image`` is the mean relative error over texels of roughness 0.1 and more, ``gradient`` the relative L2 error of the
    worst map there, ``forward`` a picture without gradients, ``both`` forward and backward.
    """

    renderer: str
    samples: int
    image: float
    gradient: float
    forward: Spread
    both: Spread


class RenderRecord(Made):
    """One case of the suite ``renderers``; ``truth``: texel centres, or averages over pixels."""

    suite: Literal["renderers"]
    bsdf: Literal["roughconductor", "principled"]
    resolution: int
    views: int
    truth: Literal["texels", "pixels"]
    config: dict[str, Any]
    rows: list[RenderRow]
    skipped: list[dict[str, str]]


class FitRecord(OfTask):
    """One fit.

    ``seconds`` by the loop's clock, ``wall`` with preparation and reckoning. ``errors`` of a known ``material``: each map,
    ``mean``, ``novel_light``, ``photos``; of a real ``capture``: ``seen``, ``left_out``; of pictures also the mean FLIP,
    ``flip_novel_light`` and so on, where its package was there; none of a fit that failed, which ``why`` explains. A fit has
    no record where it would repeat one of a shorter budget (:func:`mitsvbrdf.bench.behaviour.ended_for_good`).
    """

    suite: Literal["methods", "ablation", "gan"]
    method: str
    kind: Literal["material", "capture"]
    name: str
    budget: float
    seed: int
    config: dict[str, Any]
    seconds: float
    wall: float
    iterations: int
    stopped: str
    why: str | None
    errors: dict[str, float]


class CaptureRecord(Made):
    """One capture made without calibration.

    Of a known ``material`` by the simulated phone, with or without ``sheet``, or a real ``capture`` whose views were taken
    away. ``seconds`` by stage; ``errors`` as :mod:`mitsvbrdf.bench.from_phone` counts them, none of what failed, which
    ``why`` explains.
    """

    suite: Literal["capture"]
    kind: Literal["material", "capture"]
    name: str
    sheet: bool
    config: dict[str, Any]
    seconds: dict[str, float]
    errors: dict[str, float]
    stopped: Literal["done", "failed"]
    why: str | None


class ReferenceRecord(OfTask):
    """What the fits of one material or capture are compared with; ``errors``: whose -> error -> value, named as in a fit."""

    suite: Literal["references"]
    kind: Literal["material", "capture"]
    name: str
    config: dict[str, Any]
    errors: dict[str, dict[str, float]]


class ScheduleRecord(OfTask):
    """One run of the paper's schedule: ``errors`` of its result; ``trace`` has those of the state, iteration and seconds."""

    suite: Literal["schedule"]
    method: str
    kind: Literal["material", "capture"]
    name: str
    seed: int
    config: dict[str, Any]
    seconds: float
    wall: float
    iterations: int
    stopped: str
    errors: dict[str, float]
    trace: list[dict[str, float]]


class StepRow(TypedDict):
    """One version of an iteration; ``parts``: the share of each part of it."""

    version: Literal["now", "earlier"]
    bfloat16: bool
    seconds: Spread
    parts: dict[str, float]


class StepRecord(Made):
    """Iterations of one preset of ``gan``; ``ratio`` is how many times as long the earlier version takes."""

    suite: Literal["steps"]
    preset: str
    resolution: int
    width: int
    config: dict[str, Any]
    rows: list[StepRow]
    ratio: Spread


class SheetRecord(Made):
    """A picture of one material's maps by several methods; ``errors``: whose -> map -> RMSE, as written on it."""

    suite: Literal["sheets"]
    kind: Literal["material"]
    name: str
    config: dict[str, Any]
    file: str
    errors: dict[str, dict[str, float]]


class StiffRecord(Made):
    """One fit of a stiff scene, a ``case`` or a member of a ``series``.

    ``condition``, ``attainable`` and ``start`` belong to the scene (:attr:`mitsvbrdf.bench.stiff.scenes.StiffTask.known`).
    ``errors``: each map and their ``mean`` where there is a truth, ``photos``, and ``photos_start``; ``stated``: the
    deviations that the fit gives, as ``attainable``; ``near``: when the photos' error was within a tenth of the final one;
    ``undone`` and ``restarts``: steps taken back, returns to an earlier state. None of a fit that failed, which ``why``
    explains.
    """

    suite: Literal["stiff"]
    method: str
    kind: Literal["case", "series"]
    name: str
    budget: float
    seed: int
    config: dict[str, Any]
    condition: dict[str, float | None]
    attainable: dict[str, float]
    start: dict[str, float]
    seconds: float
    wall: float
    iterations: int
    stopped: str
    why: str | None
    errors: dict[str, float]
    stated: dict[str, float]
    near: dict[str, float]
    undone: int
    restarts: int
    warnings: list[str]


class StartRow(TypedDict):
    """Processes with one state of Dr.Jit's kernel cache.

    ``wall`` from the start of a process to its end; of it ``imports`` (Python and torch), ``preparation`` up to the loop
    (Mitsuba, photos, the first guess), the ``loop`` and ``writing`` the result after it; ``iterations`` of the loop.
    """

    cache: Literal["empty", "full"]
    wall: Spread
    imports: Spread
    preparation: Spread
    loop: Spread
    writing: Spread
    iterations: Spread


class StartRecord(Made):
    """``mitsvbrdf fit`` of one capture by one method, each time in a new process."""

    suite: Literal["start"]
    method: str
    kind: Literal["capture"]
    name: str
    config: dict[str, Any]
    rows: list[StartRow]


class Benchmark(TypedDict):
    """The whole file.

    ``published``: kind -> name -> whose -> error -> value, of what was fitted here. The kind of real captures is followed by
    the numbers of the photos left out, such as "capture 4,7" (:func:`capture_kind`).
    """

    schema_version: Literal[2]
    settings: dict[str, Any]
    machine: dict[str, Any]
    versions: dict[str, str | None]
    seeds: list[int]
    published: dict[str, dict[str, dict[str, dict[str, float]]]]
    records: list[RenderRecord | FitRecord | CaptureRecord | ReferenceRecord | ScheduleRecord | StepRecord | SheetRecord
                  | StartRecord | StiffRecord]


def identity(record: dict) -> tuple:
    """What no two records of a file share."""
    names = {"renderers": ("suite", "bsdf", "resolution", "views", "truth"), "capture": ("suite", "kind", "name", "sheet"),
             "references": ("suite", "kind", "name"), "sheets": ("suite", "kind", "name"),
             "schedule": ("suite", "method", "kind", "name", "seed"), "start": ("suite", "method", "kind", "name"),
             "steps": ("suite", "preset", "resolution", "width")}
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
            problem = f"{where}.records.{number}", "left_out of a capture, and of nothing else", str(record["kind"])
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
