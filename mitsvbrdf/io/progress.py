"""Progress of a running command: one live line on a terminal, plain lines elsewhere; and small tables."""

from __future__ import annotations

import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text


class _Console(Console):
    """A console that prints nothing more after its pipe was closed; rich would end the process."""

    def on_broken_pipe(self) -> None:
        self.quiet = True


console = _Console(stderr=False, highlight=False)


class Lines:
    """Plain lines: the first, one every ten seconds, and the last."""

    def __init__(self) -> None:
        self.last = -math.inf

    def show(self, text: str, share: float) -> None:
        """Print the share done (0 to 1) and a text, if a line is due."""
        now = time.perf_counter()
        if now - self.last > 10 or share >= 1:
            self.last = now
            say(f"{share:4.0%}  {text}")


@contextlib.contextmanager
def progress_bar(title: str, lasting: bool = False) -> Iterator[Callable[[str, float], None]]:
    """Show progress; yields a function to call with (text, share done).

    A terminal shows the text below the title; both stay at the end if ``lasting``. Elsewhere, also in a
    notebook, :class:`Lines` are printed.
    """
    if not on_terminal():
        say(title)
        yield Lines().show
    else:
        with Live(Text(title), console=console, refresh_per_second=4, transient=not lasting) as live:
            yield lambda text, share: live.update(Text(f"{title}\n{share:4.0%}  {text}"))


class Progress:
    """Error, losses, speed and time left of a fit: the ``report`` of :func:`mitsvbrdf.fit.fit_svbrdf`.

    As a context manager it shows one live line on a terminal. Otherwise it prints plain lines there, too.

    Args:
        title: printed above the progress.
    """

    def __init__(self, title: str = "fit") -> None:
        self.title, self._shown = title, contextlib.ExitStack()
        self._first: tuple[int, float] | None = None
        self._show: Callable[[str, float], None] = Lines().show

    def __enter__(self) -> Progress:
        self._show = self._shown.enter_context(progress_bar(self.title, lasting=True))
        return self

    def __exit__(self, *_: object) -> None:
        self._shown.close()

    def __call__(self, entry: dict, share: float) -> None:
        """Show an entry of a fit's trace and the share done."""
        now = time.perf_counter()
        first_iteration, first_time = self._first = self._first or (entry["iteration"], now)
        speed = (entry["iteration"] - first_iteration) / max(now - first_time, 1e-9)
        # seconds and share both include the work before a --resume, but not the set-up
        left = entry["seconds"] * (1 / share - 1) if share > 0 else 0.0
        losses = "".join(f"  {name} {value:.4f}" for name, value in entry.items()
                         if name not in ("seconds", "iteration", "rerender_rmse"))
        end = "  ended" if share >= 1 else f"  at most {left:.0f} s left" if share else ""
        self._show(f"{entry['seconds']:6.1f} s  iteration {entry['iteration']}  "
                   f"rmse {entry['rerender_rmse']:.4f}{losses}  {speed:.1f} it/s{end}", share)


def on_terminal() -> bool:
    """Whether standard output is a terminal; False if it was closed."""
    with contextlib.suppress(ValueError):
        return sys.stdout is not None and sys.stdout.isatty()
    return False


def say(text: str, out: TextIO | None = None) -> None:
    """Print a plain line to ``out``, by default standard output; a failure to print is ignored."""
    with contextlib.suppress(OSError, ValueError):
        print(text, file=out, flush=True)


def print_rich(*what: Any, **style: Any) -> None:
    """Print tables and other objects of rich, with long words folded; a failure to print is ignored."""
    for table in what:
        for column in table.columns if isinstance(table, Table) else ():
            if not column.no_wrap:
                column.overflow = "fold"
    with contextlib.suppress(OSError, ValueError):
        console.print(*what, **style)


def figures_table(title: str, headings: Sequence[str]) -> Table:
    """An empty table: its first column is for the names of rows, then one column of numbers per heading."""
    table = Table("", title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0),
                  pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def several(count: int, one: str) -> str:
    """A number and what it counts, ``1 fit`` or ``2 fits``."""
    return f"{count:,} {one}{'' if count == 1 else 's'}"


def say_written(*paths: Path | None) -> None:
    """Print one line with the names of the written files; None is skipped."""
    if names := [str(path) for path in paths if path]:
        say(f"wrote {', '.join(names)}")


def print_numbers(title: str, numbers: dict[str, float]) -> None:
    """Print a small table of named numbers; its title may be wider than the table."""
    table = Table(show_header=False)
    for name, value in numbers.items():
        table.add_row(name, f"{value:.4f}")
    print_rich(title, style="italic", markup=False, soft_wrap=True)
    print_rich(table, markup=False)
