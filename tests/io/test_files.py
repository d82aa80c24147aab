"""Files are replaced whole or not at all; locks keep processes apart; names lead nowhere else."""

import errno
import multiprocessing
import os
from pathlib import Path

import pytest
import torch

from mitsvbrdf.errors import OutputError
from mitsvbrdf.io import files, images


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


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


def count_up(path):
    for _ in range(60):
        with files.file_lock(path):
            files.write_bytes(path, str(int(path.read_text()) + 1).encode())


def test_a_locked_file_is_changed_by_one_process_at_a_time(tmp_path):
    path = tmp_path / "n"
    path.write_text("0")
    several = [multiprocessing.get_context("fork").Process(target=count_up, args=(path,)) for _ in range(3)]
    for each in several:
        each.start()
    for each in several:
        each.join()
    assert path.read_text() == "180" and names_in(tmp_path) == ["n"]


def test_a_lock_is_seen_and_waited_for_no_longer_than_asked(tmp_path):
    path = tmp_path / "out"
    assert not files.in_use(path)
    with files.file_lock(path):
        assert files.in_use(path)
        with pytest.raises(OutputError, match="out"), files.file_lock(path, 0):
            pass
    assert not files.in_use(path) and not names_in(tmp_path)


@pytest.mark.parametrize("name", ["..", "../a", "a/../../b", "/etc/passwd", "", ".", "a\0b", "link/a",
                                  "link"])
def test_names_that_lead_out_of_a_folder(tmp_path, name):
    (tmp_path / "link").symlink_to("/")
    assert files.inside(tmp_path, name) is None


def test_names_inside_a_folder(tmp_path):
    for name in ("a", "a/b", "a//b", "./a", "...", "a..b"):
        assert str(files.inside(tmp_path, name)).startswith(f"{tmp_path}/")


def test_only_regular_files_are_opened(tmp_path):
    (tmp_path / "file").write_text("x")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("file")
    for path in (tmp_path / "pipe", tmp_path / "link", tmp_path, os.devnull):
        with pytest.raises(OSError):
            files.open_regular(path)
    with files.open_regular(tmp_path / "file") as file:
        assert file.read() == b"x"
    with pytest.raises(OSError, match="no regular file"):
        files.file_hash(tmp_path / "pipe")


def test_a_current_folder_that_was_deleted_is_said(tmp_path, monkeypatch):
    (gone := tmp_path / "gone").mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    with pytest.raises(OutputError, match="a current folder .* deleted"):
        files.write_json(Path("result.json"), {})
    files.write_json(tmp_path / "result.json", {})
