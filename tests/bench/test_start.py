"""A command from the start of its process to its end, and where its kernels are kept."""

import json
import os
import sys
from pathlib import Path

import pytest
from helpers import photos_of
from helpers.bench_records import benchmark, timing

from mitsvbrdf.bench import jobs, start
from mitsvbrdf.bench.commands import commands
from mitsvbrdf.bench.plan import QUICK, WHOLE, Plan
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.start import StartJob
from mitsvbrdf.bench.store import Store
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
noted = {"argv": sys.argv[2:], **{name: os.environ.get(name) for name in ("OMP_WAIT_POLICY", "DRJIT_LIBLLVM_PATH")}}
Path(sys.argv[1]).with_name("noted.json").write_text(json.dumps(noted))
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


@pytest.mark.parametrize("stated", [None, "/the/users.so"])
def test_the_process_has_the_environment_and_the_renderer_that_a_user_has(stated, monkeypatch, tmp_path):
    monkeypatch.setattr(start, "CHILD", (sys.executable, "-c", STANDS_IN))
    monkeypatch.setattr(start, "STATED", stated)
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/found/here.so")  # as make_renderer leaves it
    for given, expected in ((None, "PASSIVE"), ("ACTIVE", "ACTIVE")):
        monkeypatch.delenv("OMP_WAIT_POLICY") if given is None else monkeypatch.setenv("OMP_WAIT_POLICY",
                                                                                       given)
        job = StartJob("/somewhere/cards", "hybrid", 16, 2.0, 1, "analytic", "scalar_rgb")
        job._process(tmp_path, "out")
        noted = json.loads((tmp_path / "noted.json").read_text())
        assert (noted["OMP_WAIT_POLICY"], noted["DRJIT_LIBLLVM_PATH"]) == (expected, stated)
        options = dict(zip(noted["argv"][4::2], noted["argv"][5::2]))
        assert (options["--renderer"], options["--variant"]) == ("analytic", "scalar_rgb")
    assert (job.settings["renderer"], job.settings["variant"]) == ("analytic", "scalar_rgb")


def test_a_plan_tells_its_renderer_and_a_method_that_fails_ends_no_other(monkeypatch, tmp_path):
    bad = STANDS_IN + 'if "direct" in sys.argv: sys.exit("no such photos")\n'
    monkeypatch.setattr(start, "CHILD", (sys.executable, "-c", bad))
    (tmp_path / "cards").mkdir()
    chosen = WHOLE | QUICK | {"captures": str(tmp_path / "cards"), "repeats": 1, "folder": "",
                              "schedule": (16, 8, 5)}
    todo, settings, _ = Plan(("start",), chosen, "direct,hybrid", None, None, "analytic", "llvm_ad_rgb",
                             True).jobs()
    assert {job.renderer for job in todo} == {"analytic"}
    store = Store(tmp_path / "b.json", settings)
    failed = jobs.run(todo, store)
    assert [r["method"] for r in store.records] == ["hybrid"] and list(failed) == ["start, direct, cards"]
    assert "no such photos" in failed["start, direct, cards"]


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
    # kernels are compiled inside the loop
    assert empty["iterations"]["median"] < full["iterations"]["median"]
    assert before is None or set(before) <= set(os.listdir(usual))
