"""The running test and the command line's options: set by the plugin, read by the assertions."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Run:
    """One run of a test suite."""

    update: bool = False  # new results become golden files
    report: Path = Path(".mitsvbrdf-report")  # folder for the pages of failed comparisons
    names: dict[str, str] = field(default_factory=dict)  # test by golden file, lower case as some systems do
    written: list[Path] = field(default_factory=list)  # golden files made or replaced


@dataclass(frozen=True)
class Caller:
    """A test that is running."""

    id: str  # as pytest names it
    file: Path | None  # that it stands in; None outside pytest
    run: Run


_current = Caller("comparison", None, Run())


def current() -> Caller:
    """The test that is running; a stand-in without a file where the plugin is not at work."""
    return _current


@contextlib.contextmanager
def running(test: Caller) -> Iterator[None]:
    """Inside the block, ``test`` is the one that is running."""
    global _current
    before, _current = _current, test
    try:
        yield
    finally:
        _current = before
