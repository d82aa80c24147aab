"""`mitsvbrdf` with fits that die where their capture holds a ``poison.txt``: a script."""

import functools
import os
import sys
import time
from pathlib import Path

from mitsvbrdf.batch import fitting
from mitsvbrdf.batch.tasks import RayTasks
from mitsvbrdf.cli import batch, main


def poisoned(task):
    """A fit that dies as its capture says."""
    source = Path(task["material"]["source"])

    def fit_capture(*words, fit=fitting.fit_capture):
        deed = (source / "poison.txt").read_text() if (source / "poison.txt").exists() else ""
        if deed == "hang":
            time.sleep(600)
        if deed == "eat":
            held = []
            while True:
                held.append(b"1" * (1 << 26))
                time.sleep(0.02)
        if deed == "abort":
            os.abort()
        if deed == "segfault":
            import ctypes
            ctypes.string_at(0)
        if deed == "exit":
            os._exit(7)
        return fit(*words)

    real, fitting.fit_capture = fitting.fit_capture, fit_capture
    try:
        yield from fitting.fit_task(task)
    finally:
        fitting.fit_capture = real


if __name__ == "__main__":
    batch.RayTasks = functools.partial(RayTasks, function=poisoned)
    sys.exit(main(sys.argv[1:]))
