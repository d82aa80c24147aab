"""What the process that fits answers, and that its fits depend on nothing but their task."""

from __future__ import annotations

import errno
import json
import os
import select
import signal
import subprocess
import sys
import threading
import warnings
from pathlib import Path

import pytest
from batch.chaos import make_captures
from helpers.batches import make_capture

from mitsvbrdf.batch.asked import Asked
from mitsvbrdf.batch.child import _write_record, fit_into_library, serve
from mitsvbrdf.batch.entries import Entry
from mitsvbrdf.batch.places.place import LocalPlace
from mitsvbrdf.errors import CaptureError, InputWarning, MitsvbrdfError, OutputError
from mitsvbrdf.fit.config import HierarchicalConfig
from mitsvbrdf.fit.options import FitOptions, config_record
from mitsvbrdf.io.files import write_bytes

SIDE = 16


def options(pages=False, **more):
    return {"config": config_record(HierarchicalConfig(guess="min", iterations=4)),
            "options": vars(FitOptions(resolution=SIDE, **more)), "pages": pages, "sheet": None}


def answers(perform, *tasks):
    """What the child says to each task, after that it is ready."""
    theirs, to = os.pipe()
    back, out = os.pipe()
    child = threading.Thread(target=serve, args=(perform, theirs, out))
    child.start()
    with os.fdopen(back) as lines:
        with os.fdopen(to, "w") as orders:
            assert json.loads(lines.readline()) == {"ready": True}
            for task in tasks:
                orders.write(json.dumps({"task": task}) + "\n")
        found = [json.loads(line) for line in lines]
    child.join()
    return found


def raising(error):
    def perform(task):
        raise error
    return perform


@pytest.mark.parametrize("strict", [False, True])
def test_strict_is_told_to_the_process_that_fits(strict, tmp_path, monkeypatch, recwarn):
    asked = Asked(Entry(str(tmp_path)), HierarchicalConfig(), FitOptions(), False, (), strict=strict).record
    # else all would be done anew
    assert asked.get("strict", False) == strict and ("strict" in asked) == strict

    def damaged(*_):
        warnings.warn("00.jpg is damaged", InputWarning, stacklevel=2)
        return {}

    monkeypatch.setattr("mitsvbrdf.batch.child.fit_capture", damaged)
    task = {"attempt": "a", "name": "shot", "identity": "0" * 64, "capture": str(tmp_path),
            "library": str(tmp_path / "library"), "folder": str(tmp_path), "options": asked}
    monkeypatch.chdir(tmp_path)
    if not strict:
        assert "seconds" in fit_into_library(task)
        return
    with pytest.raises(MitsvbrdfError, match="00.jpg is damaged"):
        fit_into_library(task)


def test_a_row_comes_back_for_each_task_until_the_pipe_ends():
    assert answers(lambda task: {"twice": 2 * task["x"]}, {"x": 1}, {"x": 4}) == [
        {"state": "done", "reason": "", "row": {"twice": x}} for x in (2, 8)]
    assert answers(lambda task: {}) == []


def test_a_mistake_of_the_caller_is_its_words(capsys):
    (answer,) = answers(raising(CaptureError("photos", "none", "add some")), {})
    assert answer == {"state": "failed", "reason": "expected photos, got none; add some", "row": None}
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("error, reason", [(ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
                                           (OSError(errno.EACCES, "Permission denied"),
                                            "[Errno 13] Permission denied")])
def test_a_fault_is_named_and_its_place_goes_to_the_log_and_the_next_task_is_done(capsys, error, reason):
    def perform(task):
        if task["bad"]:
            raise error
        return {}

    assert answers(perform, {"bad": True}, {"bad": False}) == [
        {"state": "failed", "reason": reason, "row": None}, {"state": "done", "reason": "", "row": {}}]
    assert "Traceback" in (said := capsys.readouterr().err) and "in perform" in said


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_no_space_is_told_apart(number, tmp_path, monkeypatch):
    error = OSError(number, os.strerror(number))
    assert [each["state"] for each in answers(raising(error), {})] == ["full"]

    def full(*_):
        raise error

    monkeypatch.setattr(Path, "write_bytes", full)

    def perform(task):
        write_bytes(tmp_path / "x", b"")  # makes an OutputError of it

    with pytest.raises(OutputError):
        perform({})
    assert [each["state"] for each in answers(perform, {})] == ["full"]
    assert [each["state"] for each in answers(raising(OutputError("a", "b", "c")), {})] == ["failed"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0,
                    reason="only root may mount a small disk")
def test_a_full_disk_is_told_apart_whatever_meets_it_first(tmp_path):
    import torch

    from mitsvbrdf.io.images import write_exr

    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(disk)],
                      capture_output=True).returncode:
        pytest.skip("may not mount here")
    try:
        (answer,) = answers(lambda task: write_exr(disk / "x.exr", torch.rand(256, 256, 3)), {})
        left = list(disk.iterdir())
    finally:
        subprocess.run(["umount", str(disk)], check=True)
    assert answer["state"] == "full" and left == []


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("captures")
    make_captures(folder, 2, SIDE)
    return sorted(folder.iterdir())


def task_of(capture, library, number=1, **more):
    return {"attempt": f"{number:08d}-1", "name": capture.name, "identity": f"{number:064d}",
            "capture": str(capture),
            "library": str(library), "folder": os.getcwd(), "options": options(**more)}


