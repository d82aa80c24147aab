"""What the pool tells when workers and gateways come and go."""

from __future__ import annotations

import importlib.util
import os
import sys
import time
from pathlib import Path

import pytest

from mitsvbrdf.batch.workers import pool as pool_module
from mitsvbrdf.batch.workers.pool import RayPool
from mitsvbrdf.errors import BackendError

FAKE = (sys.executable, "-P", str(Path(__file__).with_name("fake_gateway.py")))
HANG = 60.0  # seconds after which a test gives up


@pytest.fixture
def make_pool(tmp_path, monkeypatch):
    """A pool before a fake gateway whose starts go as planned; pauses between starts are short, and Ray need
    not be there.
    """
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *more: True)
    monkeypatch.setattr(pool_module, "LONGEST_PAUSE", 0.05)
    made = []

    def make(*ways):
        plan = tmp_path / "plan"
        plan.write_text("\n".join(ways or ["up"]))
        made.append(RayPool("library", gateway=(*FAKE, str(plan)), log=tmp_path / "log"))
        return made[-1]

    yield make
    for pool in made:
        pool.close()


def collect(pool, count):
    """The next so many events, as (what, worker, attempt)."""
    found, deadline = [], time.monotonic() + HANG
    while len(found) < count:
        assert time.monotonic() < deadline, f"only {found} came"
        found += [(event["is"], event["worker"], event.get("attempt")) for event in pool.events(0.2)]
    return found


def task(attempt, capture):
    return {"attempt": attempt, "capture": capture}


def test_tasks_go_out_and_outcomes_come_back(make_pool):
    pool = make_pool()
    assert collect(pool, 2) == [("worker", "w1", None), ("worker", "w2", None)]
    pool.run("w1", task("a1", "done"))
    assert collect(pool, 1) == [("done", "w1", "a1")]
    assert pool.events(0.0) == []


def test_a_lost_worker_has_its_attempt_and_another_comes(make_pool):
    pool = make_pool()
    collect(pool, 2)
    pool.run("w2", task("a1", "lose"))
    assert collect(pool, 2) == [("lost", "w2", "a1"), ("worker", "w3", None)]


@pytest.mark.parametrize("death", ["die", "half"])
def test_when_the_gateway_dies_all_workers_are_lost_and_new_ones_come(make_pool, death):
    pool = make_pool()
    collect(pool, 2)
    pool.run("w1", task("a1", "never"))
    pool.run("w2", task("a2", death))
    assert collect(pool, 4) == [("lost", "w1", "a1"), ("lost", "w2", "a2"), ("worker", "w3", None),
                                ("worker", "w4", None)]


def test_a_task_for_a_worker_that_is_gone_comes_back_as_lost(make_pool):
    pool = make_pool()
    collect(pool, 2)
    pool.run("w1", task("a1", "die"))
    collect(pool, 2)
    pool.run("w2", task("a2", "done"))
    assert collect(pool, 1) == [("lost", "w2", "a2")]


def test_a_gateway_that_cannot_start_says_why(make_pool):
    pool = make_pool("failed")
    with pytest.raises(BackendError, match="no luck; try again"):
        collect(pool, 1)


def test_one_that_once_worked_is_tried_again(make_pool):
    pool = make_pool("up", "failed", "die", "up")
    collect(pool, 2)
    pool.run("w1", task("a1", "die"))
    assert collect(pool, 4)[2:] == [("worker", "w3", None), ("worker", "w4", None)]


def test_deaths_in_a_row_end_it_but_a_task_done_forgives_them(make_pool):
    pool, deaths = make_pool(), pool_module.DEATHS
    workers = [event[1] for event in collect(pool, 2)]
    for capture in ["die"] * (deaths - 1) + ["done"] + ["die"] * (deaths - 1):
        pool.run(workers[0], task("a", capture))
        if capture == "die":
            workers = [event[1] for event in collect(pool, 4)[2:]]
        else:
            collect(pool, 1)
    pool.run(workers[0], task("a", "die"))
    with pytest.raises(BackendError, match=f"{deaths} ends in a row"):
        collect(pool, 1)


@pytest.mark.parametrize("ways", [["failed"], ["die"], ["up", "die"]])
def test_the_last_words_of_the_log_are_told(make_pool, tmp_path, ways):
    pool = make_pool(*ways)
    (tmp_path / "log").write_text("much\nlibray.so: wrong ELF class\n\n")
    if ways[0] == "up":
        collect(pool, 2)
        pool.run("w1", task("a", "die"))
    with pytest.raises(BackendError, match="its log.* ends: libray.so: wrong ELF class") as told:
        collect(pool, 9)
    assert (str(tmp_path / "log") in str(told.value)) == (ways[0] == "up")  # else it goes with a new library


@pytest.mark.parametrize("way", ["up", "stuck", "die"])
def test_closing_leaves_no_process_and_no_open_file(make_pool, monkeypatch, way):
    monkeypatch.setattr(pool_module, "STOP_SECONDS", 0.2)
    files = len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").exists() else None
    pool = make_pool(way)
    if way != "die":
        collect(pool, 2)
    pool.close()
    pool.close()
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)
    assert files is None or len(os.listdir("/proc/self/fd")) == files


def test_without_ray_it_says_what_to_install(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *more: None if name == "ray" else find(name,
                                                                                                         *more))
    with pytest.raises(BackendError, match=r"no module ray; pip install 'mitsvbrdf\[batch\]'"):
        RayPool("library")
