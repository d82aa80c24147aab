"""Seconds of whole jobs, one or several in turn."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
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


def in_turns(jobs: Mapping[K, Callable[[], T]], repeats: int,
             report: Callable[[float], object] = lambda share: None) -> dict[K, list[T]]:
    """What each job returned. Jobs run in turn, ``repeats`` times: drift of the machine hits all alike."""
    found: dict[K, list[T]] = {name: [] for name in jobs}
    for turn in range(repeats):
        for number, (name, job) in enumerate(jobs.items(), 1):
            found[name].append(job())
            report((turn + number / len(jobs)) / repeats)
    return found
