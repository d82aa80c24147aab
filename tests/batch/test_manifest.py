"""What the manifest remembers, and what becomes of it when a batch dies."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys

import pytest

from mitsvbrdf.batch import manifest as manifest_module
from mitsvbrdf.batch.library.rows import rows
from mitsvbrdf.batch.manifest import Manifest
from mitsvbrdf.errors import OutputError
from mitsvbrdf.io.files import file_hash


@pytest.fixture
def manifest(tmp_path):
    made = Manifest(tmp_path / "manifest.sqlite")
    yield made
    made.close()


def material(letter, name="wood", source=None, **more):
    return {"identity": letter * 64, "name": name, "source": source or f"/shots/{name}",
            "asked": {"folder": "/", "a": 1},
            "own": "", "tags": [], "cost": 1.0} | more


def states(manifest, wanted=True):
    return {row["folder"]: row["state"] for row in manifest.materials(wanted=wanted)}


def test_what_is_wanted_is_pending_once(manifest):
    manifest.want([material("a"), material("b", "brick")])
    manifest.want([material("a"), material("b", "brick")])
    assert states(manifest) == {"wood-aaaaaaaa": "pending", "brick-bbbbbbbb": "pending"}
    assert manifest.counts() == {"done": 0, "failed": 0, "running": 0, "pending": 2}


def test_a_changed_capture_takes_the_place_of_its_former_self_which_is_kept(manifest):
    manifest.want([material("a"), material("b", "brick")])
    manifest.want([material("c")])
    assert set(states(manifest)) == {"wood-cccccccc", "brick-bbbbbbbb"}
    assert set(states(manifest, wanted=False)) == {"wood-aaaaaaaa", "wood-cccccccc", "brick-bbbbbbbb"}
    manifest.want([material("a")])  # and back
    assert set(states(manifest)) == {"wood-aaaaaaaa", "brick-bbbbbbbb"}


def test_a_capture_may_be_wanted_with_two_sets_of_options(manifest):
    manifest.want([material("a", own="--seed 1"), material("b", own="--seed 2")])
    assert set(states(manifest)) == {"wood-aaaaaaaa", "wood-bbbbbbbb"}


def test_other_options_in_a_later_command_make_another_material_and_hide_none(manifest):
    manifest.want([material("a", asked={"seed": 1, "folder": "/one"})])
    manifest.want([material("b", asked={"seed": 2, "folder": "/one", "limit": 9.0})])
    assert set(states(manifest)) == {"wood-aaaaaaaa", "wood-bbbbbbbb"}
    manifest.want([material("c", asked={"seed": 2, "folder": "/two"})])  # of other photos, typed elsewhere
    assert set(states(manifest)) == {"wood-aaaaaaaa", "wood-cccccccc"}


def test_a_capture_that_moved_keeps_its_result_and_gets_what_is_said_of_it_now(manifest):
    manifest.want([material("a")])
    manifest.want([material("a", "moved", own="--tag x", tags=["x"], cost=9.0, asked={"folder": "/new"})])
    (row,) = manifest.materials()
    assert [row[name] for name in ("folder", "source", "own", "tags", "cost", "asked")] == [
        "wood-aaaaaaaa", "/shots/moved", "--tag x", '["x"]', 9.0, '{"folder": "/new"}']


def test_an_attempt_from_its_begin_to_its_end(manifest):
    manifest.want([material("a")])
    first = manifest.begin("a" * 64, "w1", "here")
    assert states(manifest) == {"wood-aaaaaaaa": "running"}
    manifest.end(first, "pending", {"state": "crashed", "reason": "boom", "seconds": 1.0, "peak_bytes": 5,
                                    "row": None})
    second = manifest.begin("a" * 64, "w2", "there")
    manifest.end(second, "done", {"state": "done", "reason": "", "row": {"error": 0.5}})
    row, attempts = manifest.material("a" * 64), manifest.db.execute(
        "select * from attempts order by attempt").fetchall()
    assert [row[name] for name in ("state", "attempts", "published", "worker", "host", "row", "reason")] == [
        "done", 2, second, "w2", "there", '{"error": 0.5}', ""]
    assert [(each["attempt"], each["state"], each["reason"], each["worker"]) for each in attempts] == [
        (first, "crashed", "boom", "w1"), (second, "done", "", "w2")]


def test_what_ran_when_a_batch_died_waits_again(manifest):
    manifest.want([material("a"), material("b", "brick")])
    attempt = manifest.begin("a" * 64, "w1", "here")
    manifest.interrupted()
    assert states(manifest) == {"wood-aaaaaaaa": "pending", "brick-bbbbbbbb": "pending"}
    assert manifest.db.execute("select state from attempts where attempt = ?",
                               (attempt,)).fetchone()[0] == "lost"


def test_an_adopted_result_counts_with_the_attempt_that_made_it(manifest):
    manifest.want([material("a")])
    attempt = manifest.begin("a" * 64, "w1", "here")
    manifest.interrupted()
    manifest.adopt("a" * 64, {"attempt": attempt, "row": {"error": 0.5, "seconds": 3.0}})
    row = manifest.material("a" * 64)
    assert (row["state"], row["published"], row["seconds"], row["attempts"]) == ("done", attempt, 3.0, 1)
    assert manifest.db.execute("select state from attempts").fetchone()[0] == "done"


def test_names_of_attempts_go_on_after_those_of_a_manifest_that_was_lost(manifest):
    manifest.want([material("a")])
    manifest.adopt("a" * 64, {"attempt": f"{'a' * 16}-7", "row": {}})
    manifest.again("a" * 64)
    assert manifest.begin("a" * 64, "w1", "here") == f"{'a' * 16}-8"


def test_what_is_forgotten_is_gone(manifest):
    manifest.want([material("a"), material("b", "brick")])
    manifest.begin("a" * 64, "w1", "here")
    manifest.forget("a" * 64)
    assert set(states(manifest)) == {"brick-bbbbbbbb"}
    assert not manifest.db.execute("select * from attempts").fetchall()


def test_a_hash_is_remembered_while_size_and_time_stay(manifest, tmp_path, monkeypatch):
    counted = []
    monkeypatch.setattr(manifest_module, "file_hash", lambda path: counted.append(path) or file_hash(path))
    path = tmp_path / "photo.png"
    path.write_bytes(b"one")
    os.utime(path, ns=(0, 10**18))

    def known():
        counted.clear()
        found = manifest.hash_of(path)
        manifest._keep_hashes()
        return found == file_hash(path), len(counted)

    assert [known(), known()] == [(True, 1), (True, 0)]
    os.utime(path, ns=(0, 10**18 + 1))
    assert [known(), known()] == [(True, 1), (True, 0)]
    path.write_bytes(b"three")
    os.utime(path, ns=(0, 10**18 + 1))
    assert known() == (True, 1)


def test_a_relative_path_is_remembered_where_it_was(manifest, tmp_path, monkeypatch):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "flat.png").write_bytes(name.encode())
        os.utime(tmp_path / name / "flat.png", (5, 5))
        monkeypatch.chdir(tmp_path / name)
        found = manifest.hash_of(tmp_path.__class__("flat.png"))
        manifest._keep_hashes()
        assert found == file_hash(tmp_path / name / "flat.png")


def test_hashes_outlive_ctrl_c(tmp_path):
    first = Manifest(tmp_path / "manifest.sqlite")
    for name in ("one.png", "two.png", "three.png"):
        (tmp_path / name).write_text(name)
        first.hash_of(tmp_path / name)
    first.close()
    with sqlite3.connect(tmp_path / "manifest.sqlite") as db:
        assert db.execute("select count(*) from hashes").fetchone() == (3,)


def test_while_files_are_hashed_the_manifest_can_be_read_and_nothing_is_locked(manifest, tmp_path):
    for name in ("one.png", "two.png"):
        (tmp_path / name).write_text(name)
        manifest.hash_of(tmp_path / name)
        assert not manifest.db.in_transaction


def test_one_of_another_version_is_neither_read_nor_changed(tmp_path):
    path = tmp_path / "manifest.sqlite"
    Manifest(path).close()
    with sqlite3.connect(path) as db:
        db.execute("pragma user_version = 2")
    for readonly in (False, True):
        with pytest.raises(OutputError, match="manifest of version 1, got 2"):
            Manifest(path, readonly)
    with sqlite3.connect(path) as db:
        assert db.execute("pragma user_version").fetchone() == (2,)


def test_what_is_no_manifest_is_refused(tmp_path):
    (tmp_path / "manifest.sqlite").write_bytes(b"something else, and long enough" * 50)
    with pytest.raises(OutputError, match="not a database"):
        Manifest(tmp_path / "manifest.sqlite")


def test_one_that_a_batch_left_in_the_midst_of_a_change_can_be_looked_at(tmp_path):
    path = tmp_path / "manifest.sqlite"
    made = Manifest(path)
    made.want([material("a")])
    made.close()
    killed = f"""
