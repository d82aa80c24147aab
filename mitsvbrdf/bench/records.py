"""The records of a benchmark as its JSON has them: one class for each suite, and the whole file."""

from __future__ import annotations

from typing import Any, Literal, TypedDict


class Spread(TypedDict):
    """Repeated timings, in seconds: median and quartiles."""

    median: float
    low: float
    high: float
    repeats: int


class Made(TypedDict, total=False):
    """How a record was made; ``workers``: how many there were when its job ended, left out where it was
    one.
    """

    workers: int


class OfTask(Made, total=False):
    """What is fitted; ``left_out``: numbers of the photos of a real capture that the fit does not see, part
    of its key.
    """

    left_out: list[int]


class OfRun(OfTask):
    """One run of a method.

    ``seconds`` by the loop's clock, ``wall`` with preparation and reckoning. ``errors`` of a known
    ``material``: each map, ``mean``, ``novel_light``, ``photos``; of a real ``capture``: ``seen``,
    ``left_out``, those of its photos.
    """

    method: str
    name: str
    seed: int
    config: dict[str, Any]
    seconds: float
    wall: float
    iterations: int
    stopped: str
    errors: dict[str, float]


class RenderRow(TypedDict):
    """One renderer of a case.

    ``image`` is the mean relative error over texels of roughness 0.1 and more, ``gradient`` the relative L2
    error of the worst map there, ``forward`` a picture without gradients, ``both`` forward and backward.
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


class FitRecord(OfRun):
    """One fit.

    ``errors`` also have the mean FLIP of pictures, ``flip_novel_light`` and so on, where its package was
    there; none of a fit that failed, which ``why`` explains. A fit has no record where it would repeat one of
    a shorter budget (:func:`mitsvbrdf.bench.behaviour.ended_for_good`).
    """

    suite: Literal["methods", "ablation", "gan"]
    kind: Literal["material", "capture"]
    budget: float
    why: str | None


class CaptureRecord(Made):
    """One capture made without calibration.

    Of a known ``material`` by the simulated phone, with or without ``sheet``, or a real ``capture`` whose
    views were taken away. ``seconds`` by stage; ``errors`` as :mod:`mitsvbrdf.bench.from_phone` counts them,
    none of what failed, which ``why`` explains.
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
    """What the fits of one material or capture are compared with; ``errors``: whose -> error -> value, named
    as in a fit.
    """

    suite: Literal["references"]
    kind: Literal["material", "capture"]
    name: str
    config: dict[str, Any]
    errors: dict[str, dict[str, float]]


class ScheduleRecord(OfRun):
    """One run of the paper's schedule: ``errors`` of its result; ``trace`` has those of the state, iteration
    and seconds.
    """

    suite: Literal["schedule"]
    kind: Literal["material", "capture"]
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
    """A picture of one material's maps by several methods; ``errors``: whose -> map -> RMSE, as written on
    it.
    """

    suite: Literal["sheets"]
    kind: Literal["material"]
    name: str
    config: dict[str, Any]
    file: str
    errors: dict[str, dict[str, float]]


class StiffRecord(OfRun):
    """One fit of a stiff scene, a ``case`` or a member of a ``series``.

    ``condition``, ``attainable`` and ``start`` belong to the scene
    (:attr:`mitsvbrdf.bench.stiff.scenes.StiffTask.known`). ``errors``: each map and their ``mean`` where
    there is a truth, ``photos``, and ``photos_start``; ``stated``: the deviations that the fit gives, as
    ``attainable``; ``near``: when the photos' error was within a tenth of the final one; ``undone`` and
    ``restarts``: steps taken back, returns to an earlier state. None of a fit that failed, which ``why``
    explains.
    """

    suite: Literal["stiff"]
    kind: Literal["case", "series"]
    budget: float
    condition: dict[str, float | None]
    attainable: dict[str, float]
    start: dict[str, float]
    why: str | None
    stated: dict[str, float]
    near: dict[str, float]
    undone: int
    restarts: int
    warnings: list[str]


class StartRow(TypedDict):
    """Processes with one state of Dr.Jit's kernel cache.

    ``wall`` from the start of a process to its end; of it ``imports`` (Python and torch), ``preparation`` up
    to the loop (Mitsuba, photos, the first guess), the ``loop`` and ``writing`` the result after it;
    ``iterations`` of the loop.
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


class LeaveOutRecord(OfTask):
    """A part of a fit, with it and without it in turn, on one scene.

    ``method`` names the pair, ``of`` the method that ``part`` belongs to, ``says`` the names by which ``fit
    --explain`` says that it is left out; ``put_in``: the program leaves it out by itself. ``kind`` of the
    scene, of so many ``photos``; ``config``: the settings of both. By ``with`` and ``without``: ``seconds``
    of each turn on the wall and ``errors`` as :class:`FitRecord` has them; ``spent``: seconds by part of the
    work, of the fit as the program decides it.
    """

    suite: Literal["leave-out"]
    method: str
    kind: Literal["exact", "exact, matte", "exact, noisy", "cameras off", "real photos"]
    name: str
    config: dict[str, Any]
    part: str
    says: list[str]
    of: str
    put_in: bool
    photos: int
    seconds: dict[str, list[float]]
    spent: dict[str, float]
    errors: dict[str, dict[str, float]]


class LeaveOutRenderRecord(Made):
    """A thing that a scene may do without, with it and without it in turn: forward and backward, or steps of
    a fit.

    ``where``: what renders; ``says`` as above; ``why`` it is not needed. ``worst`` and ``mean`` relative
    difference of the two; ``full_error`` and ``lean_error``, the worst of each against float64, None without
    a twin (two float32 results may differ by their sum); ``seconds`` of ``full`` and ``lean``.
    """

    suite: Literal["leave-out-renders"]
    where: str
    name: str
    config: dict[str, Any]
    says: list[str]
    why: str
    worst: float
    mean: float
    full_error: float | None
    lean_error: float | None
    seconds: dict[str, Spread]


class Benchmark(TypedDict):
    """The whole file.

    ``published``: kind -> name -> whose -> error -> value, of what was fitted here. The kind of real captures
    is followed by the numbers of the photos left out, such as "capture 4,7" (:func:`capture_kind`).
    """

    schema_version: Literal[2]
    settings: dict[str, Any]
    machine: dict[str, Any]
    versions: dict[str, str | None]
    seeds: list[int]
    published: dict[str, dict[str, dict[str, dict[str, float]]]]
    records: list[RenderRecord | FitRecord | CaptureRecord | ReferenceRecord | ScheduleRecord | StepRecord
                  | SheetRecord | StartRecord | StiffRecord | LeaveOutRecord | LeaveOutRenderRecord]
