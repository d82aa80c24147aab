"""The pytest plugin: two options, and the file of the running test for golden images.

pytest loads it in every project of an environment where this package is installed, so it imports nothing
heavy. The entry point has the module's name, so ``-p`` cannot load the plugin twice.
"""

from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from . import running

SUITE = pytest.StashKey[running.Running]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--mitsvbrdf-update`` and ``--mitsvbrdf-report DIR``."""
    group = parser.getgroup("mitsvbrdf", "golden images and pages of failed comparisons (mitsvbrdf)")
    group.addoption("--mitsvbrdf-update", action="store_true",
                    help="Write new results over golden files that are missing or no longer match.")
    group.addoption("--mitsvbrdf-report", metavar="DIR",
                    help="Folder for the pages of failed comparisons. Default: .mitsvbrdf-report in rootdir.")


def pytest_configure(config: pytest.Config) -> None:
    """Resolve the options."""
    report = config.getoption("mitsvbrdf_report")
    folder = (config.rootpath / ".mitsvbrdf-report" if report is None
              else config.invocation_params.dir / report)
    config.stash[SUITE] = running.Running(update=config.getoption("mitsvbrdf_update"), report=folder)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Record the running test for the assertions."""
    before, running.now = running.now, replace(item.config.stash[SUITE], test=item.nodeid, file=item.path)
    try:
        return (yield)
    finally:
        running.now = before


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Send the names of written golden files from a worker of pytest-xdist to the main process."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["mitsvbrdf"] = [str(path) for path in session.config.stash[SUITE].written]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take the names from a worker that ended; a worker that crashed has none."""
    node.config.stash[SUITE].written += map(Path, getattr(node, "workeroutput", {}).get("mitsvbrdf", ()))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Name the golden files that were written. Look at them before you commit them."""
    for path in config.stash[SUITE].written:
        terminalreporter.write_line(f"mitsvbrdf: wrote {path}")
