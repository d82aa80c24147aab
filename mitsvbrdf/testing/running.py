"""The running test and the command line's options: set by the plugin, read by the assertions."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Run:
    """One run of a test suite.

    Args:
        update: whether new results become golden files.
        report: folder for the pages of failed comparisons.
        names: the test that used a golden file, by its path (in lower case: some file systems see no other).
        written: golden files made or replaced.
    """

    update: bool = False
    report: Path = Path(".mitsvbrdf-report")
    names: dict[str, str] = field(default_factory=dict)
    written: list[Path] = field(default_factory=list)


@dataclass(frozen=True)
class Caller:
    """A test that is running.

    Args:
        id: as pytest names it.
        file: the file it stands in; None outside pytest.
        run: the run it belongs to.
    """

    id: str
    file: Path | None
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