def fitted(capture, library, **more):
    """The folder of the result, made in this process, and its row."""
    row = fit_into_library(task := task_of(capture, library, **more))
    return library / f"{capture.name}-{task['identity'][:8]}", row


def maps_of(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for part in ("maps", "uncertainty")
            for path in sorted((folder / part).iterdir())}


@pytest.fixture(scope="module")
def made_elsewhere(captures, tmp_path_factory):
    """The second capture fitted by a child of its own: the library, its answer, and signals that it listened
    to meanwhile.
    """
    library, heard = tmp_path_factory.mktemp("library"), 0
    theirs, to = os.pipe()
    back, out = os.pipe()
    child = subprocess.Popen(
        [sys.executable, "-P", "-m", "mitsvbrdf.batch.child", str(theirs), str(out)], pass_fds=(theirs, out),
        env=os.environ | {"MITSVBRDF_THREADS": "2", "OMP_NUM_THREADS": "2"}, start_new_session=True)
    os.close(theirs)
    os.close(out)
    with os.fdopen(back) as lines, os.fdopen(to, "w") as orders:
        assert json.loads(lines.readline()) == {"ready": True}
        print(json.dumps({"task": task_of(captures[1], library)}), file=orders, flush=True)
        while not select.select([lines], [], [], 0.002)[0]:
            heard |= signals_heard(child.pid)
        answer = json.loads(lines.readline())
    assert child.wait() == 0
    return library, answer, heard


def signals_heard(pid):
    """A bit a signal that a process has a handler for; 0 where the system does not tell."""
    status = Path(f"/proc/{pid}/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((int(line.split()[1], 16) for line in lines if line.startswith("SigCgt")), 0)


@pytest.mark.slow
def test_maps_are_the_same_to_the_byte_whatever_child_made_them(captures, tmp_path, made_elsewhere):
    """One process fits the second capture alone on two threads; this one does so after the first."""
    library, answer, _ = made_elsewhere
    fitted(captures[0], tmp_path)
    here, row = fitted(captures[1], tmp_path)
    assert answer["state"] == "done", answer
    assert maps_of(here) and maps_of(library / here.name) == maps_of(here)
    assert {name: value for name, value in row.items() if name not in ("seconds", "date")} == {
        name: value for name, value in answer["row"].items() if name not in ("seconds", "date")}
    assert row["photos"] == 9 and row["left_out_error"] is None and 0 < row["error"] < 0.2


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
def test_sigterm_ends_a_child_so_that_no_half_fit_counts(made_elsewhere):
    """A system that shuts down asks all its processes to end; `mitsvbrdf fit` would then keep what it has."""
    assert not made_elsewhere[2] & 1 << signal.SIGTERM - 1


def test_pages_change_neither_maps_nor_figures_also_of_photos_left_out(captures, tmp_path):
    (bare, row), (full, shown) = (fitted(captures[0], tmp_path / str(pages), pages=pages,
                                         views="0,1,2,3,4,5,6")
                                  for pages in (False, True))
    assert maps_of(bare) and maps_of(full) == maps_of(bare)
    for name in ("error", "burn_in", "warnings", "method", "resolution", "photos"):
        assert row[name] == shown[name], name
    assert row["photos"] == 7 and 0 < row["left_out_error"] < 0.5
    assert row["left_out_error"] == pytest.approx(shown["left_out_error"], rel=1e-3)
    assert {path.name for path in bare.iterdir()} == {"maps", "uncertainty", "fit.json", "preview.jpg",
                                                      "batch.json"}
    assert (row["report"], shown["report"], row["preview"]) == (None, "report.html", "preview.jpg")
    assert (full / "report.html").is_file() and (full / "scene.xml").is_file()


def test_a_result_says_what_it_is_and_leaves_nothing_behind(captures, tmp_path):
    folder, row = fitted(captures[0], tmp_path)
    record = LocalPlace(tmp_path).record(folder.name)
    assert record["identity"] == f"{1:064d}" and record["attempt"] == "00000001-1" and record["row"] == row
    assert record["source"] == str(captures[0]) and record["asked"] == json.loads(json.dumps(options()))
    there = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert set(record["files"]) == there - {"batch.json"}
    assert LocalPlace(tmp_path).damage(folder.name, record, hashes=True) == ""
    assert not [path for path in (tmp_path / ".work").iterdir() if path.is_dir()]
    # of one that was thought lost
    again = fit_into_library(task_of(captures[0], tmp_path) | {"attempt": "00000001-2"})
    assert again["error"] == row["error"] and LocalPlace(tmp_path).record(folder.name) == record
    assert not [path for path in (tmp_path / ".work").iterdir() if path.is_dir()]


def test_what_fails_leaves_nothing_behind(tmp_path):
    capture = make_capture(tmp_path / "wood", [b"no photo"])
    with pytest.raises(CaptureError):
        fit_into_library(task_of(capture, tmp_path / "library"))
    assert not [path for path in (tmp_path / "library").rglob("*") if path.is_dir() and path.name != ".work"]


def test_the_record_does_not_count_itself(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a/x").write_bytes(b"abc")
    _write_record(tmp_path, task_of(tmp_path, tmp_path), {})
    assert json.loads((tmp_path / "batch.json").read_text())["files"] == {"a/x": {
        "bytes": 3, "sha256": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"}}
