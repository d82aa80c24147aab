"""Where a figure comes from: the machine, and the versions of what it was made with."""

import importlib.metadata
import os
import platform
from pathlib import Path

PACKAGES = ("mitsvbrdf", "mitsuba", "drjit", "torch", "numpy", "opencv-contrib-python-headless", "OpenEXR",
            "av")


def machine() -> dict[str, str | int | None]:
    """What a run time depends on: system, kind of CPU, cores, and the libLLVM in use."""
    return {"system": platform.system(), "cpu": platform.machine(), "cores": os.cpu_count(),
            "libllvm": os.path.basename(os.environ.get("DRJIT_LIBLLVM_PATH", "")) or None}


def versions() -> dict[str, str | None]:
    """Versions of Python and of the packages that a result depends on."""
    return {"python": platform.python_version(), **{name: version_of(name) for name in PACKAGES}}


def version_of(distribution: str) -> str | None:
    """The version of an installed package; None where it is not installed."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def usable_cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def memory_gib() -> tuple[float, float]:
    """Memory of this machine, all of it and what is available, in GiB; infinity where it cannot be told."""
    try:
        told = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        total, free = (int(told[name].split()[0]) / 2**20 for name in ("MemTotal", "MemAvailable"))
        return total, free
    except (OSError, KeyError, ValueError):
        return float("inf"), float("inf")
