"""Where a result comes from: the machine, and the versions of the software."""

import contextlib
import importlib.metadata
import os
import platform
import re
from pathlib import Path

GROUPS, CPUS = Path("/sys/fs/cgroup"), Path("/proc/cpuinfo")
PACKAGES = ("mitsvbrdf", "mitsuba", "drjit", "torch", "numpy", "opencv-contrib-python-headless", "OpenEXR",
            "av")


def machine() -> dict[str, str | int | None]:
    """What a run time depends on: system, model of the CPU (else its kind), usable cores, libLLVM in use."""
    told = re.search(r"^model name\s*: (.+)", CPUS.read_text() if CPUS.exists() else "", re.MULTILINE)
    model = told[1].strip() if told else platform.processor() or platform.machine()
    return {"system": platform.system(), "cpu": model, "cores": usable_cores(),
            "libllvm": os.path.basename(os.environ.get("DRJIT_LIBLLVM_PATH", "")) or None}


def versions() -> dict[str, str | None]:
    """Versions of Python and of the packages that a result depends on."""
    return {"python": platform.python_version(), **{name: version_of(name) for name in PACKAGES}}


def version_of(distribution: str) -> str | None:
    """The version of a package; None if it is not installed."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def usable_cores() -> int:
    """How many cores this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for group in _groups():
        with contextlib.suppress(OSError, ValueError):  # "max" in the file means no limit
            quota, period = map(int, (group / "cpu.max").read_text().split())
            cores = min(cores, max(1, quota // period))
    return cores


def memory_gib() -> tuple[float, float]:
    """Total and available memory of this machine or container, in GiB; infinity: unknown."""
    total = free = float("inf")
    with contextlib.suppress(OSError, KeyError, ValueError):
        told = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        total, free = (int(told[name].split()[0]) / 2**20 for name in ("MemTotal", "MemAvailable"))
    for group in _groups():
        with contextlib.suppress(OSError, KeyError, ValueError):  # "max" in the file means no limit
            most, held = (int((group / f"memory.{what}").read_text()) for what in ("max", "current"))
            told = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
            total = min(total, most / 2**30)
            free = min(free, (most - held + int(told["inactive_file"])) / 2**30)
    return total, free


def _groups() -> list[Path]:
    """Folders of the control groups (version 2) of this process, which limit containers and jobs."""
    try:
        own = GROUPS / Path("/proc/self/cgroup").read_text().partition("0::/")[2].split("\n")[0]
    except OSError:
        return []
    return [each for each in (own, *own.parents) if each.is_relative_to(GROUPS)]
