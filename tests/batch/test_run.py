"""The loop of a batch, with tasks that end as they are told."""

import json
import signal

import pytest
from helpers.batches import FakeTasks, asked, make_capture

from mitsvbrdf.batch import run as module
from mitsvbrdf.batch.asked import take_stock
from mitsvbrdf.batch.library import Library
from mitsvbrdf.batch.results import ResultStore
from mitsvbrdf.batch.run import Batch
from mitsvbrdf.batch.settings import BatchSettings
from mitsvbrdf.errors import BackendError, OutputError
from mitsvbrdf.fit import HierarchicalConfig

NAMES = "oak", "pine", "ash"


@pytest.fixture
def batch(tmp_path):
    """A batch of three captures: deeds -> it, and its tasks; lines that it said stand in ``said``."""
    (tmp_path / "library").mkdir()
    results = ResultStore(str(tmp_path / "library"))
    shots = [make_capture(tmp_path / "shots" / name, [name.encode()]) for name in NAMES]

    def make(deeds=None, slots=1, retries=1, timeout=None, config=None):
        library, settings = Library(results), BatchSettings(workers=slots, retries=retries, timeout=timeout)
        work = take_stock([asked(each, config) for each in shots], library, True).work
        made = Batch(library, work, settings, "token", make.said.append)
        return made, FakeTasks(results, deeds, slots)

    make.said, make.results = [], results
    return make


def ended(made):
    return {each.name: each.state for each in made.library.shown().values()}


ALL_DONE = dict.fromkeys(NAMES, "done")


@pytest.mark.parametrize("slots", [1, 2, 5])
def test_all_are_done_once_and_listed(batch, slots):
    made, tasks = batch(slots=slots)
    assert made.run(tasks) is False and ended(made) == ALL_DONE and sorted(tasks.order) == sorted(NAMES)
    listed = json.loads((made.library.results.store.folder / "library.json").read_text())
    assert [row["name"] for row in listed["materials"]] == sorted(NAMES) and not listed["progress"]
    assert len(batch.said) == 3


def test_what_is_refused_fails_with_its_log_and_is_not_tried_again(batch):
    made, tasks = batch({"pine": ["failed"]})
    made.run(tasks)
    assert ended(made) == ALL_DONE | {"pine": "failed"} and tasks.order.count("pine") == 1
    failure = next(each for each in made.library.results.materials().values() if each.state == "failed")
    assert failure.reason == "it failed" and failure.log and failure.attempts == 1


@pytest.mark.parametrize("state", ["crashed", "memory", "cancelled"])
def test_what_dies_is_tried_again_after_all_others(batch, state):
    made, tasks = batch({"oak": [state, "done"]})
    made.run(tasks)
    assert tasks.order == ["oak", "pine", "ash", "oak"] and ended(made) == ALL_DONE
    result = next(each for each in made.library.materials.values() if each.name == "oak")
    assert result.state == "done" and result.attempts == 2


def test_what_always_dies_is_named_and_the_others_are_done(batch):
    made, tasks = batch({"oak": ["crashed"]}, retries=2)
    made.run(tasks)
    assert tasks.order.count("oak") == 3 and ended(made) == ALL_DONE | {"oak": "failed"}
    assert any("oak: failed (crashed): it crashed" in line for line in batch.said)


def test_what_was_lost_with_its_node_goes_first_and_up_to_a_limit(batch):
    made, tasks = batch({"oak": ["lost", "lost", "done"], "ash": ["lost"]}, retries=0)
    made.run(tasks)
    assert tasks.order[:3] == ["oak"] * 3 and ended(made) == ALL_DONE | {"ash": "failed"}
    assert tasks.order.count("ash") == module.MOST_LOST + 1


def test_a_result_that_lies_there_counts_whatever_became_of_its_worker(batch):
    made, tasks = batch({"oak": ["published, crashed"], "ash": ["published, lost"]}, retries=0)
    made.run(tasks)
    assert ended(made) == ALL_DONE and len(tasks.order) == 3


def test_a_result_said_to_be_done_that_is_not_there_failed(batch):
    made, tasks = batch({"oak": ["claimed"]})
    made.run(tasks)
    failed = [each for each in made.library.materials.values() if each.state == "failed"]
    assert [each.reason for each in failed] == ["its result did not appear"]


