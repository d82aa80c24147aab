"""``mitsvbrdf fit`` from the start of its process to its end, with an empty kernel cache and with a full
one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import BackendError
from ..fit import live
from ..io.timing import spread
from ..render import RendererName
from ..render.llvm import STATED, VARIABLE
from . import start_child
from .code import method_module, own_code

CACHE = "DRJIT_CACHE_DIR"  # where Dr.Jit keeps compiled kernels; by default in ~/.drjit
CHILD = (sys.executable, "-P", "-m", start_child.__name__)
SECONDS_BESIDE_BUDGET = 15.0  # of a process, before there is anything to go by


@dataclass(frozen=True)
class StartJob:
    """One capture and one method.

    Args:
        source: the capture, a folder.
        method: its name.
        resolution: of the fit.
        budget: seconds.
        repeats: processes with each state of the cache.
        renderer: what the fits render with.
        variant: Mitsuba's.
    """

    source: str
    method: str
    resolution: int
    budget: float
    repeats: int
    renderer: RendererName = "mitsuba"
    variant: str = "llvm_ad_rgb"

    @property
    def key(self) -> dict:
        """What identifies the record."""
        return {"suite": "start", "method": self.method, "kind": "capture", "name": Path(self.source).name}

    @property
    def settings(self) -> dict:
        """What else shapes the record."""
        return {"resolution": self.resolution, "budget": self.budget, "repeats": self.repeats,
                "renderer": self.renderer,
                "variant": self.variant, "code": own_code(__name__, live.__name__,
                                                          method_module(self.method))}

    @property
    def title(self) -> str:
        """For the progress line."""
        return f"start, {self.method}, {self.key['name']}"

    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
        return "start"

    @property
    def cost(self) -> float:
        """A guess of its seconds."""
        return 2 * self.repeats * (self.budget + SECONDS_BESIDE_BUDGET)

    def run(self, report: Callable[[float], object] = lambda share: None) -> dict:
        """The figures: ``rows``, one with an empty and one with a full cache.

        Raises:
            BackendError: the command failed.
        """
        found: dict[str, list[dict[str, float]]] = {"empty": [], "full": []}
        for turn in range(self.repeats):
            with tempfile.TemporaryDirectory() as folder:  # the user's own cache is neither read nor changed
                # the second process finds what the first one compiled
                for number, each in enumerate(found.values()):
                    each.append(self._process(Path(folder), f"out{number}"))
                    report((2 * turn + number + 1) / (2 * self.repeats))
        return {"rows": [{"cache": cache} | {part: spread([one[part] for one in each]) for part in each[0]}
                         for cache, each in found.items()]}

    def _process(self, folder: Path, out: str) -> dict[str, float]:
        """Seconds of one process and of its parts, and the iterations of its loop."""
        marks = folder / "marks.json"
        # this process has set its own
        usual = {name: value for name, value in os.environ.items() if name != VARIABLE}
        stated = {} if STATED is None else {VARIABLE: STATED}
        environment = {"OMP_WAIT_POLICY": "PASSIVE"} | usual | stated | {CACHE: str(folder / "kernels")}
        command = ["fit", os.path.abspath(self.source), "-o", str(folder / out), "--method", self.method,
                   "--budget", f"{self.budget:g}", "--resolution", str(self.resolution), "--renderer",
                   self.renderer,
                   "--variant", self.variant]
        began = time.monotonic()
        child = subprocess.run([*CHILD, str(marks), *command], env=environment,
                               stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace")
        ended = time.monotonic()
        if child.returncode or not marks.is_file():
            said = child.stderr.strip().splitlines()[-1:] or ["no message"]
            raise BackendError("mitsvbrdf fit to end well in a process of its own", said[0],
                               "try that command by itself")
        at = json.loads(marks.read_text())
        return {"wall": ended - began, "imports": at["imported"] - began,
                "preparation": at["loop"] - at["imported"],
                "loop": at["looped"] - at["loop"], "writing": ended - at["looped"],
                "iterations": at["iterations"]}
