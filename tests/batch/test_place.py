"""A result appears whole or not at all, is never replaced, and what happened to it later is noticed."""

from __future__ import annotations

import json
import os

import pytest
from helpers.batches import FILES, FOLDER, NO_RECORDS, ROW, TASK, publish_result, write_result

from mitsvbrdf.batch.places import place as place_module
from mitsvbrdf.batch.places.place import clear_work
from mitsvbrdf.errors import OutputError


def files_in(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_result_appears_whole_by_one_rename_after_all_is_on_the_disk(place, monkeypatch):
    staging, calls = place.staging(TASK["attempt"]), []
    write_result(staging, TASK)
    for name in ("rename", "replace", "fsync"):
        real = getattr(os, name)
        monkeypatch.setattr(os, name, lambda *words, name=name, real=real: calls.append(name) or real(*words))
    assert place.publish(staging, FOLDER)
    assert calls == ["fsync"] * 5 + ["rename", "fsync"]  # three files, two folders; then the library's own
    assert files_in(place.root / FOLDER).keys() == {*FILES, "batch.json"}
    assert not staging.exists()


def test_a_result_is_never_replaced(place, result):
    before = files_in(result)
    staging = place.staging("aaaaaaaa-2")
    write_result(staging, TASK | {"attempt": "aaaaaaaa-2"}, {"maps/diffuse.png": b"another"})
    assert not place.publish(staging, FOLDER)
    assert files_in(result) == before


@pytest.mark.parametrize("what", ["empty", "torn", "file"])
def test_what_is_no_result_goes_aside(place, what):
    there = place.root / FOLDER
    if what == "file":
        there.write_text("mine")
    else:
        there.mkdir()
        if what == "torn":
            (there / "fit.json").write_text("{")
    assert publish_result(place, TASK)
    assert place.record(FOLDER)
    aside = place.root / f"{FOLDER}.damaged"
    assert aside.exists() == (what != "empty")
    assert what == "empty" or (aside.read_text() if what == "file" else files_in(aside)) in ("mine",
                                                                                             {"fit.json": b"{"})


def test_another_mistake_of_the_disk_is_told(place, monkeypatch):
    def broken(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(place_module.os, "rename", broken)
    with pytest.raises(OSError, match="No space"):
        publish_result(place, TASK)


def test_a_disk_that_cannot_sync_folders_makes_no_result_fail(place, monkeypatch):
    real = place_module.to_disk

    def picky(path):
        if path == place.root:
            raise OSError(22, "Invalid argument")
        real(path)

    monkeypatch.setattr(place_module, "to_disk", picky)
    assert publish_result(place, TASK)


def test_staging_begins_empty(place):
    (place.staging("a") / "left.txt").touch()
    assert not list(place.staging("a").iterdir())


def test_a_worker_that_outlived_its_batch_publishes_nothing(place):
    """It wrote a map, a new batch took its folder away, it wrote the rest: what lies there lacks the map."""
    staging = place.staging(TASK["attempt"])
    (staging / "lost.exr").touch()
    clear_work(place.root)
    assert not staging.exists()
    write_result(staging, TASK)
    with pytest.raises(OutputError, match="taken away meanwhile"):
        place.publish(staging, FOLDER)
    assert not (place.root / FOLDER).exists()


def test_clearing_takes_away_what_an_earlier_clearing_left(place):
    place.staging("a")
    (place.root / ".work-12345678/b").mkdir(parents=True)
    clear_work(place.root)
    clear_work(place.root)
    assert not list(place.root.iterdir())


def test_the_record_is_that_of_the_result(place, result):
    found = place.record(FOLDER)
    assert (found["identity"], found["attempt"], found["row"]) == (TASK["identity"], TASK["attempt"], ROW)


@pytest.mark.parametrize("text", [None, *NO_RECORDS])
def test_a_torn_or_missing_record_is_none(place, result, text):
    (result / "batch.json").unlink()
    if text is not None:
        (result / "batch.json").write_bytes(text.encode("latin-1"))
    assert place.record(FOLDER) is None
    assert place.record("nowhere") is None


def test_nothing_is_wrong_with_a_result_as_it_was_made(place, result):
    (result / "notes.txt").write_text("a user's own")
    assert place.damage(FOLDER, place.record(FOLDER), hashes=True) == ""


@pytest.mark.parametrize("harm, by_size, by_hash", [
    (lambda path: path.unlink(), "is missing", "is missing"),
    (lambda path: path.write_bytes(b"diff"), "has changed", "has changed"),
    (lambda path: path.write_bytes(b"Diffuse"), "", "has changed"),
    (lambda path: (path.unlink(), path.mkdir()), "has changed", "has changed")])
def test_damage_is_named(place, result, harm, by_size, by_hash):
    harm(result / "maps/diffuse.png")
    record = place.record(FOLDER)
    for hashes, said in ((False, by_size), (True, by_hash)):
        assert place.damage(FOLDER, record, hashes) == (said and f"maps/diffuse.png {said}")


def test_a_link_in_the_place_of_a_file_is_damage(place, result):
    path = result / "maps/diffuse.png"
    path.rename(result / "maps/another")
    path.symlink_to("another")  # a link's size is the length of its words, here that of the file
    assert path.lstat().st_size == path.stat().st_size
    assert place.damage(FOLDER, place.record(FOLDER), hashes=True) == "maps/diffuse.png has changed"


def test_what_is_set_aside_is_kept_under_a_number(place):
    for content in "abc":
        (place.root / FOLDER).mkdir()
        (place.root / FOLDER / "x").write_text(content)
        place.set_aside(FOLDER)
    place.set_aside(FOLDER)  # nothing is there
    assert {path.name: (path / "x").read_text() for path in place.root.iterdir()} == {
        f"{FOLDER}.damaged": "a", f"{FOLDER}.damaged1": "b", f"{FOLDER}.damaged2": "c"}


def test_what_was_set_aside_is_found_and_can_be_removed_whatever_it_is(place):
    (place.root / "mine.damaged").mkdir()
    (place.root / FOLDER).write_text("a file that had the name of a result")
    place.set_aside(FOLDER)
    (place.root / f"{FOLDER}.damaged7").symlink_to(place.root / "mine.damaged")
    assert place.aside() == [f"{FOLDER}.damaged", f"{FOLDER}.damaged7"]
    for folder in place.aside():
        place.remove(folder)
    assert [path.name for path in place.root.iterdir()] == ["mine.damaged"]


def test_what_is_removed_is_gone_its_record_first(place, result, monkeypatch):
    monkeypatch.setattr(place_module.shutil, "rmtree", lambda *_, **__: None)  # died here
    place.remove(FOLDER)
    assert place.record(FOLDER) is None and (result / "fit.json").exists()
    monkeypatch.undo()
    place.remove(FOLDER)
    place.remove(FOLDER)
    assert not result.exists()


def test_the_record_of_hand_made_results_is_json(place, result):
    assert set(json.loads((result / "batch.json").read_text())["files"]) == set(FILES)
