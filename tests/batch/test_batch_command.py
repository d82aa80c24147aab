"""`mitsvbrdf batch` as a whole, on Ray."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("ray")

from batch import chaos

pytestmark = pytest.mark.slow
SIDE = 16
QUICK = ["--resolution", str(SIDE), *chaos.QUICKEST]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    chaos.make_captures(folder, 6, SIDE)
    return folder


@pytest.fixture
def shots(made, tmp_path, monkeypatch):
    """Six captures in shots/, and the test in the folder above."""
    shutil.copytree(made, tmp_path / "shots")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    return tmp_path / "shots"


def run(*words, library="library", script=("-m", "mitsvbrdf")):
    """Exit code and lines of a batch."""
    ran = subprocess.run([sys.executable, *script, "batch", *map(str, words), "-o", library, "--workers", "2",
                          *QUICK], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return ran.returncode, ran.stdout.splitlines()


def begins(said, begin, end):
    """Whether a line begins and ends so."""
    return any(line.startswith(begin) and line.endswith(end) for line in said)


def names_in(folder):
    return sorted(path.name for path in Path(folder).iterdir())


def rows(*tags):
    """By name; tags tell rows of one capture apart, which was also fitted with options of its own."""
    return {row["name"]: row for row in json.loads(Path("library/library.json").read_text())["materials"]
            if row["tags"] == list(tags)}


def test_a_whole_round(shots):
    """All; nothing; a changed photo; options of its own; one refused, left alone, mended and tried again."""
    code, said = run("shots")
    assert code == 0 and said[-1].startswith("6 done;") and said[-1].endswith("index.html shows them"), said
    assert {row["state"] for row in rows().values()} == {"done"} and len(rows()) == 6
    assert all(Path("library", row["folder"], "maps/diffuse.png").is_file() for row in rows().values())
    assert set(names_in("library")) >= {"index.html", "library.json"} and ".work" not in names_in("library")
    before = {path: path.stat().st_mtime_ns for path in Path("library").glob("*/maps/*")}

    code, said = run("shots")
    assert code == 0 and begins(said, "0 to fit", "; 6 done already") and said[-1].startswith("6 done")
    assert {path: path.stat().st_mtime_ns for path in Path("library").glob("*/maps/*")} == before

    first = sorted(shots.iterdir())[0].name
    photo = shots / first / "target/00.png"
    shutil.copy(shots / first / "target/01.png", photo)
    code, said = run("shots")
    assert code == 0 and begins(said, "1 to fit", "; 5 done already")
    assert len(list(Path("library").glob(f"{first}-*/batch.json"))) == 2  # the former result is kept

    Path("shots/list.txt").write_text(f"{first} --seed 3 --tag 'old wood'  # a remark\n")
    code, said = run("shots/list.txt")
    row = rows("old wood")[first]
    assert code == 0
    assert row["options"] == "guess=min, iterations=4, seed=3, resolution=16, pages=False"
    record = json.loads(Path("library", row["folder"], "fit.json").read_text())
    assert record["config"]["seed"] == 3

    photo.write_bytes(photo.read_bytes()[:-40])
    code, said = run("shots")
    assert code == 1 and rows()[first]["state"] == "failed" and "00.png" in rows()[first]["reason"]
    assert [name.rpartition("-")[0] for name in names_in("library/failed")] == [first]
    code, said = run("shots")
    assert code == 1 and any("0 to fit" in line and "1 failed before (--retry-failed)" in line
                             for line in said)
    code, said = run("shots", "--retry-failed")
    assert code == 1 and any("1 to fit" in line for line in said)
    shutil.copy(shots / first / "target/02.png", photo)
    code, said = run("shots")
    assert code == 0 and rows()[first]["state"] == "done"


def test_mistakes_are_told_before_anything_is_made(shots):
    Path("list.txt").write_text("shots\nshots --seed minus\n")
    for words, told in ((["nowhere"], "nothing at nowhere"), (["list.txt"], "line 2 of list.txt"),
                        (["shots", "--timeout", "0"], "--timeout > 0"),
                        (["shots", "--views", "x"], "photo numbers")):
        code, said = run(*words)
        assert code == 2 and any(told in line for line in said), (words, said)
    assert not Path("library").exists()
    code, said = run("shots", library="shots")
    assert code == 2 and "a new folder or a library" in said[-1] and len(names_in("shots")) == 6


def test_a_library_beside_its_captures_behind_a_link_is_none_of_them(shots):
    (shots.parent / "real").mkdir()
    (shots / "library").symlink_to(shots.parent / "real")
    for _ in range(2):
        assert run("shots", library="shots/library")[0] == 0
    assert len(list((shots.parent / "real").glob("*/batch.json"))) == 6


def test_captures_that_kill_their_worker_are_named_and_the_others_are_done(shots):
    poisons = {"hang": "killed after 20 s, the limit", "eat": "GiB, the limit is 2 GiB", "abort": "Aborted",
               "segfault": "Segmentation fault", "exit": "its worker died"}
    names = [path.name for path in sorted(shots.iterdir())]
    for name, poison in zip(names, poisons):
        (shots / name / "poison.txt").write_text(poison)
    code, said = run("shots", "--timeout", "20", "--memory", "2", "--retries", "1",
                     script=[str(Path(__file__).with_name("poisoned.py"))])
    found = rows()
    assert code == 1 and found[names[5]]["state"] == "done", said
    for name, reason in zip(names, poisons.values()):
        row = found[name]
        assert (row["state"], row["attempts"]) == ("failed", 2) and reason in row["reason"], row
        assert any(line.startswith(f"failed: {name} ") and reason in line for line in said)
        assert Path("library", row["folder"], "reason.json").is_file()


def test_two_batches_at_once_into_one_library(shots):
    start = [*chaos.command(shots, Path("library"), SIDE, 1)]
    both = [subprocess.Popen(start, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            for _ in range(2)]
    said = [each.communicate()[0] for each in both]
    codes = sorted(each.returncode for each in both)
    assert codes == [0, 2], said
    assert sum("in use by another one" in each for each in said) == 1
    found = chaos.counted(Path("library"))
    assert (found["folders"], found["identities"], found["torn"], found["left over"]) == (6, 6, 0, [])


def test_ctrl_c_once_ends_in_order_and_the_same_goes_on(shots):
    start = chaos.command(shots, Path("library"), SIDE, 1)
    batch = subprocess.Popen(start, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    deadline = time.monotonic() + 120
    while chaos.done_in(Path("library")) < 1 and time.monotonic() < deadline:
        time.sleep(0.05)
    batch.send_signal(signal.SIGINT)
    said = batch.communicate()[0]
    done = chaos.done_in(Path("library"))
    assert (batch.returncode, 1 <= done < 6) == (130, True) or (batch.returncode, done) == (0, 6), said
    assert said.count("Ctrl-C again") <= 1 and chaos.counted(Path("library"))["torn"] == 0
    code, said = run("shots")
    assert code == 0 and chaos.done_in(Path("library")) == 6


def test_a_reader_that_has_seen_enough_stops_nothing(shots):
    start = chaos.command(shots, Path("library"), SIDE, 2)
    batch = subprocess.Popen(start, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    batch.stdout.close()
    assert batch.wait(300) == 0 and chaos.done_in(Path("library")) == 6


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0,
                    reason="only root may mount a small disk")
def test_a_full_disk_loses_nothing_and_what_it_had_begun_is_done_when_there_is_space(shots):
    disk = Path("library")
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=300k", "none", "library"],
                      capture_output=True).returncode:
        pytest.skip("may not mount here")
    try:
        code, said = run("shots")
        assert code in (1, 2) and any("space" in line or "full" in line for line in said), said
        assert not (disk / "failed").exists() or not names_in("library/failed"), said
        subprocess.run(["mount", "-o", "remount,size=64m", "library"], check=True)
        code, said = run("shots")
        found = chaos.counted(disk)
        assert code == 0 and (found["folders"], found["torn"], found["left over"]) == (6, 0, []), said
    finally:
        subprocess.run(["umount", "-l", "library"], check=True)


def test_everything_dies_and_every_capture_is_done_once(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    count, captures, library = 24, tmp_path / "captures", tmp_path / "library"
    chaos.make_captures(captures, count, SIDE)
    quiet, begun = chaos.command(captures, tmp_path / "quiet", SIDE, 2), time.monotonic()
    assert subprocess.run(quiet, stdout=subprocess.DEVNULL).returncode == 0
    each = max(20.0, (time.monotonic() - begun) / 4)  # workers that die sooner than they start end nothing
    start = chaos.command(captures, library, SIDE, 2)
    found = chaos.disturbed(start, library, tmp_path / "log", worker_every=each, heads=1, commands=2,
                            total=count)
    said = (tmp_path / "log").read_text()[-3000:]
    assert (found["exit"], found["killed"]["command"], found["killed"]["head"]) == (0, 2, 1), (found, said)
    counts = chaos.counted(library)
    assert counts["folders"] == counts["identities"] == count and not counts["torn"], counts
    assert not counts["left over"], counts
    assert chaos.different_maps(tmp_path / "quiet", library) == []
