"""The loop of a batch: whatever becomes of workers, each capture ends once, and what the library says is what
lies in it.
"""

from __future__ import annotations

import errno
import json
import os
import signal
from pathlib import Path

import pytest
from helpers.batches import FakePool, asked, make_capture, publish_result

from mitsvbrdf.batch import manifest as manifest_module
from mitsvbrdf.batch import run as run_module
from mitsvbrdf.batch.library import rows as library_module
from mitsvbrdf.batch.manifest import FILE, Manifest
from mitsvbrdf.batch.places.place import LocalPlace
from mitsvbrdf.batch.prepare import register, take_stock
from mitsvbrdf.batch.run import Batch, Progress
from mitsvbrdf.batch.schedule import Scheduler
from mitsvbrdf.errors import BackendError, OutputError

TURNS = 200  # after which a batch counts as hanging


class Round:
    """A batch of captures called a, b, c on workers that do as they are told; what it said, and what lies
    there.
    """

    def __init__(self, folder: Path, names: str = "abc") -> None:
        self.home, self.place, self.said = folder / "library", LocalPlace(folder / "library"), []
        self.home.mkdir(exist_ok=True)
        self.manifest = Manifest(self.home / FILE)
        captures = [folder / "shots" / name for name in names]
        for capture in captures:
            if not capture.exists():
                make_capture(capture, [capture.name.encode()])
        register([asked(capture) for capture in captures], self.manifest, lambda text, share: None)

    def run(self, deeds=None, workers=1, meanwhile=lambda: None, pool=None, retry_failed=False, **limits):
        self.stock = take_stock(self.manifest, self.place, self.home, retry_failed)
        turns = iter(range(TURNS))

        def turn():
            assert next(turns, None) is not None, f"it hangs; it said {self.said}"
            meanwhile()

        self.pool = pool or FakePool(self.place, deeds, workers, turn)
        self.batch = Batch(self.home, str(self.home), self.place, self.manifest,
                           Scheduler(self.stock.work, **limits),
                           lambda stands, line: self.said.append(line) if line else None)
        return self.batch.run(self.pool)

    def states(self):
        return {row["name"]: row["state"] for row in self.manifest.materials()}

    def attempts(self, name):
        return [row[0] for row in self.manifest.db.execute(
            "select a.state from attempts a join materials m using (identity) where m.name = ? order by "
            "a.attempt", (name,))]

    def published(self):
        return sorted(path.name[0] for path in self.home.iterdir() if (path / "batch.json").is_file())

    def listed(self):
        return {row["name"]: row["state"]
                for row in json.loads((self.home / "library.json").read_text())["materials"]}


@pytest.fixture
def batch(tmp_path):
    made = Round(tmp_path)
    yield made
    made.manifest.close()


def done(names="abc"):
    return dict.fromkeys(names, "done")


@pytest.mark.parametrize("workers", [1, 2, 7])
def test_all_are_done_once_and_listed(batch, workers):
    assert batch.run(workers=workers) is False
    assert batch.states() == batch.listed() == done() and batch.published() == ["a", "b", "c"]
    assert sorted(batch.pool.names()) == ["a", "b", "c"]
    assert sorted(batch.said) == [f"{name}: done, RMSE 0.2500, 2.0 s" for name in "abc"]
    row = batch.manifest.materials()[0]
    assert (row["seconds"], row["peak_bytes"], row["host"], json.loads(row["row"])["error"]) == (2.0, 7,
                                                                                                 "here", 0.25)
    assert batch.run() is False and batch.pool.tasks == []  # again: nothing is left


def test_what_is_refused_goes_to_the_quarantine_and_the_others_go_on(batch):
    batch.run({"b": ["failed"]})
    assert batch.states() == batch.listed() == done() | {"b": "failed"} and batch.published() == ["a", "c"]
    (folder,) = (batch.home / "quarantine").iterdir()
    assert (folder / "log.txt").read_text() == "the log"
    reason = json.loads((folder / "reason.json").read_text())
    assert (reason["name"], reason["state"], reason["reason"], reason["attempts"]) == ("b", "failed",
                                                                                       "it failed", 1)
    assert "b: failed: it failed" in batch.said
    assert batch.pool.names() == ["a", "b", "c"]


@pytest.mark.parametrize("state", ["crashed", "timeout", "memory"])
def test_what_dies_is_tried_again_at_the_end(batch, state):
    batch.run({"a": [state, "done"]})
    assert batch.pool.names() == ["a", "b", "c", "a"] and batch.states() == done()
    assert batch.attempts("a") == [state, "done"] and f"a: tried again ({state}): it {state}" in batch.said


