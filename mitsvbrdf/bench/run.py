"""Fit every task by every method, with every budget and seed; each fit is one line of a file."""

import contextlib
import functools
import math
import os
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict, get_args, get_type_hints

import msgspec

from .. import __version__
from ..capture import Capture
from ..errors import ConfigError, MitsvbrdfError
from ..evaluate.photos import evaluate_fit
from ..fit import DirectConfig, Fit, FitConfig, fit_svbrdf
from ..fit.methods import METHODS
from ..io import Report, files
from ..io.provenance import machine
from ..io.timing import timed
from ..render import Renderer
from .tasks import Predict, Task


class Record(TypedDict):
    """One fit: its key (the fields that identify the fit) and its results.

    ``seconds`` is the time of the loop; ``wall`` includes the preparation before and the diagnosis after it.
    ``errors`` is what the task measures. A failed fit has no errors, and ``why`` states the reason.
    """

    method: str
    kind: Literal["material", "capture"]
    name: str
    resolution: int
    views: NotRequired[str]
    held_out: NotRequired[list[int]]
    content: NotRequired[str]  # digest of photos, maps and views; version 1 does not state it
    config: dict[str, Any]
    renderer: str
    budget: float
    seed: int
    version: str
    machine: dict[str, Any]
    seconds: float
    wall: float
    iterations: int
    stopped: str
    why: str | None
    errors: dict[str, float]


BEGUN = b'{"method":'  # what every record begins with
RESULTS = ("seconds", "wall", "iterations", "stopped", "why", "errors")  # the other fields are the key


@dataclass(frozen=True)
class Job:
    """One fit to be done. Its fields are also in its record."""

    method: str
    task: Task
    config: FitConfig
    budget: float
    seed: int

    def key(self, renderer: Renderer) -> dict[str, Any]:
        """The fields that identify its record."""
        return {"method": self.method, **self.task.key, "config": settings_of(self.config),
                "renderer": f"{renderer.name} {renderer.variant or ''}".strip(), "budget": float(self.budget),
                "seed": self.seed, "version": version(), "machine": machine()}


def method_table() -> dict[str, FitConfig]:
    """A dict: name to settings, for each method of ``fit``, and for each preset that is not its default."""
    table: dict[str, FitConfig] = {}
    for name, config in METHODS.items():
        table[name] = default = config()
        presets = get_args(get_type_hints(config).get("preset"))
        table |= {f"{name}-{preset.removeprefix('paper-')}": config(preset=preset)  # type: ignore[call-arg]
                  for preset in presets if preset != getattr(default, "preset", None)}
    return table


def run(methods: Mapping[str, FitConfig], tasks: Sequence[Task], budgets: Sequence[float],
        seeds: Sequence[int], renderer: Renderer, path: Path,
        report: Report = lambda text, share: None) -> list[Record]:
    """Do the fits whose records are missing; write each record as soon as its fit ends.

    Methods take turns, so that drift of the machine affects all of them. The first seed is done before the
    next one, and short budgets before long ones. A method without randomness has only the first seed. The
    file at ``path`` has one JSON object a line. An existing file is continued. Returns the records asked for,
    of this version and machine, in the order of the fits.

    ConfigError, OutputError: the file contains something else, or cannot be written. KeyboardInterrupt:
    Ctrl-C; the records of finished fits are kept.
    """
    jobs = [Job(method, task, config, budget, seed)
            for seed in seeds for budget in sorted(budgets) for task in tasks
            for method, config in methods.items() if seed == seeds[0] or not isinstance(config, DirectConfig)]
    path, found, warm = Path(path), dict[str, Record](), set[tuple]()
    if path.exists():
        found = {identity(record): record for record in read_records(path)}
        with path.open("r+b") as file:  # an unfinished last line is removed
            file.truncate(file.read().rfind(b"\n") + 1)
    keys = [job.key(renderer) for job in jobs]
    missing = [(job, key) for job, key in zip(jobs, keys) if identity(key) not in found]
    for number, (job, key) in enumerate(missing):
        title = f"{job.method}, {job.task.name}, {job.budget:g} s, seed {job.seed}"

        def tell(share: float, number: int = number, title: str = title) -> None:
            report(f"{title} ({number + 1} of {len(missing)})", (number + share) / len(missing))

        tell(0.0)
        _warm_up(job, renderer, warm)
        found[identity(key)] = _fitted(job, key, renderer, tell)
        append(path, found[identity(key)])
    return [found[identity(key)] for key in keys]


