"""Commands that break the rules, each in its way: what :mod:`fuzz.case` must notice."""

import json
import os
import signal
import sys
import time
from pathlib import Path


def warm() -> None:
    """Nothing to import."""


def main() -> int:
    deeds = {
        "nothing": lambda: 0, "refuse": lambda: print("error: no") or 2, "interrupted": lambda: 130,
        "one": lambda: 1,
        "silent": lambda: 2, "die": os.abort, "hang": lambda: time.sleep(60), "deaf": _deaf, "fill": _fill,
        "raise": _raise, "write": lambda: Path("out").write_text("x") and 0,
        "touch": lambda: os.utime("../outside/secret.txt") or 0,
        "replace": lambda: _replace(Path("../outside/secret.txt")),
        "make": lambda: Path("beside").write_text("x") and 0,
        "remove": lambda: Path("../outside/folder/keep.txt").unlink() or 0,
        "follow": lambda: Path("../in/part/link").write_text("x") and 0,
        "relink": lambda: _replace(Path("../in/part/link")),
        "leave": lambda: Path(os.environ["TMPDIR"], "left").write_text("x") and 0, "if NaN": lambda: _raise()
        if "NaN" in json.dumps(json.loads(Path("../in/part/file.json").read_text())) else 0}
    try:
        return deeds[sys.argv[1]]() or 0  # type: ignore[no-untyped-call]
    except KeyboardInterrupt:
        return 130


def _raise() -> int:
    raise ValueError("a fault")


def _deaf() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    time.sleep(60)
    return 0


def _fill() -> int:
    held = b"x" * 300_000_000
    return len(held) and 0


def _replace(path: Path) -> int:
    content = path.read_text()
    path.unlink()
    path.write_text(content)
    return 0
