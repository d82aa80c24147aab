"""A benchmark on many workers: the same jobs in every process, each record kept once, whatever becomes of the
workers.
"""

from __future__ import annotations

import json
import os
import signal
from dataclasses import asdict

import pytest
from helpers.bench_records import SETTINGS

from mitsvbrdf.batch.schedule import REFUSED
from mitsvbrdf.batch.settings import BatchSettings
from mitsvbrdf.bench import child, parallel
from mitsvbrdf.bench.jobs import key_of
from mitsvbrdf.bench.methods import method_table
from mitsvbrdf.bench.page import made_on
from mitsvbrdf.bench.plan import QUICK, WHOLE, Plan
from mitsvbrdf.bench.store import Store, read_benchmark
from mitsvbrdf.errors import ConfigError, MitsvbrdfError

FIGURES = {"seconds": 0.1, "wall": 0.2, "iterations": 3, "stopped": "budget", "why": None,
           "errors": {"mean": 0.1}}


def make_plan(tmp_path, suites=("methods",), methods="hybrid,gan", **chosen):
    tiny = WHOLE | QUICK | {"resolution": 16, "budgets": "0.1,0.2", "seeds": "0,1", "schedule": (16, 8, 5),
                            "folder": str(tmp_path)}
    return Plan(suites, tiny | chosen, methods, None, None, "analytic", "llvm_ad_rgb", True)


def test_the_jobs_are_every_method_on_every_material_with_every_budget_and_seed(tmp_path):
    jobs, settings, _ = make_plan(tmp_path).jobs()
    expected = [(method, budget, seed) for seed in (0, 1) for budget in (0.1, 0.2) for method in ("hybrid",
                                                                                                  "gan")]
    assert [(job.method, job.budget, job.seed) for job in jobs] == expected
    assert {(job.suite, job.task.name, job.task.photos.resolution) for job in jobs} == {("methods", "inlay",
                                                                                         16)}
    assert settings == {"resolution": 16, "views": "builtin:grid", "renderer": "analytic",
                        "variant": "llvm_ad_rgb",
                        "quick": True}
    # two know no seed
    assert len(make_plan(tmp_path, methods=None).jobs()[0]) == 4 * len(method_table()) - 2 * 2


@pytest.mark.parametrize("suites, methods", [(("methods",), None), (("ablation",), None), (("gan",), None),
                                             (("capture", "steps"), None), (("schedule",), "gan"),
                                             (("sheets",), None), (("renderers",), None)])
def test_another_process_makes_the_same_jobs_of_a_plan(tmp_path, suites, methods):
    plan = make_plan(tmp_path, suites, methods)
    told = Plan(**json.loads(json.dumps(asdict(plan))))
    keys, again = ([key_of(job) for job in each.jobs()[0]] for each in (plan, told))
    assert keys and again == keys and len(set(keys)) == len(keys)


def test_making_jobs_leaves_the_plan_as_it_is(tmp_path):
    plan = make_plan(tmp_path)
    before = json.dumps(asdict(plan))
    plan.jobs()
    assert json.dumps(asdict(plan)) == before


@pytest.mark.parametrize("wrong", [{"budgets": "0"}, {"seeds": "-1"}, {"resolution": 4}, {"repeats": 0},
                                   {"left-out": "x"}, {"materials": "nowhere"}])
def test_a_plan_out_of_range_is_refused(tmp_path, wrong):
    with pytest.raises(ConfigError):
        make_plan(tmp_path, **wrong).jobs()


class FakePool:
    """One worker a name; ``deeds`` says by a job's method and attempt how it ends."""

    NAMES = "w1", "w2"

    def __init__(self, deeds, meanwhile=lambda: None):
        self.deeds, self.meanwhile, self.tasks, self.closed = deeds, meanwhile, [], False
        self._events = [{"is": "worker", "worker": name, "host": "here"} for name in self.NAMES]
        self._named = 2

    def run(self, worker, task):
        task = json.loads(json.dumps(task))
        tries = sum(each["key"] == task["key"] for each in self.tasks)
        self.tasks.append(task)
        deeds = self.deeds.get(json.loads(task["key"])[0]["method"], ["done"])
        deed = deeds[min(tries, len(deeds) - 1)]
        if deed == "lost":
            self._named += 1
            self._events += [{"is": "lost", "worker": worker, "attempt": task["attempt"],
                              "reason": "the node died"},
                             {"is": "worker", "worker": f"w{self._named}", "host": "here"}]
            return
        self._events.append({"is": "done", "worker": worker, "attempt": task["attempt"], "outcome": {
            "state": deed, "reason": "" if deed == "done" else f"it {deed}", "row": FIGURES if deed == "done"
            else None}})

    def events(self, seconds):
        self.meanwhile()
        found, self._events = self._events, []
        return found

    def close(self):
        self.closed = True