def test_what_always_dies_ends_in_the_quarantine(batch):
    batch.run({"a": ["crashed"]}, retries=2)
    assert batch.pool.names() == ["a", "b", "c", "a", "a"] and batch.states() == done() | {"a": "failed"}
    assert json.loads(next((batch.home / "quarantine").glob("*/reason.json")).read_text())["attempts"] == 3


def test_one_tried_again_after_it_had_failed_leaves_the_quarantine(batch):
    batch.run({"a": ["failed"]})
    batch.run(retry_failed=True)
    assert batch.pool.names() == ["a"] and batch.states() == done()
    assert not list((batch.home / "quarantine").iterdir())


def test_what_was_lost_before_its_result_appeared_is_fitted_again_first(batch):
    batch.run({"a": ["lost", "lost", "done"]})
    assert batch.pool.names() == ["a", "a", "a", "b", "c"] and batch.states() == done()
    assert batch.attempts("a") == ["lost", "lost", "done"]


@pytest.mark.parametrize("deed", ["published, lost", "published, crashed"])
def test_what_was_lost_after_its_result_appeared_is_adopted_and_not_fitted_again(batch, deed):
    # of an earlier failure
    (batch.home / "quarantine" / batch.manifest.materials()[0]["folder"]).mkdir(parents=True)
    batch.run({"a": [deed]})
    assert sorted(batch.pool.names()) == ["a", "b", "c"] and batch.states() == done()
    assert batch.attempts("a") == ["done"] and any(line.startswith("a: done") for line in batch.said)
    assert batch.manifest.materials()[0]["published"].endswith("-1") and batch.batch.ended == 3
    assert not list((batch.home / "quarantine").iterdir())


@pytest.mark.parametrize("deed, limits", [("published, crashed", {"retries": 0}),
                                          ("published, lost", {"most_lost": 0}), ("published, failed", {})])
def test_a_result_that_lies_there_counts_even_where_nothing_is_tried_again(batch, deed, limits):
    batch.run({"a": [deed]}, **limits)
    assert batch.states() == done() and not (batch.home / "quarantine").exists()
    assert json.loads(batch.manifest.materials()[0]["row"])["error"] == 0.25


def test_a_result_said_to_be_done_that_is_not_there_failed(batch):
    batch.run({"a": ["claimed"]})
    assert batch.states() == batch.listed() == done() | {"a": "failed"}
    assert "a: failed: its result did not appear" in batch.said


def test_the_attempt_that_counts_is_the_one_whose_result_lies_there(batch):
    """A worker that was thought lost lets its result appear while another one fits the same capture."""
    def appear():
        if batch.pool.held and not batch.published():
            (task,) = batch.pool.held.values()
            publish_result(batch.place, task | {"attempt": "zombie-7"})
            batch.pool.release()

    batch.run({"a": ["held"]}, meanwhile=appear)
    assert batch.states() == done() and batch.manifest.materials()[0]["published"] == "zombie-7"


def test_what_is_lost_again_and_again_failed(batch):
    batch.run({"a": ["lost"]}, most_lost=3)
    assert batch.pool.names() == ["a"] * 4 + ["b", "c"] and batch.states()["a"] == "failed"
    assert "a: failed (lost): the node died" in batch.said


def test_a_full_disk_ends_it_in_order_and_the_same_goes_on(batch):
    assert batch.run({"a": ["held"], "b": ["full"]}, workers=2, meanwhile=lambda: batch.batch.trouble
                     and batch.pool.release()
                     ) is False
    assert batch.batch.trouble == "no space is left for results: it full; free space"
    assert batch.states() == {"a": "done", "b": "pending", "c": "pending"} and batch.pool.names() == ["a",
                                                                                                      "b"]
    assert not (batch.home / "quarantine").exists()
    batch.run()
    assert batch.states() == done() and batch.pool.names() == ["b", "c"]


@pytest.mark.parametrize("module, name", [(run_module, "write_library"), (run_module, "quarantine"),
                                          (manifest_module.Manifest, "begin"),
                                          (manifest_module.Manifest, "end"),
                                          (manifest_module.Manifest, "adopt")])
def test_a_manifest_or_page_that_cannot_be_written_ends_it_in_order(batch, monkeypatch, module, name):
    def full(*_, **__):
        raise OutputError("to write", os.strerror(errno.ENOSPC), "free space")

    monkeypatch.setattr(module, name, full)
    deeds = {"a": ["failed" if name == "quarantine" else "published, lost" if name == "adopt" else "done"]}
    assert batch.run(deeds) is False
    assert "No space left" in batch.batch.trouble and not batch.batch.scheduler.running
    monkeypatch.undo()
    batch.run({"a": ["done"]})
    assert batch.states() == batch.listed() == done()