import os, sqlite3
db = sqlite3.connect({str(path)!r})
db.execute("pragma cache_size = 5")
db.execute("update materials set state = 'done'")
for number in range(3000):
    db.execute("insert into hashes values (?, 1, 1, ?)", (str(number), "x" * 64))
os.kill(os.getpid(), 9)
"""
    subprocess.run([sys.executable, "-c", killed], check=False)
    assert (tmp_path / "manifest.sqlite-journal").stat().st_size  # else this shows nothing
    looked = Manifest(path, readonly=True)
    assert states(looked) == {"wood-aaaaaaaa": "pending"}
    looked.close()


def test_a_manifest_that_cannot_be_written_says_so(tmp_path):
    path = tmp_path / "manifest.sqlite"
    Manifest(path).close()
    looked = Manifest(path, readonly=True)
    with pytest.raises(OutputError, match=r"to write .*manifest.sqlite, got .*readonly.*; check your rights"):
        looked.want([material("a")])
    looked.close()


def test_a_full_disk_is_told_as_such(manifest):
    manifest.db.execute("pragma max_page_count = 1")  # SQLite raises it to what the file has
    with pytest.raises(OutputError, match="full; free space$"):
        manifest.want(material(chr(97 + k), f"wood-{k}" * 400) for k in range(20))


def test_a_place_without_rights_is_told_as_such(tmp_path):
    with pytest.raises(OutputError, match="check your rights"):
        Manifest(tmp_path / "nowhere/manifest.sqlite")


@pytest.mark.parametrize("column, value", [
    ("name", b"wood"), ("folder", None), ("attempts", "many"), ("cost", "x"), ("seconds", "x"), ("row", 7),
    ("host", b"\xff"),
    ("asked", "{"), ("asked", "[]"), ("asked", '{"config": 1}'), ("tags", "maps"), ("tags", "{}"),
    ("row", "[" * 100_000), ("row", '{"error": "none"}'), ("row", '{"warnings": 3}'), ("row", "[1]")])
def test_rows_that_somebody_tampered_with_are_one_error(column, value, tmp_path):
    manifest = Manifest(tmp_path / "manifest.sqlite")
    asked = {"folder": "/", "config": {"method": "gan"}, "options": {"resolution": 64}}
    manifest.want([material("a", asked=asked)])
    assert [row["method"] for row in rows(manifest)] == ["gan"]
    # takes null too
    manifest.db.executescript("create table other as select * from materials; drop table materials; "
                              "alter table other rename to materials")
    with manifest.db:
        manifest.db.execute(f"update materials set {column} = ?", (value,))
    with pytest.raises(OutputError, match="move it away"):
        list(rows(manifest))
    manifest.close()


def test_pages_that_are_damaged_are_one_error(tmp_path):
    path = tmp_path / "manifest.sqlite"
    manifest = Manifest(path)
    manifest.want(material(chr(97 + k), f"wood-{k}" * 99) for k in range(20))
    manifest.close()
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\xff" * (path.stat().st_size - 4096))
    manifest = Manifest(path, readonly=True)
    for read in (manifest.materials, manifest.counts):
        with pytest.raises(OutputError, match="malformed.*move it away"):
            read()
    manifest.close()
