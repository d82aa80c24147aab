"""A result takes the place of an earlier one as a whole; a folder with files of others is refused."""

import errno
import os
import shutil
import signal
import threading

import pytest
from helpers.unfinished import make, unfinished

from mitsvbrdf.errors import OutputError
from mitsvbrdf.io import files, manifest, results
from mitsvbrdf.relight import frames

EXPORT, RELIGHT = ("gltf/export.json", "gltf/material.glb", "preview.png"), ("relight.json", "sphere.png")


def there(out):
    names = [str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()]
    return sorted(name for name in names if not name.endswith(results.MANIFEST))


@pytest.fixture
def out(tmp_path):
    """A fit with a look, exported and relit."""
    out = tmp_path / "out"
    make(out, "fit.json", "maps/a.exr", "look/a.exr", text="old")
    make(out / "export", *EXPORT)
    make(out / "relight", *RELIGHT)
    make(out / "look/relight", *RELIGHT)
    return out


@pytest.fixture(params=["exchange", "renames"])
def either_way(request, monkeypatch):
    """Where the system exchanges folders in one step, and where it cannot."""
    if request.param == "renames":
        monkeypatch.setattr(files.ctypes, "CDLL", lambda *_, **__: object())


def test_a_new_result_appears_whole_and_nothing_lies_beside_it(tmp_path):
    make(tmp_path / "a/out", "one", "two/three")
    assert os.listdir(tmp_path / "a") == ["out"] and there(tmp_path / "a/out") == ["one", "two/three"]
    (tmp_path / "empty").mkdir()
    make(tmp_path / "empty", "one")
    assert there(tmp_path / "empty") == ["one"]


def test_a_result_and_what_was_made_of_it_go_as_a_whole(out, either_way, capsys):
    (out).chmod(0o750)
    make(out, "fit.json", "maps/b.exr", overwrite=True)
    assert there(out) == ["fit.json", "maps/b.exr"] and os.listdir(out.parent) == ["out"]
    assert out.stat().st_mode & 0o777 == 0o750
    said = " ".join(capsys.readouterr().out.split())
    assert "removed, as made of the earlier result: export, look/relight, relight" in said


def test_a_failing_block_leaves_the_old_result_alone(out):
    before = there(out)
    with pytest.raises(ZeroDivisionError), results.output_folder(out, overwrite=True) as folder:
        files.write_bytes(folder / "fit.json", b"newer")
        raise ZeroDivisionError
    assert there(out) == before and os.listdir(out.parent) == ["out"]
    with pytest.raises(ZeroDivisionError), results.output_folder(out.parent / "new", overwrite=True):
        raise ZeroDivisionError
    assert os.listdir(out.parent) == ["out"]


@pytest.mark.parametrize("name", ["thesis.txt", "maps/mine.psd", "export/gltf/mine.txt", "deep/a/b"])
def test_a_folder_with_files_of_others_is_refused_and_they_are_named(name, out):
    files.write_bytes(out / name, b"mine")
    before = there(out)
    with pytest.raises(OutputError, match=f"with {name}; move"):
        make(out, "fit.json", overwrite=True)
    with pytest.raises(OutputError, match=name):
        results.check_free(out, overwrite=True)
    assert there(out) == before and os.listdir(out.parent) == ["out"]


def test_a_file_of_others_that_comes_during_the_work_is_not_lost(out):
    with pytest.raises(OutputError, match="with notes.txt; move"):
        with results.output_folder(out, overwrite=True) as folder:
            files.write_bytes(folder / results.CHECKPOINT, b"state")
            files.write_bytes(out / "notes.txt", b"mine")
    assert (out / "notes.txt").read_bytes() == b"mine"
    assert there(results.partial_folder(out)) == [results.CHECKPOINT]


def test_results_of_another_kind_and_of_ones_own_maps_are_files_of_others(tmp_path):
    make(tmp_path / "fit", "fit.json")
    make(tmp_path / "fit/export", "fit.json", "maps/a.exr")
    files.write_bytes(tmp_path / "maps/diffuse.png", b"mine")
    make(tmp_path / "maps/relight", *RELIGHT)
    for name in ("fit", "maps"):
        with pytest.raises(OutputError, match="move them away"):
            make(tmp_path / name, "fit.json", overwrite=True)


