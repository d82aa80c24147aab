"""How a batch goes, on the terminal: a bar and counts; on a pipe one line a capture. Both count what this run
has to do.
"""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator

import rich.progress

from ..io.progress import console, say
from .run import Progress, Tell


@contextlib.contextmanager
def telling(title: str) -> Iterator[Tell]:
    """What to tell how a batch stands."""
    if not sys.stdout.isatty():
        yield _line
        return
    columns = (rich.progress.TextColumn("{task.description}", markup=False), rich.progress.BarColumn(),
               rich.progress.TextColumn("{task.fields[words]}", markup=False))
    with rich.progress.Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(title, total=None, words="")

        def tell(stands: Progress, line: str) -> None:
            if line:
                bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
            bar.update(task, total=stands.ended + stands.left, completed=stands.ended, words=words(stands))

        yield tell


def words(stands: Progress) -> str:
    """How a batch stands, in a line."""
    now = {name: stands.counts[name] - stands.before.get(name, 0) for name in ("running", "failed")}
    parts = [f"{stands.ended} of {stands.ended + stands.left} ended",
             *(f"{n} {name}" for name, n in now.items() if n)]
    if stands.left_seconds is not None:
        parts += [rate(stands.per_hour), f"about {duration(stands.left_seconds)} left"]
    before = [f"{n} {name}" for name in ("done", "failed") if (n := stands.before.get(name))]
    return ", ".join(parts) + (f" ({' and '.join(before)} before)" if before else "")


def duration(seconds: float) -> str:
    """A length of time in at most two units: 0.8 s, 40 s, 12 min, 3 h 20 min, 2 days 5 h; the page says the
    same.
    """
    minutes, hours = math.floor(seconds / 60 + 0.5), math.floor(seconds / 3600 + 0.5)
    if seconds < 89.5:
        return f"{seconds:.1f} s" if seconds < 9.95 else f"{math.floor(seconds + 0.5)} s"
    if minutes < 90:
        return f"{minutes} min"
    if minutes < 48 * 60:
        return f"{minutes // 60} h" + f" {minutes % 60} min" * bool(minutes % 60)
    return f"{hours // 24} days" + f" {hours % 24} h" * bool(hours % 24)


def rate(per_hour: float) -> str:
    """How many in an hour; fewer than one is told by the time that it takes."""
    if per_hour < 1:
        return f"one in {duration(3600 / per_hour)}"
    return f"{per_hour:.1f} an hour" if per_hour < 9.95 else f"{per_hour:,.0f} an hour"


def _line(stands: Progress, line: str) -> None:
    if line:
        say(f"[{stands.ended}/{stands.ended + stands.left}] {line}")
