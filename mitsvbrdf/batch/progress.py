"""How a batch stands: in words, on a terminal by a bar, on a pipe by one line a capture."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import rich.progress
from rich.console import Console


@dataclass(frozen=True)
class Progress:
    """How a batch stands.

    Args:
        ended: how many captures ended in this run.
        left: how many have not.
        running: how many run now.
        failed: how many failed in this run.
        seconds: since the run began.
    """

    ended: int
    left: int
    running: int
    failed: int
    seconds: float

    @property
    def words(self) -> str:
        """A line."""
        parts = [f"{self.ended:,} of {self.ended + self.left:,} ended",
                 *(f"{n:,} {what}" for n, what in ((self.running, "running"), (self.failed, "failed")) if n)]
        if self.ended >= max(1, self.running) and self.left:  # earlier ends say too little
            hourly = 3600 * self.ended / self.seconds
            parts += [rate(hourly), f"about {duration(3600 * self.left / hourly)} left"]
        return ", ".join(parts)


Tell = Callable[[Progress, str], None]


@contextlib.contextmanager
def telling(title: str) -> Iterator[Tell]:
    """What to tell how a batch stands, with a line about the capture that ended; it goes to what standard
    output is now.
    """
    out = sys.stdout

    def print_line(stands: Progress, line: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # nobody reads it any more
            if line:
                print(f"[{stands.ended}/{stands.ended + stands.left}] {line}", file=out, flush=True)

    if out is None or not out.isatty():
        yield print_line
        return
    columns = (rich.progress.TextColumn("{task.description}", markup=False), rich.progress.BarColumn(),
               rich.progress.TextColumn("{task.fields[words]}", markup=False))
    with rich.progress.Progress(*columns, console=Console(file=out), transient=True,
                                redirect_stdout=False) as bar:
        task = bar.add_task(title, total=None, words="")

        def tell(stands: Progress, line: str) -> None:
            if line:
                bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
            bar.update(task, total=stands.ended + stands.left, completed=stands.ended, words=stands.words)

        yield tell


def duration(seconds: float) -> str:
    """A length of time in at most two units: 0.8 s, 40 s, 12 min, 3 h 20 min, 2 days 5 h."""
    minutes, hours = math.floor(seconds / 60 + 0.5), math.floor(seconds / 3600 + 0.5)
    if seconds < 89.5:
        return f"{seconds:.1f} s" if seconds < 9.95 else f"{math.floor(seconds + 0.5)} s"
    if minutes < 90:
        return f"{minutes} min"
    if minutes < 48 * 60:
        return f"{minutes // 60} h" + f" {minutes % 60} min" * bool(minutes % 60)
    return f"{hours // 24} days" + f" {hours % 24} h" * bool(hours % 24)


def rate(hourly: float) -> str:
    """How many in an hour; fewer than one is told by the time that it takes."""
    if hourly < 1:
        return f"one in {duration(3600 / hourly)}"
    return f"{hourly:.1f} an hour" if hourly < 9.95 else f"{hourly:,.0f} an hour"