def test_what_killed_commands_left_in_a_result_is_no_file_of_others(out):
    unfinished(out / "relight", "relight.json", "sweep/0000.exr")
    files.write_bytes(out / ".export.lock", b"")
    make(out, "fit.json", overwrite=True)
    assert there(out) == ["fit.json"]


@pytest.mark.parametrize("options", [{"overwrite": True}, {"add": True}])
def test_a_command_at_work_inside_is_not_disturbed(out, options):
    for place in ("relight", "look/export"):  # again, and for the first time
        with results.output_folder(out / place, overwrite=True):
            with pytest.raises(OutputError, match=f"{place}, in use"):
                make(out, "new", **options)


def test_files_that_are_added_take_nothing_away(out, either_way, capsys):
    files.write_bytes(out / "notes/mine.txt", b"mine")
    (out / "notes/link").symlink_to("nowhere")
    before, inode = there(out), (out / "fit.json").stat().st_ino
    for text in ("first", "second"):
        make(out, "report.html", "photos/0.png", text=text, add=True)
        assert there(out) == sorted([*before, "report.html", "photos/0.png"])
        assert (out / "report.html").read_text() == text
    assert os.listdir(out.parent) == ["out"] and not capsys.readouterr().out
    assert (out / "fit.json").stat().st_ino == inode and (out / "notes/link").is_symlink()
    assert {"report.html",
            "fit.json"} < set(results.own_files(out)) and "notes/mine.txt" not in results.own_files(out)
    (out / "notes/mine.txt").unlink()
    (out / "notes/link").unlink()
    make(out, "fit.json", overwrite=True)


@pytest.mark.parametrize("in_the_way", ["report.html", "photos", "photos/0.png/deep"])
def test_files_that_are_added_replace_none_of_others(out, in_the_way):
    files.write_bytes(out / in_the_way, b"mine")
    before = there(out)
    with pytest.raises(OutputError, match="room for new files"):
        make(out, "report.html", "photos/0.png", add=True)
    assert there(out) == before and (out / in_the_way).read_bytes() == b"mine"


def test_files_are_added_on_a_disk_without_hard_links(out, monkeypatch):
    def no_links(*_, **__):
        raise OSError(errno.EPERM, "no links")

    monkeypatch.setattr(os, "link", no_links)
    before = there(out)
    make(out, "report.html", add=True)
    assert there(out) == sorted([*before, "report.html"])


def test_a_result_that_cannot_be_exchanged_leaves_the_old_one_and_the_checkpoint(out, monkeypatch):
    def busy(*_):
        raise OSError(errno.EBUSY, "Device or resource busy")

    before = there(out)
    monkeypatch.setattr(results.files, "exchange", busy)
    with pytest.raises(OutputError, match="busy; choose a folder inside of it"):
        make(out, "fit.json", results.CHECKPOINT, overwrite=True)
    assert there(out) == before
    assert there(results.partial_folder(out)) == [results.CHECKPOINT]
    monkeypatch.undo()
    with results.output_folder(out, True, resume=True) as folder:
        assert (folder / results.CHECKPOINT).read_text() == "new"


def test_renames_that_fail_are_undone(out, monkeypatch):
    before, rename = there(out), os.rename

    def failing(source, target):
        if str(source).endswith(".partial"):
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        rename(source, target)

    monkeypatch.setattr(files.ctypes, "CDLL", lambda *_, **__: object())
    monkeypatch.setattr(os, "rename", failing)
    with pytest.raises(OutputError, match="cross-device"):
        make(out, "fit.json", overwrite=True)
    assert there(out) == before and os.listdir(out.parent) == ["out"]


def test_mount_points_and_the_current_folder_are_refused_before_the_work(out, monkeypatch):
    monkeypatch.chdir(out / "maps")
    for place in ("..", ".", out):
        with pytest.raises(OutputError, match="type cd .."):
            results.check_free(results.Path(place), overwrite=True)
    if os.path.ismount("/proc"):
        with pytest.raises(OutputError, match="a mount point; choose a new folder in it"):
            results.check_free(results.Path("/proc"), overwrite=True)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_putting_results_in_place_is_not_interrupted(number, tmp_path, monkeypatch):
    came, rename = [], os.rename

    def interrupted(source, target):
        os.kill(os.getpid(), number)
        rename(source, target)

    before = signal.signal(number, lambda *_: came.append(os.listdir(tmp_path / "out")))
    try:
        with results.output_folder(tmp_path / "out", overwrite=False) as folder:
            files.write_bytes(folder / "one", b"new")
            monkeypatch.setattr(os, "rename", interrupted)
        assert there(tmp_path / "out") == ["one"]
        assert [sorted(names) for names in came] == [[results.MANIFEST, "one"]]  # all in place
    finally:
        signal.signal(number, before)


