"""Where a figure comes from: the machine, and the versions of what it was made with."""

import importlib.metadata
import os
import platform


def machine() -> dict[str, str | int | None]:
    """What a run time depends on: system, kind of CPU, cores, and the libLLVM in use."""
    return {"system": platform.system(), "cpu": platform.machine(), "cores": os.cpu_count(),
            "libllvm": os.path.basename(os.environ.get("DRJIT_LIBLLVM_PATH", "")) or None}


def versions() -> dict[str, str | None]:
    """Versions of Python and of the packages that a result depends on."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for name in ("mitsvbrdf", "mitsuba", "drjit", "torch", "numpy", "opencv-contrib-python-headless",
                 "OpenEXR", "av"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = None
    return found