def test_ctrl_c_waits_for_what_runs_and_says_once_how_to_end_that(batch):
    pressed = iter([lambda: None, lambda: os.kill(os.getpid(), signal.SIGINT), lambda: None, lambda: None,
                    lambda: batch.pool.release()])
    assert batch.run({"a": ["held"]}, meanwhile=lambda: next(pressed, lambda: None)()) is True
    assert batch.states() == batch.listed() == {"a": "done", "b": "pending", "c": "pending"}
    assert batch.said == ["stopping: waiting for 1 fit (Ctrl-C again ends at once)",
                          "a: done, RMSE 0.2500, 2.0 s"]


def test_ctrl_c_twice_waits_for_nothing_and_the_page_tells_what_is_left(batch):
    assert batch.run({"a": ["held"]}, meanwhile=lambda: batch.pool.held and os.kill(os.getpid(),
                                                                                    signal.SIGINT)) is True
    assert batch.pool.names() == ["a"] and batch.states() == batch.listed() == dict.fromkeys("abc", "pending")
    listed = json.loads((batch.home / "library.json").read_text())
    assert "progress" not in listed and listed["stopped"] is True  # nobody works on it any more
    assert signal.getsignal(signal.SIGINT) == signal.default_int_handler
    batch.run()
    assert batch.states() == done() and json.loads((batch.home / "library.json").read_text())[
        "stopped"] is False


def test_when_no_worker_comes_up_any_more_it_says_why_and_the_same_goes_on(batch):
    class Dead(FakePool):
        def events(self, seconds):
            if self.tasks:
                raise BackendError("Ray to stay up", "5 ends in a row", "see the log")
            return super().events(seconds)

    with pytest.raises(BackendError, match="5 ends"):
        batch.run(pool=Dead(batch.place, {"a": ["held"]}))
    batch.run()
    assert batch.states() == done()


def test_all_workers_lost_is_waited_for_until_others_come(batch):
    class Late(FakePool):
        looks = 0

        def events(self, seconds):
            self.looks += 1
            if self.looks < 5:
                return []
            return super().events(seconds)

    batch.run(pool=Late(batch.place))
    assert batch.states() == done()


def test_a_loss_told_twice_and_an_end_told_after_a_loss_count_once(batch):
    class Echo(FakePool):
        def events(self, seconds):
            found = super().events(seconds)
            losses = [event for event in found if event["is"] == "lost"]
            ends = [event | {"is": "done", "outcome": {"state": "done", "row": None, "reason": ""}}
                    for event in losses]
            return [*found, *losses, *ends]

    batch.run(pool=Echo(batch.place, {"a": ["lost", "done"]}))
    assert batch.states() == done() and batch.attempts("a") == ["lost", "done"]


def test_the_page_is_written_while_it_runs_but_not_all_the_time(batch, monkeypatch):
    written = []
    monkeypatch.setattr(run_module, "write_library", lambda *words: written.append(batch.states()))
    turns = iter(range(50))
    batch.run({"a": ["held"]}, meanwhile=lambda: next(turns, None) is None and batch.pool.release())
    assert len(written) == 2 and written[0]["a"] in ("running", "pending") and written[-1] == done()


def test_how_fast_it_goes_stands_on_the_page_while_it_runs(batch):
    seen = []

    def look():
        if (batch.home / "library.json").exists():
            seen.append(json.loads((batch.home / "library.json").read_text()))
            batch.pool.release()

    batch.run({"a": ["held"]}, meanwhile=look)
    assert set(seen[0]["progress"]) == {"per_hour", "left_seconds"} and seen[0]["stopped"] is False
    assert "progress" not in json.loads((batch.home / "library.json").read_text())


def test_what_is_left_is_told_by_what_ended():
    stands = Progress({"done": 6, "failed": 2, "running": 2, "pending": 10}, 60.0, 3, [])
    assert (stands.per_hour, stands.left_seconds) == (180.0, 240.0)
    # as many as run at a time have to end before it is known
    for ended, seconds in ((0, 60.0), (1, 60.0), (2, 0.0)):
        assert Progress({"done": 6, "failed": 0, "running": 2, "pending": 10}, seconds, ended,
                        []).left_seconds is None


def test_numbers_that_json_cannot_hold_do_not_stop_the_page(batch):
    batch.run()
    batch.manifest.db.execute("update materials set row = '{\"error\": NaN}' where name = 'a'")
    library_module.write_library(batch.home, batch.manifest, "library")
    rows = json.loads((batch.home / "library.json").read_text(),
                      parse_constant=lambda name: pytest.fail(name))
    assert rows["materials"][0]["error"] is None
