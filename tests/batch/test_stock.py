"""What is left to do: what lies in the library is checked and skipped, what has changed is done anew."""

import os
from pathlib import Path

import pytest
from helpers.batches import asked, make_capture, publish, result_of

from mitsvbrdf.batch import asked as asked_module
from mitsvbrdf.batch.asked import take_stock
from mitsvbrdf.batch.fitting import now
from mitsvbrdf.batch.library import Library
from mitsvbrdf.batch.results import RECORD, ResultStore
from mitsvbrdf.fit import HierarchicalConfig


@pytest.fixture
def shots(tmp_path):
    return [make_capture(tmp_path / f"shots/{name}", [name.encode()]) for name in ("oak", "pine", "ash")]


@pytest.fixture
def results(tmp_path):
    (tmp_path / "library").mkdir()
    return ResultStore(str(tmp_path / "library"))


def stock(results, *captures, retry_failed=False):
    """What is left to do, by a command that starts anew."""
    named = [asked(each) if isinstance(each, Path) else each for each in captures]
    return take_stock(named, Library(results), retry_failed)


def names(found):
    return [each.name for each in found.work]


def do(results, found):
    for each in found.work:
        publish(results, result_of(each, date=now()), each.folder)
        results.forget(each.folder)


def fail(results, found):
    for each in found.work:
        results.fail(each.but(reason="SIGSEGV"), "")


def test_what_is_new_is_left_to_do_with_its_cost(results, shots):
    found = stock(results, *shots)
    assert names(found) == ["oak", "pine", "ash"] and all(each.cost > 0 for each in found.work)


def test_what_is_done_is_not_done_again(results, shots):
    do(results, stock(results, *shots[:2]))
    found = stock(results, *shots)
    assert (names(found), found.done) == (["ash"], 2)


@pytest.mark.parametrize("harm, said", [(lambda folder: (folder / RECORD).unlink(), "its record is missing"),
    (lambda folder: (folder / RECORD).write_text("{"), "its record is missing"),
    (lambda folder: (folder / "fit.json").unlink(), "fit.json is missing"),
    (lambda folder: (folder / "fit.json").write_text("longer"), "fit.json has changed")])
def test_damage_is_noticed_kept_aside_and_done_anew(results, shots, harm, said):
    do(results, stock(results, shots[0]))
    (folder,) = results.names()
    harm(results.store.folder / folder)
    found = stock(results, shots[0])
    assert names(found) == ["oak"] and any(folder in note and said in note for note in found.notes)
    assert len(list(results.store.folder.glob(f"{folder}.damaged.*"))) == 1


def test_a_capture_that_changed_is_done_anew_and_hides_its_former_result(results, shots):
    do(results, stock(results, shots[0]))
    before = results.names()
    results.restate(results.result(before[0]).but(date="2026-01-01T00:00:00Z"))
    (shots[0] / "target/00.png").write_bytes(b"another")
    do(results, stock(results, shots[0]))
    assert len(results.names()) == 2 and list(Library(results).shown()) == [
        name for name in results.names() if name not in before]
    (shots[0] / "target/00.png").write_bytes(b"oak")  # back again
    for name in results.names():
        found = results.result(name)
        date = "2026-01-01T00:00:00Z" if name in before else "2026-01-02T00:00:00Z"
        results.restate(found.but(date=date))
    assert stock(results, shots[0]).done == 1 and list(Library(results).shown()) == before


def test_other_options_make_another_material_and_hide_none(results, shots):
    do(results, stock(results, shots[0]))
    do(results, stock(results, asked(shots[0], HierarchicalConfig(budget=10.0, seed=2))))
    assert len(Library(results).shown()) == 2


def test_a_capture_that_moved_keeps_its_result_and_gets_what_is_said_of_it_now(results, shots, tmp_path):
    do(results, stock(results, shots[0]))
    moved = make_capture(tmp_path / "shots2/oak", [b"oak"])
    assert stock(results, asked(moved, tags=("old", "wood"))).done == 1
    (row,) = [row for row in Library(results).rows() if row["state"] == "done"]
    assert row["tags"] == ["old", "wood"] and row["source"] == str(moved)


def test_what_failed_is_tried_again_only_when_asked_to_or_changed(results, shots):
    fail(results, stock(results, *shots))
    found = stock(results, *shots)
    assert (names(found), found.failed) == ([], 3)
    (shots[0] / "target/00.png").write_bytes(b"another")
    assert names(stock(results, *shots)) == ["oak"]
    assert len(names(stock(results, *shots, retry_failed=True))) == 3


def test_one_that_failed_and_whose_result_appeared_after_all_is_done(results, shots):
    found = stock(results, shots[0])
    fail(results, found)
    publish(results, result_of(found.work[0]))
    assert stock(results, shots[0]).done == 1
    assert not list((results.store.folder / "failed").iterdir())


def test_what_cannot_be_read_is_passed_over_until_it_can(results, shots, monkeypatch):
    def forbidden(path):
        raise PermissionError(13, "Permission denied", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(asked_module, "file_hash", forbidden)
        found = stock(results, shots[0])
        assert (found.work, found.unreadable) == ([], 1) and "check your rights" in found.notes[0]
    assert names(stock(results, shots[0])) == ["oak"]


def test_the_same_photos_under_two_names_are_fitted_once_and_that_is_said(results, tmp_path):
    one, other = (make_capture(tmp_path / name, [b"the same"]) for name in ("wood", "wood-copy"))
    found = stock(results, asked(one, tags=("old",)), other, asked(one, tags=("new", "old")))
    assert names(found) == ["wood"] and found.work[0].tags == ["old", "new"] and found.notes == [
        f"passed over: {other} has the photos and options of {one}"]
    do(results, stock(results, other))  # what the library has is not made again
    found = stock(results, one, other)
    assert (found.work, found.done, len(found.notes)) == ([], 1, 1)


def test_two_captures_with_one_name_are_two_materials(results, tmp_path):
    one, other = (make_capture(tmp_path / part / "same", [part.encode()]) for part in "ab")
    assert names(stock(results, one, other)) == ["same", "same"]


@pytest.mark.skipif(os.name == "nt", reason="names are text there")
def test_a_name_that_is_not_utf_8_is_passed_over_with_its_reason(results, shots, tmp_path):
    odd = make_capture(Path(os.fsdecode(os.fsencode(tmp_path) + b"/odd-\xff")))
    found = stock(results, odd, shots[0])
    assert names(found) == ["oak"] and "a name in UTF-8" in found.notes[0]
