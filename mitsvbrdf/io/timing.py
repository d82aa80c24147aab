"""Seconds of whole jobs, one or several in turn. :mod:`~mitsvbrdf.io.profile` has the parts of a fit."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import ParamSpec, TypeVar

K = TypeVar("K")
T = TypeVar("T")
P = ParamSpec("P")


def timed(job: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> tuple[T, float]:
    """What a job returns for these arguments, and the wall-clock seconds it took."""
    started = time.perf_counter()
    found = job(*args, **kwargs)
    return found, time.perf_counter() - started


def spread(seconds: Sequence[float]) -> dict[str, float]:
    """``median``, ``low`` and ``high`` (quartiles) of repeated timings, and their number as ``repeats``."""
    repeated = seconds if len(seconds) > 1 else [*seconds, *seconds]
    low, median, high = statistics.quantiles(repeated, n=4, method="inclusive")
    return {"median": median, "low": low, "high": high, "repeats": len(seconds)}


def side_by_side(jobs: Mapping[str, Callable[[], object]], repeats: int = 5) -> dict[str, dict[str, float]]:
    """The :func:`spread` of the seconds of each job, run :func:`in_turns`."""
    turns = in_turns({name: partial(timed, job) for name, job in jobs.items()}, repeats)
    return {name: spread([seconds for _, seconds in each]) for name, each in turns.items()}


def in_turns(jobs: Mapping[K, Callable[[], T]], repeats: int = 5, unmeasured: int = 1,
             report: Callable[[float], object] = lambda share: None) -> dict[K, list[T]]:
    """Run all jobs in turn, again and again: drift of the machine hits all alike.

    Turns before those that count, ``unmeasured``, compile and warm up; 0 for jobs that have run already.
    Gives what each job returned in the turns that count.
    """
    found: dict[K, list[T]] = {name: [] for name in jobs}
    for turn in range(unmeasured + repeats):
        for number, (name, job) in enumerate(jobs.items(), 1):
            found[name].append(job())
            report((turn + number / len(jobs)) / (unmeasured + repeats))
    return {name: each[unmeasured:] for name, each in found.items()}
