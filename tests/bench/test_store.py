"""Several runs add to one file of records: none is lost, none is mixed with another, and Ctrl-C is heard."""

import json
import multiprocessing
import os
import signal
import time

import pytest
from helpers.bench_records import SETTINGS, record

from mitsvbrdf.bench import jobs
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.store import Store, read_benchmark
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.io import files
from mitsvbrdf.io.shared_file import held

EACH = 75


def add_many(path, method):
    store = Store(path, SETTINGS)
    for seed in range(EACH):
        store.add(record(method, 1.0, seed, mean=0.1))


def in_processes(function, *of_each):
    """Run it at the same time in a process for each; their exit codes."""
    pytest.importorskip("fcntl")
    several = [multiprocessing.get_context("fork").Process(target=function, args=one) for one in of_each]
    for each in several:
        each.start()
    for each in several:
        each.join()
    return [each.exitcode for each in several]


def test_two_runs_lose_nothing(tmp_path):
    path = tmp_path / "b.json"
    assert in_processes(add_many, (path, "direct"), (path, "hybrid")) == [0, 0]
    found = check_benchmark(json.loads(path.read_text()), "here")
    assert sorted((r["method"], r["seed"]) for r in found["records"]) == [
        (method, seed) for method in ("direct", "hybrid") for seed in range(EACH)]
    assert found["seeds"] == list(range(EACH)) and list(tmp_path.iterdir()) == [path]


def count_up(path):
    for _ in range(60):
        with held(path):
            files.write_bytes(path, str(int(path.read_text() or 0) + 1).encode())


def test_a_held_file_is_changed_by_one_at_a_time(tmp_path):
    assert in_processes(count_up, *[(tmp_path / "n",)] * 3) == [0, 0, 0]
    assert (tmp_path / "n").read_text() == "180"


def test_a_file_that_stays_empty_is_none(tmp_path):
    with pytest.raises(ZeroDivisionError), held(tmp_path / "a/new"):
        assert not (tmp_path / "a/new").read_bytes()
        raise ZeroDivisionError
    assert not list((tmp_path / "a").iterdir())


def test_what_another_run_has_measured_meanwhile_stays(tmp_path):
    one, other = (Store(tmp_path / "b.json", SETTINGS) for _ in range(2))
    one.publish({"material": {"a": {"X": {"mean": 0.5}}}})
    other.publish({"material": {"b": {"X": {"mean": 0.6}}}})
    one.add(record("direct", mean=0.1))
    other.add(record("direct", mean=0.2))  # the same fit: the first stays
    other.add(record("direct", seed=1, mean=0.3))
    one.write()
    found = read_benchmark(tmp_path / "b.json")
    assert [(r["seed"], r["errors"]["mean"]) for r in found["records"]] == [(0, 0.1),
                                                                            (1, 0.3)] and found["seeds"] == [
                                                                                0, 1]
    assert set(found["published"]["material"]) == {"a", "b"} and one.records == found["records"]


def test_one_method_with_two_settings_is_refused(tmp_path):
    one, other = (Store(tmp_path / "b.json", SETTINGS) for _ in range(2))
    one.add(record("direct", mean=0.1))
    with pytest.raises(ConfigError, match="another --json"):
        other.add(record("direct", seed=1, mean=0.2) | {"config": {"smooth": 0.1}})
    assert Store(tmp_path / "b.json", SETTINGS).records == one.records


class Job:
    """A job that takes no time, with settings of its own."""

    group = shape = "a job"
    cost = 1.0

    def __init__(self, seed, **settings):
        self.key = {k: record()[k] for k in ("suite", "method", "kind", "name", "budget")} | {"seed": seed}
        self.settings, self.title = settings, f"seed {seed}"

    def run(self, report):
        return {k: v for k, v in record(mean=0.1).items() if k not in self.key and k != "config"}


def test_earlier_records_stay_until_the_first_new_one(tmp_path):
    jobs.run([Job(0), Job(1)], Store(tmp_path / "b.json", SETTINGS))
    before = (tmp_path / "b.json").read_bytes()
    for anew, settings in ((False, {"smooth": 0.1}), (True, {})):
        store = Store(tmp_path / "b.json", SETTINGS, anew)
        assert len(store.pending([Job(0, **settings)])) == 1 and (tmp_path / "b.json").read_bytes() == before
        if not anew:
            store.write()  # as where every job failed
            assert {r["seed"] for r in read_benchmark(tmp_path / "b.json")["records"]} == {0, 1}
        jobs.run([Job(0, **settings)], store)
        assert [r["config"] for r in read_benchmark(tmp_path / "b.json")["records"]] == [settings]
        (tmp_path / "b.json").write_bytes(before)


