"""Links, pipes and names that lead elsewhere in a library: nothing outside of it is read, written or
deleted.
"""

from __future__ import annotations

import contextlib
import os

import pytest
from helpers.batches import ELSEWHERE, FOLDER, asked, make_capture

from mitsvbrdf import cli
from mitsvbrdf.batch.manifest import FILE, Manifest
from mitsvbrdf.batch.places.place import clear_work
from mitsvbrdf.batch.prepare import library_lock, register
from mitsvbrdf.errors import OutputError
from mitsvbrdf.io.files import file_hash


def files_in(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_nothing_outside_is_read_written_or_deleted(place, result, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    (outside / "wood").mkdir()
    for name in ("batch.json", "wood/batch.json", "map.exr"):
        (outside / name).write_text("theirs")
    before = files_in(outside)
    with pytest.raises(OutputError, match="the name of a result"):
        place.remove(os.path.relpath(outside / "wood", place.root))
    (place.root / "linked").symlink_to(outside)
    place.remove("linked")
    assert not os.path.lexists(place.root / "linked")
    size = {"bytes": len("theirs"), "sha256": file_hash(outside / "map.exr")}
    for name in (os.path.relpath(outside / "map.exr", result), str(outside / "map.exr")):
        assert "changed" in place.damage(FOLDER, {"files": {name: size}}, hashes=True)
    clear_work(place.root)
    (place.root / ".work").symlink_to(outside)
    with pytest.raises(OutputError, match="a link"):
        place.staging("wood")
    clear_work(place.root)
    assert files_in(outside) == before and not list(place.root.glob(".work*"))


@pytest.mark.parametrize("name", ELSEWHERE)
def test_names_in_a_manifest_lead_nowhere(name, tmp_path, capsys):
    home, mine = tmp_path / "library", tmp_path / "mine"
    library_lock(home)()
    (home / "quarantine").mkdir()
    mine.mkdir()
    (mine / "thesis.txt").write_text("mine")
    with contextlib.closing(Manifest(home / FILE)) as manifest:
        register([asked(make_capture(tmp_path / "shots/wood"))], manifest, lambda *_: None)
        manifest.db.execute("update materials set folder = ?, state = 'failed', wanted = 0",
                            (name.replace("../mine", "../../mine"),))
        manifest.db.commit()
    assert cli.main(["library", str(home), "--prune"]) == 2
    assert "a library's manifest" in capsys.readouterr().err and (mine / "thesis.txt").read_text() == "mine"


def test_a_pipe_in_place_of_a_file_is_damage_and_not_waited_for(place, result):
    (result / "batch.json").unlink()
    os.mkfifo(result / "batch.json")
    os.mkfifo(result / "pipe")
    assert place.record(FOLDER) is None
    assert "changed" in place.damage(FOLDER, {"files": {"pipe": {"bytes": 0, "sha256": ""}}}, hashes=True)


@pytest.mark.parametrize("name, target", [
    *((name, target) for name in (".lock", ".token", "index.html", FILE, "quarantine/wood")
      for target in ("file", "missing")),
    (".lock", "folder"), ("quarantine", "folder"), ("quarantine/wood", "folder"), (".work", "folder")])
def test_nothing_is_written_through_a_link_in_a_library(tmp_path, name, target):
    home, outside = tmp_path / "library", tmp_path / "outside"
    library_lock(home)()
    (home / FILE).touch()
    outside.mkdir()
    (outside / "folder").mkdir()
    (outside / "file").write_text("theirs")
    (home / name).parent.mkdir(exist_ok=True)
    (home / name).unlink(missing_ok=True)
    (home / name).symlink_to(outside / target)
    with pytest.raises(OutputError):
        library_lock(home)
    assert (outside / "file").read_text() == "theirs" and sorted(path.name
                                                                 for path in outside.iterdir()) == ["file",
                                                                                                    "folder"]
