"""What a batch finds in its library before it begins: files are the truth, and nothing whole is fitted
twice.
"""

from __future__ import annotations

import json
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


class Library:
    """A library of captures that are some bytes, and what is done to it by hand."""

    def __init__(self, folder: Path) -> None:
        self.home, self.shots = folder / "library", folder / "shots"
        self.home.mkdir()
        self.manifest, self.place = Manifest(self.home / FILE), LocalPlace(self.home)

    def want(self, *names: str, photo: bytes = b"", **options: object) -> dict:
        """Register captures, each of photos of its own; those that cannot be entered."""
        for name in names:
            if not (self.shots / name).exists():
                make_capture(self.shots / name, [name.encode()])
            if photo:
                (self.shots / name / "target/00.png").write_bytes(photo)
        return register([asked(self.shots / name, **options) for name in names], self.manifest,
                        lambda text, share: None).nameless

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
            quarantine(self.home, self.row(name), "crashed", "boom", "log\udcff")
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
    publish_result(library.place, {"name": "wood", "identity": library.row("wood")["identity"],
                                   "attempt": "late-1"})
    assert library.stock().adopted == 1 and library.row("wood")["state"] == "done"


@pytest.mark.parametrize("harm, said", [
    (lambda folder: (folder / "fit.json").unlink(), "fit.json is missing"),
    (lambda folder: (folder / "fit.json").write_text("{ }"), "fit.json has changed"),
    (lambda folder: (folder / "batch.json").write_text("{"), "its record is missing"),
    (lambda folder: (folder / "batch.json").write_text(
        (folder / "batch.json").read_text().replace('"identity": "', '"identity": "0')),
     "its record is missing"),
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
    assert left(library, stock) == ["wood"] and before.is_dir() and before != library.home / library.row(
        "wood")["folder"]
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


def test_two_captures_with_one_name_are_two_materials(library):
    make_capture(library.shots / "monday/wood", [b"1"])
    make_capture(library.shots / "sunday/wood", [b"2"])
    library.want("monday/wood", "sunday/wood")
    assert [row["name"] for row in library.manifest.materials()] == ["wood", "wood"]
    assert len(library.stock().work) == 2


def test_what_cannot_be_read_is_in_quarantine_until_it_can(library, monkeypatch):
    make_capture(library.shots / "brick")
    real = library.manifest.hash_of

    def hash_of(path):
        if "brick" in str(path):
            raise PermissionError(13, "Permission denied", str(path))
        return real(path)

    monkeypatch.setattr(library.manifest, "hash_of", hash_of)
    for retry_failed in (False, True):
        assert not library.want("wood", "brick")
        assert left(library, library.stock(retry_failed)) == ["wood"]
        row = library.row("brick")
        reason = json.loads((library.home / "quarantine" / row["folder"] / "reason.json").read_text())
        assert reason == {"name": "brick", "source": str(library.shots / "brick"), "state": "failed",
                          "reason": row["reason"], "attempts": 0}
        assert "Permission denied" in row["reason"] and "check your rights" in row["reason"]
        assert not (library.home / "quarantine" / row["folder"] / "log.txt").exists()
    monkeypatch.undo()
    library.want("wood", "brick")
    assert left(library, library.stock()) == ["brick", "wood"] and library.row("brick")["state"] == "pending"


def test_a_capture_that_failed_is_tried_again_once_its_photos_are_others(library):
    library.want("wood")
    library.finish("wood", "failed")
    library.want("wood", photo=b"mended")
    assert left(library, library.stock()) == ["wood"]


def test_a_name_that_is_not_utf_8_is_left_out_with_its_reason(library):
    folder = os.path.join(os.fsencode(library.shots), b"w\xe9")
    try:
        os.makedirs(folder)
    except OSError:
        pytest.skip("this file system has no such names")
    Path(os.fsdecode(os.path.join(folder, b"00.png"))).write_bytes(b"x")
    nameless = library.want("brick", os.fsdecode(b"w\xe9"))
    assert len(nameless) == 1 and "rename it" in str(*nameless.values())
    assert left(library, library.stock()) == ["brick"]


def test_a_task_says_all_that_a_worker_must_know(library, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    library.want("wood", resolution=64)
    # the next batch is begun elsewhere; paths in options still start where they were written
    monkeypatch.chdir("/")
    task, row = library.begin("wood"), library.row("wood")
    assert task == {"attempt": f"{row['identity'][:16]}-1", "name": "wood", "identity": row["identity"],
                    "capture": str(library.shots / "wood"), "library": str(library.home),
                    "folder": str(tmp_path),
                    "limit": 210.0, "options": asked(library.shots / "wood", resolution=64).record | {
                        "config": asked(library.shots / "wood").record["config"] | {"fix": []}}}


def test_the_quarantine_keeps_reason_and_log(library):
    library.want("wood")
    folder = library.home / "quarantine" / library.finish("wood", "failed").name
    assert '"boom"' in (folder / "reason.json").read_text() and (folder / "log.txt").read_bytes() == b"log?"
    quarantine(library.home, library.row("wood"), "failed", "refused", " \n")
    assert [path.name for path in folder.iterdir()] == ["reason.json"]  # no log, as nothing was printed


def test_one_batch_at_a_time(tmp_path):
    home = tmp_path / "library"
    library_lock(home)()
    held = subprocess.Popen([sys.executable, "-c", f"""
import fcntl
lock = open({str(home / '.lock')!r}, "w")
fcntl.flock(lock, fcntl.LOCK_EX)
print("held", flush=True)
input()
"""], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert held.stdout.readline() == "held\n"
    with pytest.raises(OutputError, match="in use by another one"):
        library_lock(home)
    held.kill()  # whatever becomes of it, it holds nothing any more
    held.communicate()
    library_lock(home)()
    library_lock(home)()


def test_a_library_keeps_its_token_and_a_killed_first_run_is_gone_on_with(tmp_path):
    library_lock(tmp_path / "library")()
    token = (tmp_path / "library/.token").read_text()
    (tmp_path / "library/..token-12345678").touch()  # died while it was written
    library_lock(tmp_path / "library")()
    assert len(token) == 32 and (tmp_path / "library/.token").read_text() == token


@pytest.mark.parametrize("what", ["photos", "file", "broken link"])
def test_a_place_that_is_no_library_is_refused_and_left_as_it_is(tmp_path, what):
    home = tmp_path / "x"
    if what == "photos":
        home.mkdir()
        (home / "00.png").touch()
    elif what == "file":
        home.write_text("mine")
    else:
        home.symlink_to(tmp_path / "nowhere")
    with pytest.raises(OutputError, match="which holds photos" if what == "photos" else None):
        library_lock(home)
    assert what != "photos" or [path.name for path in home.iterdir()] == ["00.png"]
