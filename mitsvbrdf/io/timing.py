"""Run times of whole jobs in seconds."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import ParamSpec, TypeVar

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
