"""What is seen while something runs: on a terminal, and without one."""

import os
import pty
import subprocess
import sys

import pytest
from helpers import ROOT

from mitsvbrdf.io import progress
from mitsvbrdf.io.progress import Progress, print_numbers, progress_bar

ENTRY = {"seconds": 1.5, "iteration": 6, "cost": 2.0, "rerender_rmse": 0.125}


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still but for what is added to its one entry."""
    now = [1000.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    return now


def test_without_a_terminal_a_line_every_ten_seconds(capsys, clock):
    with Progress("a fit") as report:
        for second in range(26):
            report(ENTRY | {"iteration": second, "seconds": float(second)}, second / 100)
            clock[0] += 1
        report(ENTRY, 1.0)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "a fit" and len(lines) == 1 + 3 + 1  # at 0, 11 and 22 s, and the last
    assert [line.split()[0] for line in lines[1:]] == ["0%", "11%", "22%", "100%"]
    assert "iteration 11  rmse 0.1250  cost 2.0000  1.0 it/s  at most 89 s left" in lines[2]
    assert lines[-1].endswith("it/s  ended") and "left" not in lines[-1]


# set up for long; gone on from 60 s
@pytest.mark.parametrize("before, seconds, share", [(30, 2.0, 0.02), (0, 60.0, 0.6)])
def test_the_time_left_is_that_of_the_limit(before, seconds, share, capsys, clock):
    with Progress("a fit") as report:
        clock[0] += before
        report(ENTRY | {"seconds": seconds}, share)
    assert f"at most {100 - seconds:.0f} s left" in capsys.readouterr().out


def test_a_bar_without_a_terminal(capsys, clock):
    with progress_bar("a sweep") as report:
        for second in range(26):
            report(f"case {second}", second / 26)
            clock[0] += 1
    assert capsys.readouterr().out.splitlines() == ["a sweep", "  0%  case 0", " 42%  case 11",
                                                    " 85%  case 22"]


def first_column(text):
    """What stands in the first column of a table, put together again."""
    return "".join(line.split("│")[1].strip() for line in text.splitlines() if "│" in line)


def test_no_name_in_a_table_is_cut_or_read_as_markup(capsys):
    long = "IMG_" + "0123456789" * 50 + "[red].jpg"  # wider than any terminal
    print_numbers("title", {long: 0.125})
    said = capsys.readouterr().out
    assert first_column(said) == long and "0.1250" in said


def on_a_terminal(code):
    """What this Python code writes to a terminal."""
    ours, theirs = pty.openpty()
    subprocess.run([sys.executable, "-c", code], stdout=theirs, check=True, timeout=60,
                   env=os.environ | {"PYTHONPATH": str(ROOT), "TERM": "xterm-256color", "COLUMNS": "200"})
    os.close(theirs)
    return os.read(ours, 100_000).decode()


def test_a_bar_on_a_terminal_shows_names_as_they_are():
    said = on_a_terminal("from mitsvbrdf.io.progress import progress_bar\n"
                         "with progress_bar('relight wall[red]') as report:\n    report('one', 0.5)\n")
    assert "relight wall[red]" in said and " 50%  one" in said


def test_on_a_terminal_one_live_line():
    said = on_a_terminal("from mitsvbrdf.io.progress import Progress\nwith Progress('a fit') as report:\n"
                         f"    report({ENTRY}, 0.25)\n    report({ENTRY}, 1.0)\n")
    assert "a fit" in said and "100%" in said and "rmse 0.1250" in said
    # the cursor is hidden, and shown again
    assert "\x1b[?25l" in said and said.rindex("\x1b[?25h") > said.rindex("100%")
