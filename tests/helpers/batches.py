"""Batches without fits: captures of a few bytes, results made by hand, a pool whose workers do as they are
told.
"""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from mitsvbrdf.batch.asked import Asked
from mitsvbrdf.batch.entries import Entry
from mitsvbrdf.batch.places.place import LocalPlace
from mitsvbrdf.fit.config import FitConfig, HierarchicalConfig
from mitsvbrdf.fit.options import FitOptions

FILES = {"maps/diffuse.png": b"diffuse", "fit.json": b"{}"}
ROW = {"error": 0.25, "seconds": 1.5, "date": "2026-11-23T10:00:00Z", "preview": None, "report": None,
       "warnings": []}

TASK = {"attempt": "aaaaaaaa-1", "identity": "a" * 64, "name": "wood"}
FOLDER = "wood-aaaaaaaa"  # where its result lies


def make_capture(folder: Path, photos: Sequence[bytes] = (b"one", b"two")) -> Path:
    """A capture whose photos are some bytes."""
    (folder / "target").mkdir(parents=True)
    (folder / "capture.json").write_text(json.dumps({"target_dir": "target"}))
    for number, photo in enumerate(photos):
        (folder / f"target/{number:02d}.png").write_bytes(photo)
    return folder


def asked(capture: Path, config: FitConfig | None = None, **options: object) -> Asked:
    """A capture with what is asked for."""
    config = config or HierarchicalConfig(budget=10.0)
    return Asked(Entry(str(capture)), config, FitOptions(**options), False, ())  # type: ignore[arg-type]


# Records that say no result: of somebody else, or spoiled.
NO_RECORDS = (
    "", "{", "[]", "3", "{}", '{"identity": "a", "attempt": "a-1", "row": {}}', "\xff", "[" * 100_000,
    '{"identity": "a", "attempt": "a-1", "row": [], "files": {}}',
    '{"identity": 3, "attempt": "a-1", "row": {}, "files": {}}',
    '{"identity": "a", "attempt": "first", "row": {}, "files": {}}',
    '{"identity": "a", "attempt": "a-1", "row": {"error": "low"}, "files": {}}',
    '{"identity": "a", "attempt": "a-1", "row": {"date": [1]}, "files": {}}',
    '{"identity": "a", "attempt": "a-1", "row": {}, "files": {"fit.json": 3}}',
    '{"identity": "a", "attempt": "a-1", "row": {}, "files": {"../fit.json": {"bytes": 1, "sha256": ""}}}')
# no names of results
ELSEWHERE = ("", ".", "..", "../mine", "a/b", "/mine", "*", "mine-[0-9]", "mine-????????", "a\0")


def write_result(staging: Path, task: Mapping, files: Mapping[str, bytes] = FILES) -> None:
    """A result as a child leaves it."""
    for name, content in files.items():
        (staging / name).parent.mkdir(parents=True, exist_ok=True)
        (staging / name).write_bytes(content)
    stated = {name: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
              for name, content in files.items()}
    (staging / "batch.json").write_text(json.dumps({
        "identity": task["identity"], "name": task["name"], "attempt": task["attempt"],
        "source": task.get("capture", ""),
        "asked": {}, "row": ROW, "files": stated}))


def publish_result(place: LocalPlace, task: Mapping) -> bool:
    """Make a result and let it appear."""
    staging = place.staging(task["attempt"])
    write_result(staging, task)
    return place.publish(staging, f"{task['name']}-{task['identity'][:8]}")


class FakePool:
    """Workers in this process.

    A deed is what becomes of a task: an outcome's state (``done`` publishes a result first), ``lost``,
    ``published, lost``, ``published, crashed``, ``claimed`` (says done, and there is nothing), ``held``
    (until :meth:`release`).

    Args:
        place: where results appear.
        deeds: by a capture's name, one an attempt; the last one is for all later ones; ``done`` where there
            are none.
        workers: how many.
        meanwhile: called at each look for events.
    """

    def __init__(self, place: LocalPlace, deeds: Mapping[str, Sequence[str]] | None = None, workers: int = 1,
                 meanwhile: Callable[[], None] = lambda: None) -> None:
        self.place, self.deeds, self.meanwhile = place, {name: deque(each)
                                                         for name, each in (deeds or {}).items()}, meanwhile
        self.tasks: list[dict] = []
        self.held: dict[str, dict] = {}
        self._events: list[dict] = []
        self._named = 0
        for _ in range(workers):
            self._up()

    def run(self, worker: str, task: dict) -> None:
        self.tasks.append(task)
        deeds = self.deeds.get(task["name"], deque(["done"]))
        self._do(worker, task, deeds.popleft() if len(deeds) > 1 else deeds[0])

    def events(self, seconds: float) -> list[dict]:
        self.meanwhile()
        found, self._events = self._events, []
        return found

    def close(self) -> None:
        self.held.clear()

    def release(self) -> None:
        """What was held is done now."""
        for worker, task in self.held.items():
            self._do(worker, task, "done")
        self.held.clear()

    def names(self) -> list[str]:
        """The captures in the order in which they were handed out."""
        return [task["name"] for task in self.tasks]

    def _up(self) -> None:
        self._named += 1
        self._events.append({"is": "worker", "worker": f"w{self._named}", "host": "here", "pid": 1,
                             "version": "0"})

    def _do(self, worker: str, task: dict, deed: str) -> None:
        if deed == "held":
            self.held[worker] = task
            return
        if deed == "done" or deed.startswith("published"):
            publish_result(self.place, task)
        deed = deed.removeprefix("published, ")
        if deed == "lost":
            self._events.append({"is": "lost", "worker": worker, "attempt": task["attempt"],
                                 "reason": "the node died"})
            self._up()
            return
        state = "done" if deed == "claimed" else deed
        row = ROW if state == "done" else None
        self._events.append({"is": "done", "worker": worker, "attempt": task["attempt"], "outcome": {
            "state": state, "reason": "" if row else f"it {state}", "log": "the log", "seconds": 2.0,
            "peak_bytes": 7,
            "row": row, "host": "here"}})
