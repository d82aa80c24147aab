"""How a batch goes, on the terminal: a bar and what runs; on a pipe one line a capture."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

import rich.progress

from ..system.progress import console, say
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
            total = sum(stands.counts.values())
            bar.update(task, total=total, completed=stands.counts["done"] + stands.counts["failed"], words=words(stands))

        yield tell


def words(stands: Progress) -> str:
    """How a batch stands, in a line."""
    counts = stands.counts
    parts = [f"{counts['done']} done"] + [f"{counts[name]} {name}" for name in ("failed", "running", "pending") if counts[name]]
    if stands.left_seconds is not None:
        parts += [f"{stands.per_hour:,.0f} an hour", f"{duration(stands.left_seconds)} left"]
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """A rough time as people say it: 40 s, 12 min, 3 h 20 min."""
    minutes = round(seconds / 60)
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def _line(stands: Progress, line: str) -> None:
    if line:
        counts = stands.counts
        say(f"[{counts['done'] + counts['failed']}/{sum(counts.values())}] {line}")