def test_two_runs_do_not_share_a_folder(tmp_path):
    with results.output_folder(tmp_path / "out", overwrite=False):
        with pytest.raises(OutputError, match="in use by another run"):
            make(tmp_path / "out", "one")
    with files.file_lock(tmp_path / "out"):
        with pytest.raises(OutputError, match="in use by another run"):
            results.check_free(tmp_path / "out", overwrite=True)


def test_looking_at_the_lock_does_not_refuse_a_run(tmp_path):
    look = files.file_lock(tmp_path / "out")
    held, ended = threading.Event(), threading.Event()

    def a_look():  # that takes longer than any does
        with look:
            held.set()
            ended.wait(0.01)

    thread = threading.Thread(target=a_look)
    thread.start()
    held.wait()
    make(tmp_path / "out", "one")
    thread.join()


def test_an_unfinished_run_is_kept_and_gone_on_from(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(ZeroDivisionError), results.output_folder(out, overwrite=False) as folder:
        files.write_bytes(folder / results.CHECKPOINT, b"state")
        files.write_bytes(folder / "maps/half.exr", b"half")
        raise ZeroDivisionError
    assert there(results.partial_folder(out)) == [results.CHECKPOINT] and not out.exists()
    with pytest.raises(OutputError, match="no unfinished run"):
        make(out, "one")
    assert results.checkpoints(out) == [results.partial_folder(out) / results.CHECKPOINT]
    make(out, "report.html", add=True)  # is no matter of the unfinished run
    with results.output_folder(out, True, resume=True) as folder:
        assert there(folder) == [results.CHECKPOINT]
    assert there(out) == [results.CHECKPOINT] and results.checkpoints(out) == [out / results.CHECKPOINT]


@pytest.mark.parametrize("left, keep", [("relight.json", (results.CHECKPOINT,)),
                                        (results.CHECKPOINT, ("relight.json", "sweep"))])
def test_an_unfinished_run_of_another_command_is_not_lost(tmp_path, left, keep):
    partial = unfinished(tmp_path / "out", left)
    for resume in (False, True):
        with pytest.raises(OutputError, match="no unfinished run"):
            make(tmp_path / "out", "one", keep=keep, resume=resume)
    assert there(partial) == [left]
    make(tmp_path / "out", "one", keep=keep, overwrite=True)
    assert there(tmp_path / "out") == ["one"] and not partial.exists()


def test_an_earlier_result_that_a_kill_left_is_no_unfinished_run(tmp_path):
    out, partial = tmp_path / "out", results.partial_folder(tmp_path / "out")
    make(out, results.CHECKPOINT, text="old", overwrite=True)
    shutil.copytree(out, tmp_path / "copy")
    make(out, results.CHECKPOINT, text="new", overwrite=True)
    (tmp_path / "copy").rename(partial)
    assert results.checkpoints(out) == [out / results.CHECKPOINT]
    with results.output_folder(out, True, resume=True) as folder:
        assert not there(folder)


def test_a_link_to_a_folder_stays_a_link(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to("disk")
    make(tmp_path / "out", "one")
    make(tmp_path / "out", "two", overwrite=True)
    assert (tmp_path / "out").is_symlink() and there(tmp_path / "disk") == ["two"]
    assert sorted(os.listdir(tmp_path)) == ["disk", "out"]


def test_a_manifest_of_an_earlier_version_is_understood(tmp_path):
    make(tmp_path / "out", "one")
    (tmp_path / "out" / results.MANIFEST).write_text('["one"]')
    make(tmp_path / "out", "two", overwrite=True)
    assert there(tmp_path / "out") == ["two"]


def test_relight_is_known_by_its_record():
    assert manifest.DERIVED["relight"] == frames.RECORD  # tests/export/test_command.py has the same of export