@pytest.mark.parametrize("timeout, config", [(2.0, None), (None, HierarchicalConfig(budget=1e-9))])
def test_a_fit_that_takes_too_long_is_killed_and_named(batch, timeout, config, monkeypatch):
    monkeypatch.setattr("mitsvbrdf.batch.asked.PATIENCE", 0.0)
    made, tasks = batch({"oak": ["held"]}, retries=1, timeout=timeout, config=config)
    times = iter(range(10_000))
    monkeypatch.setattr(module.time, "monotonic", lambda: float(next(times)))
    made.run(tasks)
    assert ended(made) == ALL_DONE | {"oak": "failed"} and tasks.order.count("oak") == 2
    failure = next(each for each in made.library.results.materials().values() if each.state == "failed")
    assert "the limit" in failure.reason


def test_a_full_disk_ends_it_in_order_and_the_same_goes_on(batch):
    made, tasks = batch({"pine": ["full"]})
    made.run(tasks)
    assert "free space" in made.trouble and ended(made) == {"oak": "done", "pine": "pending",
                                                            "ash": "pending"}
    made, tasks = batch()
    made.run(tasks)
    assert ended(made) == ALL_DONE and tasks.order == ["pine", "ash"]


def test_a_page_that_cannot_be_written_ends_it_in_order(batch, monkeypatch):
    made, tasks = batch(slots=2)

    def full(*_, **__):
        raise OutputError("to write the page", "no space", "free space")

    monkeypatch.setattr(Library, "write", full)
    made.run(tasks)
    assert "free space" in made.trouble and len(made.library.results.names()) == 2


@pytest.mark.parametrize("presses, done", [(1, 1), (2, 0)])
def test_ctrl_c_waits_for_what_runs_and_a_second_one_does_not(batch, presses, done):
    made, tasks = batch({"oak": ["held"]})
    events, start, given, turns = tasks.events, tasks.start, [], iter(range(100))

    def started(name, task):
        given.append((name, task))
        start(name, task)

    def pressed(seconds):
        turn = next(turns)
        if turn < presses:
            signal.raise_signal(signal.SIGINT)
            return []
        if turn == presses:
            tasks.deeds = {}
            start(*given[0])
        return events(seconds)

    tasks.start, tasks.events = started, pressed
    assert made.run(tasks) is True and len(given) == 1
    assert sum(state == "done" for state in ended(made).values()) == done
    assert sum("Ctrl-C again" in line for line in batch.said) == 1
    listed = json.loads((made.library.results.store.folder / "library.json").read_text())
    assert sum(row["state"] == "pending" for row in listed["materials"]) == 3 - done


@pytest.mark.parametrize("about, told", [({"version": "0.1"}, "on all nodes"),
                                         ({"token": "other"}, "all nodes see")])
def test_a_node_that_does_not_fit_ends_the_batch(batch, about, told):
    made, tasks = batch({"oak": ["held"]})
    events = tasks.events

    def other(seconds):
        return [(name, said | about if "version" in said else said) for name, said in events(seconds)]

    tasks.events = other
    with pytest.raises(BackendError, match=told):
        made.run(tasks)
    assert (made.library.results.store.folder / "index.html").is_file()


def test_ray_that_ends_is_an_error_and_the_page_tells_what_is_left(batch):
    made, tasks = batch({"oak": ["held"]})

    def gone(seconds):
        raise BackendError("Ray to run", "its end", "run the same command again")

    tasks.events = gone
    with pytest.raises(BackendError, match="again"):
        made.run(tasks)
    listed = json.loads((made.library.results.store.folder / "library.json").read_text())
    assert [row["state"] for row in listed["materials"]] == ["pending"] * 3


def test_the_page_is_written_while_it_runs_but_not_all_the_time(batch, monkeypatch):
    made, tasks = batch()
    written, write = [], Library.write
    monkeypatch.setattr(Library, "write",
                        lambda self, progress="": (written.append(progress), write(self, progress)))
    made.run(tasks)
    assert len(written) == 2 and "of 3 ended" in written[0] and written[1] == ""
