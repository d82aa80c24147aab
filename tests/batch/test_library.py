"""A library that a batch made: listed, checked, exported, tidied up."""

import contextlib
import json
import shutil

import pytest
from helpers.captures import SIDE, write_captures

from mitsvbrdf import cli
from mitsvbrdf.batch.asked import Asked
from mitsvbrdf.batch.child import fit_into_library
from mitsvbrdf.batch.entries import Entry
from mitsvbrdf.batch.library.rows import write_library
from mitsvbrdf.batch.manifest import FILE, Manifest
from mitsvbrdf.batch.places.place import RECORD, LocalPlace
from mitsvbrdf.batch.prepare import library_lock, quarantine, register, take_stock, task_of
from mitsvbrdf.fit.config import HierarchicalConfig
from mitsvbrdf.fit.options import FitOptions

NAMES = ("shot-0", "shot-1", "shot-2")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two materials done, one of them twice since its calibration has changed, and one that failed."""
    root = tmp_path_factory.mktemp("made")
    captures, home = write_captures(root / "shots", 3), root / "library"
    library_lock(home)()
    manifest = Manifest(home / FILE)

    def fit(captures, iterations, tags):
        config = HierarchicalConfig(guess="min", iterations=iterations)
        asked = [Asked(Entry(str(capture)), config, FitOptions(resolution=SIDE), False, tags)
                 for capture in captures]
        register(asked, manifest, lambda *_: None)
        for work in take_stock(manifest, LocalPlace(home), home, False).work:
            attempt = manifest.begin(work.identity, "w1", "here")
            task = task_of(manifest, work, attempt, str(home))
            if task["name"] == NAMES[2]:
                manifest.end(attempt, "failed", {"state": "crashed", "reason": "killed"})
                quarantine(home, manifest.material(work.identity), "crashed", "killed", "a log")
            else:
                manifest.end(attempt, "done", {"state": "done", "row": fit_into_library(task),
                                               "seconds": 1.0})

    fit(captures[:1], 4, ("old",))
    with (captures[0] / "capture.json").open("a") as calibration:
        calibration.write("\n")
    fit(captures, 4, ("wood",))
    write_library(home, manifest, home.name)
    manifest.close()
    return home


@pytest.fixture
def library(made, tmp_path):
    return shutil.copytree(made, tmp_path / "library")


@pytest.fixture
def ask(library, capsys):
    """Call `mitsvbrdf library`: options -> exit code, lines, errors."""
    def ask(*options, folder=library):
        capsys.readouterr()
        code = cli.main(["library", str(folder), *map(str, options)])
        said = capsys.readouterr()
        return code, said.out.splitlines(), said.err

    return ask


def results(library):
    return sorted(path.parent.name for path in library.glob(f"*/{RECORD}"))


def test_rows(library, ask):
    code, lines, _ = ask("--json")
    first, second, failed = rows = [json.loads(line) for line in lines]
    assert code == 0 and [row["name"] for row in rows] == list(NAMES)
    assert rows == json.loads((library / "library.json").read_text())["materials"]
    for row in (first, second):
        record = json.loads((library / row["folder"] / "fit.json").read_text())
        assert row["state"] == "done" and row["error"] == record["rerender_rmse"] > 0
        assert (row["resolution"], row["photos"], row["tags"]) == (SIDE, len(record["capture"]["photos"]),
                                                                   ["wood"])
        assert (library / row["preview"]).is_file() and row["report"] is None  # no pages were asked for
    assert failed["state"] == "failed" and failed["reason"] == "killed" and failed["error"] is failed[
        "preview"] is None
    assert (library / failed["log"]).read_text() == "a log" and first["log"] is None
    (library / failed["log"]).write_text("")
    assert json.loads(ask("--json")[1][2])["log"] is None  # nobody is sent to an empty log


def test_listing(ask):
    code, lines, _ = ask()
    assert code == 0 and lines[0].strip() == "3 materials" and sum("done" in line for line in lines) == 2
    assert lines[-1].startswith("failed: shot-2-") and lines[-1].endswith(": killed")
    code, lines, _ = ask("--where", "shot-1")
    assert code == 0 and lines[0].strip() == "1 material"
    assert ask("--where", "nothing") == (0, ["no material matches"], "")


@pytest.mark.parametrize("where, names", [
    ("state:done", NAMES[:2]), ("state:failed", NAMES[2:]), ("tag:wood shot-1", NAMES[1:2]), ("tag:old", ()),
    ("error<1", NAMES[:2]), ("error>1", ()), (f"resolution={SIDE} reason:kill", NAMES[2:])])
def test_where(where, names, ask):
    code, lines, _ = ask("--json", "--where", where)
    assert code == 0 and [json.loads(line)["name"] for line in lines] == list(names)


def test_verify_finds_what_changed(library, ask):
    code, lines, _ = ask("--verify")
    assert code == 0 and lines[-1] == "unchanged: 2 of 2 results"
    first, second = (json.loads(line)["folder"] for line in ask("--json", "--where", "state:done")[1])
    maps = library / first / "maps" / "diffuse.exr"
    content = bytearray(maps.read_bytes())
    content[-1] ^= 1
    maps.write_bytes(content)
    (library / second / "preview.jpg").unlink()
    code, lines, _ = ask("--verify")
    assert code == 1 and lines[-1] == "unchanged: 0 of 2 results" and "run the same batch again" in lines[-2]
    assert f"changed: {first}: maps/diffuse.exr has changed" in lines
    assert f"changed: {second}: preview.jpg is missing" in lines
    (library / second / RECORD).unlink()
    code, lines, _ = ask("--verify", "--where", "shot-1")
    assert code == 1 and f"changed: {second}: its record is missing" in lines and lines[
        -1] == "unchanged: 0 of 1 result"


def test_prune_deletes_what_was_superseded_and_nothing_else(library, ask):
    before, wanted = results(library), ask("--json")[1]
    keep = [json.loads(line)["folder"] for line in wanted][:2]
    old, = set(before) - set(keep)
    assert old.startswith(NAMES[0])
    aside = [f"{keep[0]}.damaged", f"{keep[0]}.damaged1"]
    for folder in (*aside, "mine.damaged"):
        (library / folder / "maps").mkdir(parents=True)
    with contextlib.closing(Manifest(library / FILE)) as manifest:
        failed, = manifest.materials("failed")
        # new photos
        manifest.want([dict(failed) | {"identity": "f" * 64, "asked": json.loads(failed["asked"]),
                                       "tags": []}])
    wanted = ask("--json")[1]
    there = sorted(library.rglob("*"))
    told = [f"{old} (a newer result took its place)",
            *(f"{folder} (damaged, and made anew)" for folder in aside),
            f"quarantine/{failed['folder']} (its capture has changed)"]
    code, lines, _ = ask("--prune", "--dry-run")
    assert code == 0 and lines[:-1] == [f"would delete: {each}"
                                        for each in told] and sorted(library.rglob("*")) == there
    code, lines, _ = ask("--prune")
    assert code == 0 and lines[:-1] == [f"deleted: {each}" for each in told]
    assert lines[-1] == "deleted 3 results, and the reasons of 1 failure"
    assert results(library) == sorted(keep) and not (library / old).exists() and ask("--json")[1] == wanted
    assert not list(library.glob(f"{keep[0]}.*")) and (library / "mine.damaged").is_dir()
    assert not list((library / "quarantine").iterdir()) and ask("--verify")[0] == 0
    assert ask("--prune")[1] == ["deleted 0 results, and the reasons of 0 failures"] and results(
        library) == sorted(keep)
    code, _, error = ask("--dry-run")
    assert code == 2 and "--prune beside --dry-run" in error


def test_export_goes_on_after_one_that_fails(library, ask, tmp_path):
    first, second = (json.loads(line)["folder"] for line in ask("--json", "--where", "state:done")[1])
    (library / first / "fit.json").write_text("{")
    code, _, error = ask("--export", "maps,glft", "-o", tmp_path / "out")
    assert code == 2 and "'glft'" in error and not (tmp_path / "out").exists()
    code, lines, _ = ask("--export", "maps", "-o", tmp_path / "out")
    assert code == 1 and lines[-1] == f"exported 1 of 2 to {tmp_path / 'out'}"
    assert any(line.startswith(f"not exported: {first}: ") for line in lines)
    assert list((tmp_path / "out" / second / "maps").glob("*.png")) and not list(
        (tmp_path / "out").glob(f"{first}/maps/*"))
    for options in (["--export", "maps"], ["-o", tmp_path / "out"]):
        code, _, error = ask(*options)
        assert code == 2 and "give both, or neither" in error
    assert ask("--where", "shot-1", "--export", "maps", "-o", tmp_path / "out")[0] == 1  # it is there already
    assert ask("--where", "shot-1", "--export", "maps", "-o", tmp_path / "out", "--overwrite")[0] == 0


def test_what_is_no_library(ask, tmp_path):
    (tmp_path / "other").mkdir()
    for folder in (tmp_path / "other", tmp_path / "nowhere"):
        for options in ([], ["--prune"], ["--verify"]):
            code, _, error = ask(*options, folder=folder)
            assert code == 2 and "expected the LIBRARY of a batch" in error and str(folder) in error
    assert not (tmp_path / "nowhere").exists() and not list((tmp_path / "other").iterdir())


def test_a_library_in_use_is_looked_at_and_not_pruned(library, ask):
    before = results(library)
    unlock = library_lock(library)
    manifest = Manifest(library / FILE)
    try:
        for options in (["--json"], ["--verify"], []):
            assert ask(*options)[0] == 0
        code, _, error = ask("--prune")
        assert code == 2 and "in use" in error
    finally:
        manifest.close()
        unlock()
    assert results(library) == before and ask("--prune")[0] == 0
