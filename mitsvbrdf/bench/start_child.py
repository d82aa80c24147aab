"""The process that :mod:`mitsvbrdf.bench.start` times: ``python -m mitsvbrdf`` that notes when its parts
begin.

The first argument is the file for these notes, by the clock that all processes share; the others are those of
the command.
"""

from __future__ import annotations

import json
import runpy
import sys
import time
from pathlib import Path
from unittest.mock import patch

from ..fit.loop import Loop


def main() -> None:
    """Run the command and write the notes; exits as the command does."""
    at: dict[str, float] = {"imported": time.monotonic()}
    notes, run = Path(sys.argv[1]), Loop.run

    def noted(loop: Loop) -> str:
        at["loop"] = time.monotonic()
        why = run(loop)
        notes.write_text(json.dumps(at | {"looped": time.monotonic(), "iterations": loop.iteration}))
        return why

    sys.argv[1:] = sys.argv[2:]
    with patch.object(Loop, "run", noted):
        runpy.run_module(__package__.partition(".")[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