def read_records(path: Path) -> list[Record]:
    """The records of a file. An unfinished last line, which a killed run can leave, is ignored.

    ConfigError: the file cannot be read, or contains something else.
    """
    what, fix = "records of a benchmark, one JSON object a line", "choose another --json"
    try:
        with files.open_regular(Path(os.path.realpath(path))) as file:
            *lines, torn = file.read().split(b"\n")
    except OSError as reason:
        raise ConfigError(what, f"{path}: {reason.strerror or reason}", fix) from None
    if torn and not torn.startswith(BEGUN) and not BEGUN.startswith(torn):
        raise ConfigError(what, f"{path}, whose last line is no begun record", fix)
    found = []
    for number, line in enumerate(lines, 1):
        try:
            found.append(msgspec.json.decode(line, type=Record))
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as reason:
            raise ConfigError(what, f"{path}, line {number}: {reason}", fix) from None
    return found


def append(path: Path, record: Record) -> None:
    """Add one record to a file, in one write that reaches the disk."""
    files.check_output(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab", buffering=0) as file:
        file.write(msgspec.json.encode(record) + b"\n")
        os.fsync(file.fileno())


def identity(record: Mapping[str, Any]) -> str:
    """The key of a record as text."""
    key = {name: value for name, value in record.items() if name not in RESULTS}
    return msgspec.json.encode(key, order="sorted").decode()


def settings_of(config: FitConfig) -> dict[str, Any]:
    """For JSON: the class, and the settings that are not its defaults, without budget and seed."""
    own = asdict(type(config)())
    changed = {name: value for name, value in asdict(config).items()
               if value != own[name] and name not in ("budget", "seed")}
    return msgspec.to_builtins({"class": type(config).__name__} | changed, enc_hook=str)


@functools.cache
def version() -> str:
    """The version of mitsvbrdf. In a git checkout it has the commit, and ``-dirty`` if a file has changed."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return __version__
    with contextlib.suppress(OSError, subprocess.CalledProcessError):  # no git here
        done = subprocess.run(["git", "-c", f"safe.directory={root}", "-C", str(root), "describe", "--always",
                               "--dirty", "--exclude=*"], capture_output=True, text=True, check=True)
        return f"{__version__}+{done.stdout.strip()}"
    return __version__


def fit(capture: Capture, renderer: Renderer, config: FitConfig,
        report: Callable[[float], None]) -> tuple[Fit, Predict]:
    """One fit, and a function that gives its error on photos. Light falls off as the method assumes.

    KeyboardInterrupt: Ctrl-C ended the fit. MitsvbrdfError: the fit is refused, or its budget ends before the
    first step.
    """
    def lit(shots: Capture) -> Capture:
        return shots.but(views=replace(shots.views, falloff=config.falloff))

    result = fit_svbrdf(lit(capture), renderer, config, report=lambda entry, share: report(share))
    if result.stopped == "interrupted":
        raise KeyboardInterrupt
    if result.trace[-1]["iteration"] == 0:
        raise ConfigError("a fit of one step or more", "none in the budget", "give a longer budget")

    def predicted(shots: Capture) -> float:
        return float(evaluate_fit(result, lit(shots))["rerender_rmse"])

    return result, predicted


def _fitted(job: Job, key: dict, renderer: Renderer, tell: Callable[[float], None]) -> Record:
    """Do one fit; return its record. A fit that fails has a record without errors, with the reason."""
    config = replace(job.config, budget=job.budget, seed=job.seed)
    try:
        (result, predicted), wall = timed(fit, job.task.photos, renderer, config, tell)
        errors = job.task.errors(result.svbrdf, predicted)
        if wrong := [name for name, value in errors.items() if not math.isfinite(value)]:
            raise ConfigError("finite errors", f"{', '.join(wrong)} not finite", "report it")
    except MitsvbrdfError as reason:
        return {**key, "seconds": 0.0, "wall": 0.0, "iterations": 0, "stopped": "failed", "why": str(reason),
                "errors": {}}  # type: ignore[typeddict-item]
    last = result.trace[-1]
    return {**key, "seconds": last["seconds"], "wall": wall, "iterations": last["iteration"],
            "stopped": result.stopped, "why": None, "errors": errors}  # type: ignore[typeddict-item]


def _warm_up(job: Job, renderer: Renderer, warm: set[tuple]) -> None:
    """Do two steps before the first fit of a shape: then kernels are compiled before any fit is measured."""
    photos = job.task.photos
    shape = job.method, len(photos), photos.resolution
    if shape not in warm:
        warm.add(shape)
        with contextlib.suppress(MitsvbrdfError):  # the measured fit reports it
            fit(photos, renderer, replace(job.config, budget=None, iterations=2, seed=job.seed),
                lambda share: None)