def measured(tmp_path, monkeypatch, deeds, meanwhile=lambda: None, **settings):
    """What could not be measured, the pool and the store after a benchmark of 4 + 4 jobs."""
    plan, pool = make_plan(tmp_path), FakePool(deeds, meanwhile)
    started = []
    monkeypatch.setattr(parallel, "RayPool", lambda library, **words: started.append((library, words))
                        or pool)
    store, shares = Store(tmp_path / "b.json", SETTINGS), []
    try:
        failed = parallel.run_parallel(plan, plan.jobs()[0], store, BatchSettings(workers=2, memory=1.0,
                                                                                  **settings),
                                       lambda text, share: shares.append(share))
    finally:
        assert pool.closed
        assert [(library, words["child"], words["workers"]) for library, words in started] == [
            (parallel.EVERYWHERE, parallel.CHILD, 2)]
    assert shares == sorted(shares) and shares[-1] == 1.0
    return failed, pool, Store(tmp_path / "b.json", SETTINGS)


def test_every_job_has_its_record_and_a_second_time_nothing_is_left(tmp_path, monkeypatch):
    failed, pool, store = measured(tmp_path, monkeypatch, {})
    assert failed == {} and len(pool.tasks) == 8 == len(store.records)
    assert store.pending(make_plan(tmp_path).jobs()[0]) == []
    assert all(record["errors"] == FIGURES["errors"] and record["workers"] == 2 for record in store.records)
    assert "8 of 8 records were made 2 at a time (`--workers`)" in made_on(read_benchmark(store.path))
    # in their own order
    assert [task["key"] for task in pool.tasks] == list(map(key_of, make_plan(tmp_path).jobs()[0]))


def test_a_worker_that_is_alone_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(FakePool, "NAMES", ("w1",))
    _, _, store = measured(tmp_path, monkeypatch, {})
    assert len(store.records) == 8 and not any("workers" in record for record in store.records)
    assert "at a time" not in made_on(read_benchmark(store.path))


def test_crashes_are_tried_again_losses_cost_nothing_and_what_fails_is_named(tmp_path, monkeypatch):
    failed, pool, store = measured(tmp_path, monkeypatch, {"hybrid": ["lost", "crashed", "done"]}, retries=1)
    assert failed == {} and len(store.records) == 8 and len(pool.tasks) == 4 + 3 * 4
    (tmp_path / "b.json").unlink()
    failed, pool, store = measured(tmp_path, monkeypatch, {"hybrid": [REFUSED], "gan": ["crashed", "done"]})
    assert len(failed) == 4 == len(store.records) and set(failed.values()) == {"it failed"}
    assert all(title.startswith("hybrid, inlay") for title in failed)


def test_ctrl_c_keeps_what_is_done(tmp_path, monkeypatch):
    looks = iter(range(100))
    with pytest.raises(KeyboardInterrupt):
        measured(tmp_path, monkeypatch, {}, lambda: next(looks) == 2 and os.kill(os.getpid(), signal.SIGINT))
    assert 0 < len(Store(tmp_path / "b.json", SETTINGS).records) < 8


def test_ctrl_c_while_the_last_record_is_written(tmp_path, monkeypatch):
    add, count = Store.add, []

    def added(store, record):
        count.append(add(store, record))
        if len(count) == 8:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Store, "add", added)
    with pytest.raises(KeyboardInterrupt):
        measured(tmp_path, monkeypatch, {})
    assert len(Store(tmp_path / "b.json", SETTINGS).records) == 8


def test_a_child_makes_the_jobs_of_a_plan_once_and_warms_each_shape_up_once(tmp_path, monkeypatch):
    plan = json.loads(json.dumps(["Plan", asdict(make_plan(tmp_path))]))
    jobs = make_plan(tmp_path).jobs()[0]
    made, warmed = [], []
    real = Plan.jobs
    monkeypatch.setattr(Plan, "jobs", lambda self: made.append(1) or real(self))
    # no matter
    monkeypatch.setattr(type(jobs[0]), "warm_up", lambda self: warmed.append(self.method) or 1 / 0)
    monkeypatch.setattr(type(jobs[0]), "run", lambda self: {"ran": self.title})
    monkeypatch.setattr(child, "_made", [])
    monkeypatch.setattr(child, "_warm", set())
    monkeypatch.chdir(tmp_path)
    for job in jobs:
        assert child.measure({"folder": str(tmp_path), "plan": plan,
                              "key": key_of(job)}) == {"ran": job.title}
    assert made == [1] and warmed == ["hybrid", "gan"]
    with pytest.raises(MitsvbrdfError, match="same version and data on all nodes"):
        child.measure({"folder": str(tmp_path), "plan": plan, "key": "another"})
