"""How a batch runs, whatever it fits."""

from __future__ import annotations

import os
from dataclasses import dataclass

from ..errors import ConfigError

HEADROOM = 0.9  # of the memory that is free when the batch begins, for its workers together
LEAST_GIB = 1.5  # a worker holds about 0.7 GiB before it fits, and so much at 256 px


@dataclass(frozen=True)
class BatchSettings:
    """Workers and their limits."""

    workers: int | None = None
    """How many fit at a time. Left out: one a core, fewer where memory is short; on a cluster as many as its
    cores allow."""
    threads: int = 1
    """Threads of each worker."""
    address: str | None = None
    """A Ray cluster to join: auto, HOST:PORT or ray://HOST:PORT. Left out: a Ray of its own, on this machine
    alone."""
    retries: int = 2
    """How often a fit is tried again that crashed or took more time or memory than it may."""
    timeout: float | None = None
    """Seconds that a fit may take. Left out: 3 minutes and 3 times its budget, more where much is read or
    written."""
    memory: float | None = None
    """GiB that a worker may take. Left out: an equal share of what is free here; on a cluster, no limit."""
    retry_failed: bool = False
    """Try again what failed in an earlier run."""
    dashboard: bool = False
    """Let Ray show its dashboard, on this machine alone."""

    def check(self) -> None:
        """Raise ConfigError for numbers out of range."""
        least = {"workers": 1, "threads": 1, "retries": 0}
        for name, value in {name: getattr(self, name) for name in (*least, "timeout", "memory")}.items():
            if value is not None and not (value >= least[name] if name in least
                                          else 0 < value < float("inf")):
                raise ConfigError(f"--{name} of {least[name]} or more" if name in least else f"--{name} > 0",
                                  str(value),
                                  "give such a number")

    def local_workers(self) -> int:
        """How many workers this machine has room for."""
        if self.workers:
            return self.workers
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        room = free_gib() / (self.memory or LEAST_GIB)
        return max(1, min(cores // self.threads, int(room)))

    def local_memory(self, workers: int) -> float | None:
        """GiB that each of so many workers may take here; None is no limit."""
        return self.memory or (round(HEADROOM * free_gib() / workers, 2) if free_gib() < float("inf")
                               else None)


def free_gib() -> float:
    """Memory that is free on this machine in GiB; infinity where it cannot be told."""
    try:
        with open("/proc/meminfo") as lines:
            return next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable")) / 2**20
    except (OSError, StopIteration, ValueError):
        return float("inf")