def test_a_record_that_another_run_took_away_is_missed(tmp_path):
    store = Store(tmp_path / "b.json", SETTINGS)
    jobs.run([Job(0), Job(1)], store)
    Store(tmp_path / "b.json", SETTINGS, anew=True).add(record(seed=5, mean=0.1))
    store.write()
    assert [job.title for job in store.pending([Job(0), Job(1)])] == ["seed 0", "seed 1"]


@pytest.mark.parametrize("when", ["writing", "between"])
def test_ctrl_c_between_jobs_and_while_a_record_is_written(when, tmp_path, monkeypatch):
    write, run, done = files.write_bytes, Job.run, []

    def interrupted(path, data):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)  # that it comes here
        write(path, data)

    if when == "writing":
        monkeypatch.setattr(files, "write_bytes", interrupted)
    monkeypatch.setattr(Job, "run", lambda job, report: done.append(job.title) or run(job, report))

    def told(text, share):
        if when == "between" and share > 0:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        jobs.run([Job(0), Job(1)], Store(tmp_path / "b.json", SETTINGS), told)
    monkeypatch.undo()
    assert done == ["seed 0"] and [r["seed"] for r in read_benchmark(tmp_path / "b.json")["records"]] == [0]


def test_another_version_of_mitsvbrdf_alone_goes_on(tmp_path):
    Store(tmp_path / "b.json", SETTINGS).add(record(mean=0.1))
    for name, refused in (("mitsvbrdf", False), ("torch", True)):
        content = json.loads((tmp_path / "b.json").read_text())
        content["versions"][name] = "0.0.1"
        (tmp_path / "c.json").write_text(json.dumps(content))
        if refused:
            with pytest.raises(ConfigError, match=name):
                Store(tmp_path / "c.json", SETTINGS)
        else:
            Store(tmp_path / "c.json", SETTINGS).add(record(seed=1, mean=0.1))


def test_fifteen_hundred_records_take_less_than_a_megabyte(tmp_path):
    names = ("diffuse", "specular", "roughness", "normal", "mean", "novel_light", "photos",
             "flip_novel_light", "flip_photos")
    many = [record("peers-baseline", 300.0, seed, "brick-uneven-stones",
                   **{name: 0.123456789 for name in names})
            | {"config": {"class": "HierarchicalConfig", "guess": "robust"}, "seconds": 123.4567891}
            for seed in range(1500)]
    store = Store(tmp_path / "b.json", SETTINGS)
    store.add(many[0])
    assert store.records[0]["errors"]["mean"] == 0.123457 and store.records[0]["seconds"] == 123.457
    assert len((tmp_path / "b.json").read_text().splitlines()[-1]) * 1500 < 1_000_000  # a record is one line
    exact = many[1] | {"method": "another", "budget": 0.123456789, "config": {"width": 0.123456789}}
    store.add(exact)
    kept = read_benchmark(tmp_path / "b.json")["records"][1]
    # what jobs are compared with
    assert (kept["budget"], kept["config"]) == (exact["budget"], exact["config"])


def ended(budget, seconds, stopped="iterations", kind="PeersConfig", **more):
    return record("peers-baseline", budget, seconds=seconds, mean=0.1) | {
        "stopped": stopped, "config": {"class": kind}} | more


class Longer:
    def __init__(self, budget, **more):
        self.key = {k: v for k, v in ended(budget, 1.0, **more).items() if k in (
            "suite", "method", "kind", "name", "budget", "seed", "left_out")}
        self.settings = {"class": "PeersConfig"}


def test_a_fit_that_ended_by_itself_is_not_run_for_longer(tmp_path):
    store = Store(tmp_path / "b.json", SETTINGS)
    store.add(ended(10.0, 10.0, "budget"))
    jobs_of = [Longer(budget) for budget in (10.0, 30.0, 100.0, 300.0)]
    assert [job.key["budget"] for job in store.pending(jobs_of)] == [30.0, 100.0, 300.0]
    store.add(ended(100.0, 84.0))
    assert [job.key["budget"] for job in store.pending(jobs_of)] == [30.0]
    assert store.repeats(jobs_of[3]) and not store.repeats(jobs_of[1])
    others = [Longer(300.0, seed=1), Longer(300.0, name="b"), Longer(300.0, kind="capture", left_out=[7, 8])]
    assert store.pending(others) == others  # each by itself
