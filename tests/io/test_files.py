"""Files are replaced whole or not at all, and nothing that is not ours is touched."""

import errno
import os
import shutil
import signal
from pathlib import Path

import pytest
import torch

from mitsvbrdf.errors import OutputError
from mitsvbrdf.io import files, images, result_folder


def make(out, names, **options):
    with result_folder.output_folder(out, **({"overwrite": True} | options)) as folder:
        for name in names:
            files.write_bytes(folder / name, b"new")


def names_in(folder):
    return sorted(p.name for p in folder.iterdir() if p.name not in (result_folder.MANIFEST, '.partial'))


def test_a_new_folder_appears_whole(tmp_path):
    make(tmp_path / "a/out", ["one", "two/three"])
    assert names_in(tmp_path / "a") == ["out"] and names_in(tmp_path / "a/out") == ["one", "two"]


def test_a_failing_block_leaves_nothing_behind_and_the_old_results_alone(tmp_path):
    make(tmp_path / "out", ["one"])
    with pytest.raises(ZeroDivisionError), result_folder.output_folder(tmp_path / "out",
                                                                       overwrite=True) as folder:
        files.write_bytes(folder / "one", b"newer")
        raise ZeroDivisionError
    assert names_in(tmp_path) == ["out"] and (tmp_path / "out/one").read_bytes() == b"new"


def test_overwriting_replaces_earlier_results_only(tmp_path):
    out = tmp_path / "out"
    make(out, ["00.png", "01.png"])
    (out / "thesis.txt").write_text("mine")
    make(out, ["00.png"])
    assert names_in(out) == ["00.png", "thesis.txt"] and (out / "thesis.txt").read_text() == "mine"


def test_results_are_not_replaced_unasked(tmp_path):
    make(tmp_path / "out", ["one"])
    with pytest.raises(OutputError, match="--overwrite"):
        make(tmp_path / "out", ["two"], overwrite=False)
    assert names_in(tmp_path) == ["out"] and names_in(tmp_path / "out") == ["one"]


def test_overwriting_never_loses_a_file_of_somebody_else(tmp_path):
    out = tmp_path / "out"
    (out / "maps").mkdir(parents=True)
    (out / "maps/mine.psd").write_text("mine")
    (out / "one").write_text("mine")
    make(out, ["one", "maps/two"])
    assert (out / "maps/mine.psd").read_text() == "mine" and (out / "one.old").read_text() == "mine"
    make(out, ["three"])
    assert names_in(out) == ["maps", "one.old", "three"] and names_in(out / "maps") == ["mine.psd"]


@pytest.mark.parametrize("failing", range(1, 9))  # the journal, three files that go, four that come
def test_moving_into_place_is_undone_when_it_fails(tmp_path, monkeypatch, failing):
    out = tmp_path / "out"
    make(out, ["one", "two"])
    replace, calls = os.replace, iter(range(1, 100))

    def failing_once(source, target):
        if next(calls) == failing:
            raise OSError(18, "Invalid cross-device link")
        replace(source, target)

    with pytest.raises(OutputError, match="cross-device"), result_folder.output_folder(out,
                                                                                       overwrite=True) as folder:
        for name in ("one", "two", "three"):
            (folder / name).write_bytes(b"newer")
        monkeypatch.setattr(os, "replace", failing_once)
    monkeypatch.undo()
    assert names_in(out) == ["one",
                             "two"] and (out / "one").read_bytes() == (out / "two").read_bytes() == b"new"
    assert not result_folder.partial_folder(out).exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_putting_results_in_place_is_not_interrupted(number, tmp_path, monkeypatch):
    came, replace = [], os.replace

    def interrupted(source, target):
        os.kill(os.getpid(), number)
        replace(source, target)

    before = signal.signal(number, lambda *_: came.append(os.listdir(tmp_path / "out/.partial")))
    try:
        with result_folder.output_folder(tmp_path / "out", overwrite=False) as folder:
            files.write_bytes(folder / "one", b"new")
            monkeypatch.setattr(os, "replace", interrupted)
        assert names_in(tmp_path / "out") == ["one"]
        assert came == [[result_folder.LOCK]]  # heard, once all was in place
    finally:
        signal.signal(number, before)


def test_two_runs_do_not_share_a_folder(tmp_path):
    with result_folder.output_folder(tmp_path / "out", overwrite=False):
        with pytest.raises(OutputError, match="in use"):
            make(tmp_path / "out", ["one"])


