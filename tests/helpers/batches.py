"""Batches without fits: captures of a few bytes, results made by hand, tasks that end as they are told."""

import json
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from mitsvbrdf.batch.asked import Asked
from mitsvbrdf.batch.captures import Entry
from mitsvbrdf.batch.records import Material, Row
from mitsvbrdf.batch.results import ResultStore
from mitsvbrdf.fit.config import FitConfig, HierarchicalConfig
from mitsvbrdf.fit.options import FitOptions

FILES = {"maps/diffuse.png": b"diffuse", "fit.json": b"{}"}
ROW = Row(error=0.25, seconds=1.5, warnings=["dark"])
DATE = "2026-11-23T10:00:00Z"


def make_capture(folder: Path, photos: Sequence[bytes] = (b"one", b"two")) -> Path:
    """A capture whose photos are some bytes."""
    (folder / "target").mkdir(parents=True)
    (folder / "capture.json").write_text(json.dumps({"target_dir": "target"}))
    for number, photo in enumerate(photos):
        (folder / f"target/{number:02d}.png").write_bytes(photo)
    return folder


def asked(capture: Path, config: FitConfig | None = None, tags: tuple[str, ...] = (),
          **options: object) -> Asked:
    config = config or HierarchicalConfig(budget=10.0)
    return Asked(Entry(str(capture)), config, FitOptions(**options), False, tags)  # type: ignore[arg-type]


def result_of(material: Material | None = None, **changes: object) -> Material:
    """A record without files; of ``wood`` where no material is given."""
    material = material or Material(identity="a" * 64, name="wood")
    return material.but(**{"state": "done", "row": ROW, "date": DATE} | changes)


def publish(results: ResultStore, result: Material, attempt: str = "one",
            files: Mapping[str, bytes] = FILES) -> bool:
    """Make a result and let it appear."""
    with results.building(attempt) as made:
        for name, content in files.items():
            (made / name).parent.mkdir(parents=True, exist_ok=True)
            (made / name).write_bytes(content)
        return results.publish(made, result)


class FakeTasks:
    """Tasks in this process, ``slots`` at a time, see :class:`mitsvbrdf.batch.tasks.RayTasks`.

    A deed, by a capture's name one an attempt, is what becomes of a task: a state (``done``, the default,
    publishes a result first), ``published, crashed``, ``claimed`` (says done, and there is nothing), ``held``
    (until it is cancelled).
    """

    def __init__(self, results: ResultStore, deeds: Mapping[str, Sequence[str]] | None = None,
                 slots: int = 1) -> None:
        self.results, self.slots, self.order = results, slots, list[str]()
        self.deeds = {name: deque(each) for name, each in (deeds or {}).items()}
        self.about = {"host": "here", "version": "", "token": ""}
        self.said = list[tuple[str, dict]]()
        self.held = set[str]()

    def start(self, name: str, task: dict) -> None:
        material = msgspec.convert(task["material"], Material)
        deeds = self.deeds.get(material.name, deque(["done"]))
        deed = deeds.popleft() if len(deeds) > 1 else deeds[0]
        self.order.append(material.name)
        self.said.append((name, {"host": "here", "version": task["version"], "token": task["token"]}))
        if deed == "held":
            self.held.add(name)
            return
        if deed == "done" or deed.startswith("published"):
            publish(self.results, result_of(material), name)
        state = "done" if deed == "claimed" else deed.removeprefix("published, ")
        log = {} if state in ("crashed", "lost") else {"log": "the log"}
        self.said.append((name, {"state": state, "reason": f"it {state}", **log}))

    def cancel(self, *names: str) -> None:
        self.said += [(name, {"state": "cancelled", "reason": "its worker was killed"})
                      for name in names if name in self.held]
        self.held -= set(names)

    def events(self, seconds: float) -> list[tuple[str, dict]]:
        said, self.said = self.said, []
        return said
