"""A batch against a loop of the shell: what is counted, and its page."""

import subprocess
import sys

import pytest

from mitsvbrdf.batch.planning import ways
from mitsvbrdf.errors import OutputError

ROWS = [{"way": way, "captures": 2, "seconds": seconds, "per_hour": 7200 / seconds, "peak_bytes": 1 << 30,
         "error": 0.01,
         "group": g}
        for g in (0, 1) for way, seconds in zip(ways.WAYS, (20.0, 25.0, 40.0 + 20 * g))]


def test_the_page_has_ratios_within_each_group():
    page = ways.page({"rows": ROWS, "resolution": 64, "machine": {"cores": 2}})
    assert "of 4 captures at 64 px" in page
    assert "| two workers, one thread each | 360 | 2.50 (2.00, 3.00) | 1.00 | 0.0100 |" in page
    assert "| a loop of the shell | 144 | 1.00 (1.00, 1.00) |" in page


def test_every_way_fits_every_capture_and_the_order_turns(monkeypatch):
    asked = []
    monkeypatch.setattr(ways, "run_in_a_way", lambda way, chosen, folder,
                        side: asked.append((way, tuple(chosen))) or {})
    assert [row["group"] for row in ways.measured(["a", "b", "c"], 2, 16)] == [0, 0, 0, 1, 1, 1]
    assert [way for way, _ in asked] == [*ways.WAYS, *list(ways.WAYS)[1:], list(ways.WAYS)[0]]
    assert {way: [each for w, chosen in asked if w == way for each in chosen]
            for way in ways.WAYS} == dict.fromkeys(
        ways.WAYS, ["a", "c", "b"])


def test_memory_is_that_of_a_process_and_all_below_it():
    eat = "import time; held = b'x' * (64 << 20); print(flush=True); time.sleep(60)"
    parent = ("import subprocess, sys\n"
              f"child = subprocess.Popen([sys.executable, '-c', {eat!r}], stdout=subprocess.PIPE)\n"
              "child.stdout.readline(); print(flush=True); child.wait()")
    process = subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE)
    try:
        process.stdout.readline()
        assert 64 << 20 < ways._held(process.pid) < 200 << 20
    finally:
        subprocess.run(["pkill", "-P", str(process.pid)], check=False)
        process.kill()
        process.wait()


def test_a_command_that_fails_is_an_error_with_what_it_said(monkeypatch, tmp_path):
    monkeypatch.setattr(ways, "OURS", (sys.executable, "-c", "raise SystemExit('no such thing')"))
    with pytest.raises(OutputError, match="exit code 1 of a loop of the shell; no such thing"):
        ways.run_in_a_way("a loop of the shell", ["x"], tmp_path, 16)