@pytest.mark.parametrize("kept", [False, True])
def test_a_folder_is_in_use_until_it_is_cleaned_up(kept, tmp_path, monkeypatch):
    pytest.importorskip("fcntl")
    out, busy = tmp_path / "out", []

    def watched(clean):
        return lambda *arguments, **options: (busy.append(result_folder.in_use(out)),
                                              clean(*arguments, **options))

    with pytest.raises(ZeroDivisionError), result_folder.output_folder(out, overwrite=False) as folder:
        if kept:
            files.write_bytes(folder / result_folder.CHECKPOINT, b"state")
        monkeypatch.setattr(shutil, "rmtree", watched(shutil.rmtree))
        monkeypatch.setattr(result_folder, "_empty", watched(result_folder._empty))
        raise ZeroDivisionError
    assert busy == [True] and not result_folder.in_use(out)


def test_a_lock_that_the_last_run_took_away_locks_nothing(tmp_path, monkeypatch):
    # Opened while that run was there, locked after it removed the file: a third run would find another one.
    fcntl = pytest.importorskip("fcntl")
    out, flock = tmp_path / "out", fcntl.flock

    def late(lock, how):
        (result_folder.partial_folder(out) / result_folder.LOCK).unlink()
        flock(lock, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with pytest.raises(OutputError, match="in use"), result_folder.output_folder(out, overwrite=False):
        pass


def test_a_link_to_a_folder_stays_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "out").symlink_to("real")
    make(tmp_path / "out", ["one"])
    assert (tmp_path / "out").is_symlink() and names_in(tmp_path / "real") == ["one"]


def test_an_unfinished_run_with_a_checkpoint_is_kept(tmp_path):
    with pytest.raises(ZeroDivisionError), result_folder.output_folder(tmp_path / "out",
                                                                       overwrite=False) as folder:
        files.write_bytes(folder / "checkpoint.safetensors", b"state")
        raise ZeroDivisionError
    assert names_in(result_folder.partial_folder(tmp_path / "out")) == ["checkpoint.safetensors"]


def test_a_link_to_a_file_stays_a_link(tmp_path):
    for name, target in (("there", "real/there.json"), ("missing", "real/missing.json")):
        (tmp_path / "real").mkdir(exist_ok=True)
        (tmp_path / name).symlink_to(target)
        files.write_bytes(tmp_path / name, b"old")
        files.write_bytes(tmp_path / name, b"new")
        assert (tmp_path / name).is_symlink() and (tmp_path / target).read_bytes() == b"new"
    assert names_in(tmp_path / "real") == ["missing.json", "there.json"]


def test_only_files_are_replaced(tmp_path):
    # A pipe stands for all devices: a rename would put a file in its place.
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "link", "loop", "folder"):
        for write in (files.check_output, lambda path: files.write_bytes(path, b"new")):
            with pytest.raises(OutputError, match="a file to write"):
                write(tmp_path / name)
    assert (tmp_path / "pipe").is_fifo() and names_in(tmp_path) == ["folder", "link", "loop", "pipe"]


def test_what_cannot_be_written_is_known_before(tmp_path):
    (tmp_path / "file").write_text("mine")
    bad = [tmp_path / "file/record.json", tmp_path / ("n" * 300), tmp_path / ("n" * 250)]
    bad += [path for path in (Path("/proc/record.json"), Path("/proc/new/record.json"))
            if path.parents[-2].is_dir()]
    for path in bad:
        with pytest.raises(OutputError, match=path.name):
            files.check_output(None, path)
        with pytest.raises(OutputError, match=path.name):  # the check says what writing would have said
            files.write_bytes(path, b"new")
    files.check_output(None, tmp_path / "file", tmp_path / "a/b/new.json")
    assert names_in(tmp_path) == ["file"] and (tmp_path / "file").read_text() == "mine"


def test_a_write_that_fails_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "image.exr"
    images.write_exr(path, torch.zeros(4, 4, 3))
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match="No space left"):
        images.write_exr(path, torch.ones(4, 4, 3))
    assert path.read_bytes() == before and names_in(tmp_path) == ["image.exr"]


@pytest.mark.parametrize("channels", [1, 3])
def test_exr_holds_every_bit_of_float32(tmp_path, channels):
    image = torch.randn(5, 7, channels) * 1e4
    images.write_exr(tmp_path / "a.exr", image)
    assert torch.equal(images.read_image(tmp_path / "a.exr", ValueError), image)


@pytest.mark.parametrize("number, way_out", [(errno.EACCES, "check your rights"),
                                             (errno.EROFS, "check your rights"),
                                             (errno.ENOSPC, "free space")])
def test_what_cannot_be_written_is_told_with_the_way_out_that_helps(tmp_path, monkeypatch, number, way_out):
    def refused(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(files.os, "replace", refused)
    with pytest.raises(OutputError, match=f"{os.strerror(number)}; {way_out}"):
        files.write_bytes(tmp_path / "library.json", b"{}")
