"""What a user sees in a terminal or a notebook: one live line while a fit runs, small tables, plain notes."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import rich.progress
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text


class _Console(Console):
    """A console that lets the work go on when nobody reads any more; rich would end the process."""

    def on_broken_pipe(self) -> None:
        """Nothing more is printed."""
        self.quiet = True


console = _Console(stderr=False, highlight=False)


class Cell:
    """Text below a notebook cell that is replaced in place, at most four times a second; what it said last is
    kept.

    It is plain text, which Jupyter, VS Code, Colab and pages made of saved notebooks all show; rich's live
    displays would need ipywidgets, and a saved notebook would not show them.

    Args:
        title: stands before the bar.
    """

    WIDTH, SECONDS = 32, 0.25

    def __init__(self, title: str) -> None:
        from IPython.display import DisplayHandle
        self.title, self.handle, self.due = title, DisplayHandle(), 0.0
        self.shown = self.latest = ""

    def show(self, share: float, line: str) -> None:
        """Title, a bar of the share done (0 to 1) and a line of text; shown at once where it is the last, at
        share 1.
        """
        done = round(self.WIDTH * min(max(share, 0.0), 1.0))
        self.latest = f"{self.title}  {'━' * done}{'─' * (self.WIDTH - done)}\n{line}"
        if share >= 1 or time.perf_counter() >= self.due:
            self.close()

    def close(self) -> None:
        """Show what came last."""
        if self.latest != self.shown:
            (self.handle.update if self.shown else self.handle.display)({"text/plain": self.latest}, raw=True)
            self.shown, self.due = self.latest, time.perf_counter() + self.SECONDS


class Progress:
    """A live line with error, losses, speed and time left; without a terminal, a plain line every ten
    seconds.

    In a notebook it stands below a bar, and stays with the saved notebook. Called with (trace entry, share
    done), as the ``report`` of :func:`mitsvbrdf.fit.fit_svbrdf`. Best used as a context manager: without, a
    terminal shows plain lines too, and where a fit is interrupted what a notebook shows may be a quarter of a
    second old.

    Args:
        title: what is going on.
    """

    def __init__(self, title: str = "fit") -> None:
        self.title, self.last = title, 0.0
        self.first: tuple[int, float] | None = None
        self.live: Live | None = None
        self.cell = Cell(title) if console.is_jupyter else None

    def __enter__(self) -> Progress:
        if self.cell:
            self.cell.show(0.0, "")
        elif on_terminal():
            self.live = Live(Text(self.title), console=console, refresh_per_second=4, transient=False)
            self.live.start()
        else:
            say(self.title)
        return self

    def __exit__(self, *_: object) -> None:
        if self.cell:
            self.cell.close()
        if self.live:
            self.live.stop()

    def __call__(self, entry: dict, share: float) -> None:
        """Show a line of a fit's log and the share done."""
        now = time.perf_counter()
        first_iteration, first_time = self.first = self.first or (entry["iteration"], now)
        speed = (entry["iteration"] - first_iteration) / max(now - first_time, 1e-9)
        # both count what was before a --resume, and no set-up
        left = entry["seconds"] * (1 / share - 1) if share > 0 else 0.0
        losses = "  ".join(f"{k} {v:.4f}" for k, v in entry.items() if k not in ("seconds", "iteration",
                                                                                 "rerender_rmse"))
        line = (f"{share:4.0%}  {entry['seconds']:6.1f} s  iteration {entry['iteration']}  rmse "
                f"{entry['rerender_rmse']:.4f}  "
                f"{losses}  {speed:.1f} it/s" + ("  ended" if share >= 1 else f"  at most {left:.0f} s left"
                                                 if share else ""))
        if self.cell:
            self.cell.show(share, line)
        elif self.live:
            self.live.update(Text(f"{self.title}\n{line}"))
        elif now - self.last > 10 or share >= 1:
            self.last = now
            say(line)


@contextlib.contextmanager
def progress_bar(title: str) -> Iterator[Callable[[str, float], None]]:
    """What to tell (text, share done): a bar on a terminal or in a notebook, else a line every ten
    seconds.
    """
    if console.is_jupyter:
        cell = Cell(title)
        try:
            yield lambda text, share: cell.show(share, f"{share:4.0%}  {text}")
        finally:
            cell.close()
        return
    if on_terminal():
        columns = (rich.progress.TextColumn("{task.description}", markup=False), rich.progress.BarColumn(),
                   rich.progress.TaskProgressColumn())
        with rich.progress.Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task(title, total=1.0)
            yield lambda text, share: bar.update(task, description=f"{title}: {text}", completed=share)
        return
    last = time.perf_counter()

    def line(text: str, share: float) -> None:
        nonlocal last
        if time.perf_counter() - last > 10:
            last = time.perf_counter()
            say(f"{share:4.0%}  {text}")

    say(title)
    yield line


def on_terminal() -> bool:
    """Whether a terminal shows what is printed; none does where standard output was closed."""
    with contextlib.suppress(ValueError):
        return sys.stdout is not None and sys.stdout.isatty()
    return False


def say(text: str) -> None:
    """A plain line; where nobody reads it, or there is no room for it, the work goes on without."""
    with contextlib.suppress(OSError, ValueError):
        print(text, flush=True)


def print_rich(*what: Any, **style: Any) -> None:
    """Tables and what else rich can print; where that cannot be done the work goes on without.

    In a table a word longer than its column goes on below; rich would cut it.
    """
    for table in what:
        for column in table.columns if isinstance(table, Table) else ():
            if not column.no_wrap:
                column.overflow = "fold"
    with contextlib.suppress(OSError, ValueError):
        console.print(*what, **style)


def several(count: int, one: str) -> str:
    """A number and what it counts, ``1 fit`` or ``2 fits``."""
    return f"{count:,} {one}{'' if count == 1 else 's'}"


def say_written(*paths: Path | None) -> None:
    """One line that names the files that were asked for; nothing where none was."""
    if names := [str(path) for path in paths if path]:
        say(f"wrote {', '.join(names)}")


def print_profile(profile: dict) -> None:
    """Where the time of a fit's steps went, as :meth:`mitsvbrdf.io.profile.Profile.summary` counts it."""
    table = Table(title=f"Seconds a step, {profile['steps']} steps", title_justify="left")
    for name in ("part", "median", "quartiles", "share", "steps"):
        table.add_column(name, justify="left" if name == "part" else "right")
    whole = {"step": profile["step"] | {"share": 1.0}} if profile["steps"] else {}
    for name, part in (profile["parts"] | whole).items():
        table.add_row(name, f"{part['median']:.4f}", f"{part['low']:.4f} to {part['high']:.4f}",
                      f"{part['share']:.1%}", str(part["repeats"]))
    print_rich(table)
    beside = {"first steps": profile["warm_up"]} | profile["beside"]
    say("beside these: " + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in beside.items()))


def print_numbers(title: str, numbers: dict[str, float]) -> None:
    """A small table of named numbers, the names as they are, under a line that may be longer than it is
    wide.
    """
    table = Table(show_header=False)
    for name, value in numbers.items():
        table.add_row(name, f"{value:.4f}")
    print_rich(title, style="italic", markup=False, soft_wrap=True)
    print_rich(table, markup=False)
