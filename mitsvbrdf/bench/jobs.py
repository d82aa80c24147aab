"""Error against run time: a list of jobs, each one record of the benchmark's file.

``renderers`` holds every renderer against the float64 truth. ``methods`` fits known materials and real
captures with every method, each budget a fit of its own, for schedules follow the budget. ``ablation`` does
the same with the default method and with one of its ingredients after the other taken away; ``gan`` with what
lies between the paper's method and ours. ``capture`` goes from a phone's raw photos to maps.
:mod:`mitsvbrdf.bench.paper` has what only the paper's tables need.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

from ..errors import ConfigError, MitsvbrdfError
from ..fit import FitConfig
from ..io.timing import timed
from ..render import Renderer
from .behaviour import draws
from .from_phone import CaptureJob
from .methods import fit, settings_of
from .paper.references import ReferenceJob
from .paper.schedule import ScheduleJob
from .paper.sheets import SheetJob
from .paper.steps import StepJob
from .renderers import RenderJob
from .start import StartJob
from .store import Store
from .tasks import Task

Report = Callable[[str, float], None]

SECONDS_BESIDE_BUDGET = 3.0  # seconds a fit takes besides its budget, before there is anything to go by


@dataclass(frozen=True)
class FitJob:
    """One fit: a method with its own budget and seed on one material or capture.

    Args:
        suite: ``methods``, ``ablation`` or ``gan``.
        method: its name.
        config: its settings; budget and seed are set here.
        task: what is fitted.
        budget: seconds.
        seed: of the fit.
        renderer: carries the gradients.
    """

    suite: str
    method: str
    config: FitConfig
    task: Task
    budget: float
    seed: int
    renderer: Renderer

    @property
    def key(self) -> dict:
        """What identifies the record."""
        return {"suite": self.suite, "method": self.method, **self.task.key, "budget": self.budget,
                "seed": self.seed}

    @property
    def settings(self) -> dict:
        """What else shapes the record."""
        return settings_of(self.config)

    @property
    def title(self) -> str:
        """For the progress line."""
        left_out = self.task.key.get("left_out")
        without = f" without {' '.join(map(str, left_out))}" if left_out else ""
        return f"{self.method}, {self.task.name}{without}, {self.budget:g} s, seed {self.seed}"

    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
        return self.method

    @property
    def cost(self) -> float:
        """A guess of its seconds."""
        return self.budget + SECONDS_BESIDE_BUDGET

    @property
    def shape(self) -> tuple:
        """Fits of one shape run the same kernels."""
        return self.method, len(self.task.photos), self.task.photos.resolution

    def warm_up(self) -> None:
        """Two steps, so that no fit that counts waits for kernels."""
        fit(self.task.photos, self.renderer, replace(self.config, budget=None, iterations=2, seed=self.seed))

    def run(self, report: Callable[[float], None] = lambda share: None) -> dict:
        """The figures. A fit that cannot be done is a result too: it has no errors, and says why."""
        config = replace(self.config, budget=self.budget, seed=self.seed)
        try:
            found = fit(self.task.photos, self.renderer, config, lambda entry, share: report(share))
            errors = self.task.errors(found) | (self.task.looks(found) if find_spec("flip_evaluator") else {})
            check_finite(errors)
        except MitsvbrdfError as reason:
            return {"seconds": 0.0, "wall": 0.0, "iterations": 0, "stopped": "failed", "why": str(reason),
                    "errors": {}}
        return {"seconds": found.seconds, "wall": found.wall, "iterations": found.iterations,
                "stopped": found.stopped, "why": None, "errors": errors}


Job = FitJob | RenderJob | CaptureJob | ReferenceJob | ScheduleJob | StepJob | SheetJob | StartJob


class AnyJob(Protocol):
    """What :func:`run` needs of a job, of this benchmark or of another that keeps its records in such a
    file.
    """

    @property
    def key(self) -> dict:
        """What identifies the record."""
    @property
    def settings(self) -> dict:
        """What else shapes the record."""
    @property
    def title(self) -> str:
        """For the progress line."""
    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
    @property
    def cost(self) -> float:
        """A guess of its seconds."""

    def run(self, report: Callable[[float], None] = ...) -> dict:
        """The figures."""


def check_finite(figures: Mapping[str, float]) -> None:
    """Refuse figures that JSON has no number for.

    Raises:
        ConfigError: naming them.
    """
    wrong = [name for name, value in figures.items() if not math.isfinite(value)]
    if wrong:
        raise ConfigError("finite errors and deviations", f"{', '.join(wrong)} not finite", "report it")


def key_of(job: AnyJob) -> str:
    """What identifies a job and what shapes its record, as text."""
    return json.dumps([job.key, job.settings], sort_keys=True, default=str)


def new_pictures(jobs: Sequence[Job], store: Store) -> list[Path]:
    """The pictures that jobs will write beside the records; without those that earlier records name, which
    are ours.
    """
    known = {record.get("file") for record in (*store.records, *store.outdated)}
    return [job.path for job in jobs if isinstance(job, SheetJob) and job.path.name not in known]


def fit_jobs(suite: str, methods: Mapping[str, FitConfig], tasks: Sequence[Task], budgets: Sequence[float],
             seeds: Sequence[int], renderer: Renderer) -> list[FitJob]:
    """Every method on every task with every budget and seed; methods take turns, so that drift of the machine
    hits all.

    The first seed is done before the next one, and short budgets before long ones, which a fit that ends by
    itself does not need. A method without randomness has the first seed alone.
    """
    return [FitJob(suite, method, config, task, budget, seed, renderer)
            for seed in seeds for budget in sorted(budgets) for task in tasks
            for method, config in methods.items() if seed == seeds[0] or draws(config)]


def warm_up(job: AnyJob, warm: set[tuple]) -> None:
    """Two steps before the first fit of a shape, so that none that counts waits for kernels; what fails, the
    fit itself tells.

    Args:
        job: that comes next.
        warm: the shapes that had their steps; this one is added.
    """
    if isinstance(job, FitJob) and job.shape not in warm:
        warm.add(job.shape)
        with contextlib.suppress(Exception):
            job.warm_up()


def run(jobs: Sequence[AnyJob], store: Store, report: Report = lambda text, share: None) -> dict[str, str]:
    """Do the jobs whose records are missing and needed, and keep each record as soon as it is there.

    A job that fails ends no other.

    Args:
        jobs: in the order in which they run.
        store: the file.
        report: told what is going on, with the time left, and the share done.

    Returns:
        Why jobs have no record, by title.

    Raises:
        ConfigError, OutputError: a record cannot be kept.
        KeyboardInterrupt: after Ctrl-C; what was done is kept.
    """
    pending, forecast, warm, failed = store.pending(list(jobs)), _Forecast(), set[tuple](), dict[str, str]()
    whole = sum(job.cost for job in pending)
    for number, job in enumerate(pending):
        if store.repeats(job):
            continue
        done, later = sum(j.cost for j in pending[:number]), forecast.left(pending[number + 1:])
        text = f"{job.title} ({number + 1} of {len(pending)})"

        def tell(share: float, job: AnyJob = job, done: float = done, later: float = later,
                 text: str = text) -> None:
            left = forecast.left([job]) * (1 - share) + later
            report(f"{text}, {duration(left)} left", (done + share * job.cost) / whole)

        tell(0.0)
        warm_up(job, warm)
        try:
            figures, seconds = timed(job.run, tell)
        except Exception as reason:  # as the workers of a batch have it
            failed[job.title] = (str(reason) if isinstance(reason, MitsvbrdfError)
                                 else f"{type(reason).__name__}: {reason}")
            continue
        forecast.learn(job, seconds)
        store.add(job.key | {"config": job.settings} | figures)
    return failed


class _Forecast:
    """How long the jobs still to come will take: their guesses, scaled by what jobs of their group took
    beside theirs.
    """

    def __init__(self) -> None:
        self.taken: dict[str, tuple[float, float]] = {}

    def learn(self, job: AnyJob, seconds: float) -> None:
        """A job has taken this long."""
        taken, guessed = self.taken.get(job.group, (0.0, 0.0))
        self.taken[job.group] = taken + seconds, guessed + job.cost

    def left(self, jobs: Sequence[AnyJob]) -> float:
        """Seconds that these jobs will take, one after the other."""
        total = 0.0
        for job in jobs:
            taken, guessed = self.taken.get(job.group, (1.0, 1.0))
            total += job.cost * taken / guessed
        return total


def duration(seconds: float) -> str:
    """A rough time as people say it: 40 s, 12 min, 3 h 20 min."""
    minutes = round(seconds / 60)
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
