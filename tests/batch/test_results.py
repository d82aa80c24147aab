"""Results appear whole or not at all, in a folder and in a store. Damage is named."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.batches import FILES, publish, result_of

from mitsvbrdf.batch import results as module
from mitsvbrdf.batch.records import Material
from mitsvbrdf.batch.results import RECORD, WORK, ResultStore
from mitsvbrdf.errors import BackendError, OutputError

FOLDER = "wood-aaaaaaaa"
# Records that say no result: of somebody else, or spoiled.
NO_RECORDS = ("", "{", "[]", "3", "{}", '{"identity": "a"}', "\xff", "[" * 100_000, '{"identity": NaN}')
STATED = {"identity": "a" * 64, "name": "wood", "row": {}, "files": {}}
SPOILED = ({"row": []}, {"identity": 3}, {"row": {"error": "low"}}, {"row": {"warnings": "many"}},
           {"tags": [1]}, {"files": {"fit.json": 3}}, {"files": {"../fit.json": {"bytes": 1, "sha256": ""}}},
           {"name": "../wood"}, {"name": "brick"}, {"identity": "b" * 64}, {"source": "\ud800"})


@pytest.fixture(params=["folder", "store"])
def results(request, tmp_path):
    """An empty library, as a folder and behind a URL."""
    (tmp_path / "library").mkdir()
    return ResultStore(f"{'file://' * (request.param == 'store')}{tmp_path}/library")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "library").mkdir()
    return ResultStore(str(tmp_path / "library"))


def at(results) -> Path:
    return Path(results.address.removeprefix("file://"))


def tree(path) -> dict:
    return {str(each.relative_to(path)): each.read_bytes() if each.is_file() else None
            for each in sorted(path.rglob("*"))}


def test_a_result_is_there_with_its_record_and_files(results):
    assert results.result(FOLDER) is None and publish(results, result_of(tags=["old"]))
    found = results.result(FOLDER)
    assert found.tags == ["old"] and set(found.files) == set(FILES) and results.names() == [FOLDER]
    assert not results.damage(found, hashes=True)
    assert {name: (at(results) / FOLDER / name).read_bytes() for name in FILES} == FILES


def test_a_result_appears_by_one_rename_after_all_is_on_the_disk(folder, monkeypatch):
    done, rename, sync = [], os.rename, module.to_disk
    monkeypatch.setattr(module.os, "rename", lambda *names: (done.append("rename"), rename(*names)))
    monkeypatch.setattr(module, "to_disk", lambda path: (done.append(path.name), sync(path)))
    publish(folder, result_of())
    names = "diffuse.png", "fit.json", RECORD, "maps", "one"
    assert done.index("rename") > max(map(done.index, names))
    assert not list((folder.store.folder / WORK).iterdir())


def test_in_a_store_the_record_comes_last(tmp_path, monkeypatch):
    results, order = ResultStore(f"file://{tmp_path}/library"), []
    put = type(results.store).put
    monkeypatch.setattr(type(results.store), "put",
                        lambda self, file, name: (order.append(name), put(self, file, name)))
    publish(results, result_of())
    assert order[-1] == f"{FOLDER}/{RECORD}" and len(order) == len(FILES) + 1


def test_a_result_is_never_replaced(results):
    publish(results, result_of())
    assert not publish(results, result_of(), "two", {"fit.json": b"another"})
    assert (at(results) / FOLDER / "fit.json").read_bytes() == FILES["fit.json"]


@pytest.mark.parametrize("what", ["file", "folder", "torn"])
def test_what_is_no_result_goes_aside(folder, what):
    path = folder.store.folder / FOLDER
    if what == "file":
        path.write_text("mine")
    else:
        path.mkdir()
        (path / RECORD if what == "torn" else path / "mine").write_text("{")
    assert publish(folder, result_of()) and folder.result(FOLDER)
    assert len(list(folder.store.folder.glob(f"{FOLDER}.damaged.*"))) == 1


def test_a_worker_that_outlived_its_batch_publishes_nothing(folder):
    with pytest.raises(OutputError, match="taken away meanwhile"), folder.building("one") as made:
        (made / "fit.json").write_text("{}")
        folder.clear_work()
        made.mkdir(parents=True)  # it writes its next file
        (made / "late.json").write_text("{}")
        folder.publish(made, result_of())
    assert folder.names() == []


@pytest.mark.parametrize("text", [*NO_RECORDS, *(json.dumps(STATED | change) for change in SPOILED)])
def test_a_record_that_is_none_counts_for_nothing(results, text):
    publish(results, result_of())
    (at(results) / FOLDER / RECORD).write_text(text, encoding="latin-1")
    assert results.result(FOLDER) is None


@pytest.mark.parametrize("harm, by_size, by_hash", [
    (lambda path: path.write_bytes(b"longer than before"), True, True),
    (lambda path: path.write_bytes(b"[]"), False, True), (lambda path: path.unlink(), True, True)])
def test_damage_is_named(results, harm, by_size, by_hash):
    publish(results, result_of())
    harm(at(results) / FOLDER / "fit.json")
    for hashes, wrong in ((False, by_size), (True, by_hash)):
        assert ("fit.json" in results.damage(results.result(FOLDER), hashes)) == wrong


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/etc/passwd")],
                         ids=["pipe", "link"])
def test_what_is_no_file_is_damage_and_not_opened(folder, make):
    publish(folder, result_of())
    for name in ("fit.json", RECORD):
        found = folder.result(FOLDER)
        (folder.store.folder / FOLDER / name).unlink()
        make(folder.store.folder / FOLDER / name)
        assert name == RECORD or folder.damage(found, hashes=True) == "fit.json is missing"
    assert folder.result(FOLDER) is None


def test_what_is_set_aside_is_kept(results):
    for number in range(2):
        publish(results, result_of(), str(number))
        results.set_aside(FOLDER)
    kept = sorted(at(results).glob(f"{FOLDER}.damaged.*"))
    assert len(kept) == 2 and all((each / RECORD).is_file() for each in kept) and results.names() == []


def test_failures_are_remembered_until_they_are_forgotten(results):
    results.fail(Material(identity="b" * 64, name="oak", reason="SIGSEGV"), "its last words")
    found = results.materials()["oak-bbbbbbbb"]
    assert (found.state, found.reason) == ("failed", "SIGSEGV")
    assert (at(results) / "failed/oak-bbbbbbbb/log.txt").read_text() == "its last words"
    results.forget("oak-bbbbbbbb")
    assert results.materials() == {} and results.names() == []


def test_one_batch_at_a_time(folder):
    with folder.claimed() as token:
        code = ("import sys; from mitsvbrdf.batch.results import ResultStore\n"
                "with ResultStore(sys.argv[1]).claimed(): pass")
        other = subprocess.run([sys.executable, "-c", code, folder.address], capture_output=True, text=True)
        assert "in use by another one" in other.stderr, other.stderr
    with folder.claimed() as again:
        assert token == again and folder.is_library()


@pytest.mark.parametrize("name", ["photo.png", "notes.txt", "oak-bbbbbbbb/maps/diffuse.exr", "library.json"])
def test_a_folder_of_somebody_else_is_refused_and_left_as_it_is(folder, name):
    path = folder.store.folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("mine")
    before = tree(folder.store.folder)
    with pytest.raises(OutputError, match="a new folder or a library"), folder.claimed():
        pass
    assert tree(folder.store.folder) == before


def test_a_library_that_lost_all_but_its_results_is_accepted(folder):
    publish(folder, result_of())
    (folder.store.folder / "library.json").write_text("NaN")
    with folder.claimed():
        assert folder.result(FOLDER)


@pytest.mark.parametrize("name", [".lock", ".token", ".work", "library.json", "index.html", "failed"])
def test_nothing_is_written_through_a_link_in_a_library(folder, tmp_path, name):
    publish(folder, result_of())
    (tmp_path / "outside").mkdir()
    with folder.claimed():
        pass
    folder.clear_work()
    path = folder.store.folder / name
    if path.exists():
        path.unlink()
    path.symlink_to(tmp_path / "outside")
    with pytest.raises(OutputError, match="link"), folder.claimed():
        pass
    assert tree(tmp_path / "outside") == {}


def test_what_is_taken_away_is_inside(folder, tmp_path):
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / RECORD).write_text("mine")
    (folder.store.folder / f"{WORK}-old").symlink_to(tmp_path / "outside")
    folder.clear_work()
    assert tree(tmp_path / "outside") == {RECORD: b"mine"}
    assert not os.path.lexists(folder.store.folder / f"{WORK}-old")


def test_a_store_that_cannot_be_had_is_one_error(tmp_path):
    with pytest.raises(OutputError, match="an address that fsspec knows"):
        ResultStore("nowhere://library")
    with pytest.raises((BackendError, OutputError)), ResultStore("s3://library").claimed():
        pass
    with pytest.raises(OutputError), ResultStore(f"file://{tmp_path}/\0").claimed():
        pass


def test_records_say_all_that_they_hold(results):
    found = result_of(tags=["a"], host="here", words="--seed 3", attempts=2)
    publish(results, found)
    assert results.result(FOLDER).but(files={}) == found
    results.restate(results.result(FOLDER).but(tags=["b"]))
    assert results.result(FOLDER).tags == ["b"] and not results.damage(results.result(FOLDER), hashes=True)
