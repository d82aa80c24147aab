"""A command from the start of its process to its end, and where its kernels are kept."""

import os
import sys
from pathlib import Path

import pytest
from helpers import photos_of
from helpers.bench_records import benchmark, timing

from mitsvbrdf.bench import start
from mitsvbrdf.bench.commands import commands
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.start import StartJob
from mitsvbrdf.bench.suite_tables import start_table
from mitsvbrdf.capture import write_capture
from mitsvbrdf.errors import BackendError
from mitsvbrdf.material.made import make_material

STANDS_IN = """
import json, os, sys, time
from pathlib import Path
cache = Path(os.environ["DRJIT_CACHE_DIR"])
full = cache.is_dir()
cache.mkdir(exist_ok=True)
now = time.monotonic()
Path(sys.argv[1]).write_text(json.dumps({"imported": now, "loop": now + 1, "looped": now + 3, "iterations": 7 if full else 5}))
"""


def test_each_second_process_finds_the_kernels_of_the_first(monkeypatch):
    monkeypatch.setattr(start, "CHILD", (sys.executable, "-c", STANDS_IN))
    job, shares = StartJob("/somewhere/cards", "hybrid", 16, 2.0, repeats=2), []
    rows = job.run(shares.append)["rows"]
    assert shares == [0.25, 0.5, 0.75, 1.0]
    assert [(row["cache"], row["iterations"]["median"]) for row in rows] == [("empty", 5), ("full", 7)]
    for row in rows:
        assert row["preparation"]["median"] == pytest.approx(1) and row["loop"]["median"] == pytest.approx(2)
        parts = sum(row[part]["median"] for part in ("imports", "preparation", "loop", "writing"))
        assert row["wall"]["median"] == pytest.approx(parts, abs=0.05)  # medians of two do not add up exactly
    check_benchmark(benchmark([job.key | {"config": job.settings} | {"rows": rows}]), "here")


def test_a_command_that_fails_says_why(monkeypatch):
    monkeypatch.setattr(start, "CHILD", (sys.executable, "-c", "import sys; sys.exit('no such photos')"))
    with pytest.raises(BackendError, match="no such photos"):
        StartJob("/somewhere/cards", "hybrid", 16, 2.0, repeats=1).run()


def test_the_table_and_the_command_of_starts():
    parts = dict.fromkeys(("wall", "imports", "preparation", "loop", "writing", "iterations"))
    rows = [{"cache": cache} | {name: timing(seconds) for name in parts}
            for cache, seconds in (("empty", 20.0), ("full", 10.0))]
    job = StartJob("/somewhere/cards", "hybrid", 16, 2.0, repeats=3)
    record = benchmark([job.key | {"config": job.settings, "rows": rows}])
    shown = [row[:2] for row in start_table(record).rows]
    assert shown == [["`hybrid`, cache empty", "20 s"], ["`hybrid`, cache full", "10 s"]]
    (line,) = commands(record)
    assert "--suite start --materials none --captures cards --methods hybrid --budgets 2 --repeats 3 --resolution 16" in line


@pytest.mark.slow
def test_a_command_in_a_process_of_its_own(tmp_path):
    write_capture(photos_of(make_material("inlay", 16)), tmp_path / "shots")
    usual = Path.home() / ".drjit"
    before = sorted(os.listdir(usual)) if usual.is_dir() else None
    job = StartJob(str(tmp_path / "shots"), "direct", 16, 0.5, repeats=1)
    empty, full = job.run()["rows"]
    assert 0 < full["preparation"]["median"] < full["wall"]["median"] and full["iterations"]["median"] > 0
    assert empty["iterations"]["median"] < full["iterations"]["median"]  # kernels are compiled inside the loop
    assert before is None or set(before) <= set(os.listdir(usual))
