"""What a batch finds in its library before it begins: files are the truth, and nothing whole is fitted twice."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.batches import asked, make_capture, publish_result

from mitsvbrdf.batch.manifest import FILE, Manifest
from mitsvbrdf.batch.places.place import LocalPlace
from mitsvbrdf.batch.prepare import library_lock, quarantine, register, take_stock, task_of
from mitsvbrdf.batch.schedule import Work
from mitsvbrdf.errors import OutputError
from mitsvbrdf.fit import GanConfig, HierarchicalConfig


class Library:
    """A library of captures that are some bytes, and what is done to it by hand."""

    def __init__(self, folder: Path) -> None:
        self.home, self.shots = folder / "library", folder / "shots"
        self.home.mkdir()
        self.manifest, self.place = Manifest(self.home / FILE), LocalPlace(self.home)

    def want(self, *names: str, photo: bytes = b"", **options: object) -> dict:
        """Register captures, each of photos of its own; what is unreadable."""
        for name in names:
            if not (self.shots / name).exists():
                make_capture(self.shots / name, [name.encode()])
            if photo:
                (self.shots / name / "target/00.png").write_bytes(photo)
        named = [asked(self.shots / name, **options) for name in names]
        return register(named, self.manifest, lambda text, share: None).unreadable

    def stock(self, retry_failed: bool = False):
        return take_stock(self.manifest, self.place, self.home, retry_failed)

    def row(self, name: str):
        return next(row for row in self.manifest.materials() if row["name"] == name)

    def begin(self, name: str) -> dict:
        """Hand it out: the task."""
        row = self.row(name)
        attempt = self.manifest.begin(row["identity"], "w1", "here")
        return task_of(self.manifest, Work(row["identity"], 1.0), attempt, str(self.home))

    def finish(self, name: str, state: str = "done") -> Path:
        """Fit it, or fail; the folder."""
        task = self.begin(name)
        if state == "done":
            publish_result(self.place, task)
        self.manifest.end(task["attempt"], state, {"state": state, "reason": "boom"})
        if state == "failed":
            quarantine(self.home, self.row(name)["folder"], {"reason": "boom"}, "log\udcff")
        return self.home / self.row(name)["folder"]


@pytest.fixture
def library(tmp_path):
    made = Library(tmp_path)
    yield made
    made.manifest.close()


def left(library, stock):
    return sorted(library.manifest.material(work.identity)["name"] for work in stock.work)


def test_what_is_new_is_left_to_do_with_its_cost(library):
    library.want("wood", "brick")
    stock = library.stock()
    assert (left(library, stock), stock.done, stock.adopted, stock.damaged) == (["brick", "wood"], 0, 0, {})
    assert {work.cost for work in stock.work} == {library.row("wood")["cost"]}


def test_what_is_done_is_not_done_again(library):
    library.want("wood", "brick")
    library.finish("wood")
    library.want("wood", "brick")
    stock = library.stock()
    assert (left(library, stock), stock.done, stock.adopted) == (["brick"], 1, 0)


def test_a_result_whose_end_nobody_saw_is_adopted(library):
    library.want("wood")
    task = library.begin("wood")
    publish_result(library.place, task)  # and here the batch died
    stock = library.stock()
    assert (stock.work, stock.done, stock.adopted) == ([], 1, 1)
    assert (library.row("wood")["published"], library.row("wood")["state"]) == (task["attempt"], "done")


def test_a_manifest_that_was_lost_is_made_anew_from_the_results(library):
    library.want("wood", "brick")
    library.finish("wood")
    library.manifest.close()
    (library.home / FILE).unlink()
    library.manifest = Manifest(library.home / FILE)
    library.want("wood", "brick")
    stock = library.stock()
    assert (left(library, stock), stock.adopted) == (["brick"], 1)


def test_an_adopted_result_leaves_the_quarantine(library):
    library.want("wood")
    library.finish("wood", "failed")
    assert library.stock(retry_failed=True).work
    publish_result(library.place, library.begin("wood"))
    assert library.stock().adopted == 1
    assert not list((library.home / "quarantine").iterdir())


def test_one_that_failed_and_whose_result_appeared_after_all_is_adopted(library):
    library.want("wood")
    library.finish("wood", "failed")
    publish_result(library.place, {"name": "wood", "identity": library.row("wood")["identity"], "attempt": "late-1"})
    assert library.stock().adopted == 1 and library.row("wood")["state"] == "done"


@pytest.mark.parametrize("harm, said", [
    (lambda folder: (folder / "fit.json").unlink(), "fit.json is missing"),
    (lambda folder: (folder / "fit.json").write_text("{ }"), "fit.json has changed"),
    (lambda folder: (folder / "batch.json").write_text("{"), "its record is missing"),
    (lambda folder: (folder / "batch.json").write_text(
        (folder / "batch.json").read_text().replace('"identity": "', '"identity": "0')), "its record is missing"),
    (lambda folder: folder.rename(folder.with_name("away")), "its record is missing")])
def test_damage_is_noticed_kept_aside_and_done_anew(library, harm, said):
    library.want("wood")
    folder = library.finish("wood")
    harm(folder)
    harmed = {path.name: path.read_bytes() for path in folder.glob("*.json")}
    stock = library.stock()
    assert (left(library, stock), stock.damaged) == (["wood"], {folder.name: said})
    assert not folder.exists()
    aside = folder.with_name(f"{folder.name}.damaged")
    assert {path.name: path.read_bytes() for path in aside.glob("*.json")} == harmed
    library.finish("wood")
    assert library.stock().work == []


def test_a_torn_result_that_was_never_noted_goes_aside_too(library):
    library.want("wood")
    publish_result(library.place, library.begin("wood"))
    folder = library.home / library.row("wood")["folder"]
    (folder / "fit.json").unlink()
    assert library.stock().damaged == {folder.name: "fit.json is missing"}


def test_results_of_former_photos_stay_and_are_wanted_no_more(library):
    library.want("wood")
    before = library.finish("wood")
    library.want("wood", photo=b"another")
    stock = library.stock()
    assert left(library, stock) == ["wood"] and before.is_dir() and before != library.home / library.row("wood")["folder"]
    assert [row["wanted"] for row in library.manifest.materials(wanted=False)] in ([0, 1], [1, 0])


def test_pending_ones_of_former_photos_are_not_fitted(library):
    library.want("wood")
    library.want("wood", photo=b"another")
    assert len(library.stock().work) == 1


def test_what_failed_is_tried_again_only_when_asked_to(library):
    library.want("wood", "brick")
    library.finish("wood", "failed")
    assert left(library, library.stock()) == ["brick"]
    assert left(library, library.stock(retry_failed=True)) == ["brick", "wood"]


def test_what_ran_when_the_batch_died_is_left_to_do_and_its_folder_is_gone(library):
    library.want("wood")
    staging = library.place.staging(library.begin("wood")["attempt"])
    (staging / "half").touch()
    assert left(library, library.stock()) == ["wood"]
    assert not staging.exists()
