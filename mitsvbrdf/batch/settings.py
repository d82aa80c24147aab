"""The settings of a batch that do not depend on what it fits."""

from dataclasses import dataclass

from ..errors import ConfigError
from ..io.provenance import memory_gib, usable_cores

HEADROOM = 0.9  # share of the memory free at the start of the batch that all workers together may use
LEAST_GIB = 1.5  # a worker uses about 0.7 GiB before it fits, and this much in a fit at 256 px
NO_LIMIT = float("inf")


@dataclass(frozen=True)
class BatchSettings:
    """Workers and their limits."""

    workers: int | None = None
    """Captures fitted at a time. Default: one a core; on this machine fewer if memory is short."""
    threads: int = 1
    """Threads of each worker."""
    address: str | None = None
    """Ray cluster to join: auto, HOST:PORT or ray://HOST:PORT. Default: a Ray on this machine alone."""
    retries: int = 2
    """How often a fit is tried again after it crashed, or took more time or memory than allowed."""
    timeout: float | None = None
    """Seconds a fit may take. Default: an hour plus 3 times the budget; no limit with --iterations alone."""
    memory: float | None = None
    """GiB that a worker may take. Default: an equal share of the free memory; no limit on a cluster."""
    retry_failed: bool = False
    """Fit again the captures that failed in an earlier run."""

    def check(self) -> None:
        """Raise ConfigError for numbers out of range."""
        for name, least in {"workers": 1, "threads": 1, "retries": 0}.items():
            value = getattr(self, name)
            if value is not None and value < least:
                raise ConfigError(f"--{name} of {least} or more", str(value), "give such a number")
        for name in ("timeout", "memory"):
            value = getattr(self, name)
            if value is not None and not 0 < value < NO_LIMIT:
                raise ConfigError(f"--{name} > 0", str(value), "give such a number")

    def local_workers(self) -> int:
        """How many workers run on this machine: ``workers``, or as many as cores and memory allow."""
        if self.workers:
            return self.workers
        return int(max(1, min(usable_cores() // self.threads, memory_gib()[1] // (self.memory or LEAST_GIB))))

    def local_memory(self) -> float | None:
        """GiB that each worker may take here; None is no limit."""
        share = HEADROOM * memory_gib()[1] / self.local_workers()
        return self.memory or (round(share, 2) if share < NO_LIMIT else None)
