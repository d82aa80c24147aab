"""Links, pipes, names that lead elsewhere and files of others in a result folder change nothing outside."""

import json
import os

import pytest
from helpers.unfinished import make, unfinished

from mitsvbrdf.errors import OutputError
from mitsvbrdf.io import files, results


@pytest.fixture
def outside(tmp_path):
    """A folder of somebody else; in the end all in it is as it was."""
    folder = tmp_path / "outside"
    (folder / "maps").mkdir(parents=True)
    for name in ("maps/a.exr", "a.exr", "report.html", "list"):
        (folder / name).write_text("theirs")
    yield folder
    assert {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*")
            if path.is_file()} == dict.fromkeys(("maps/a.exr", "a.exr", "report.html", "list"), "theirs")


@pytest.fixture
def out(tmp_path):
    """A result of an earlier command."""
    make(tmp_path / "out", "maps/a.exr", "report.html", text="old")
    return tmp_path / "out"


def put(path, what, outside):
    """Something in place of a file or a folder."""
    files.remove(path)
    path.parent.mkdir(exist_ok=True)
    if what == "pipe":
        os.mkfifo(path)
    elif what == "nowhere":
        path.symlink_to(outside / "new")
    else:
        path.symlink_to(outside / {"folder": "maps", "file": "list"}[what])


@pytest.mark.parametrize("name", ["out.partial", f"out.partial/{results.CHECKPOINT}", ".out.lock"])
@pytest.mark.parametrize("what", ["file", "pipe", "nowhere", "folder"])
def test_links_and_pipes_where_a_result_is_made_are_not_followed(out, outside, name, what):
    unfinished(out, "maps/half.exr")
    put(out.parent / name, what, outside)
    with pytest.raises(OutputError):
        make(out, "maps/a.exr", overwrite=True, resume=True)
    assert os.path.lexists(out.parent / name) and (out / "maps/a.exr").read_text() == "old"


def test_a_folder_of_others_with_the_name_of_an_unfinished_run_is_refused(out):
    files.write_bytes(out.parent / "out.partial/thesis.txt", b"mine")
    for options in ({}, {"resume": True}):
        with pytest.raises(OutputError, match=r"run of mitsvbrdf, or nothing, at .*out\.partial"):
            make(out, "maps/a.exr", overwrite=True, **options)
    assert (out.parent / "out.partial/thesis.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["maps", "maps/a.exr", "report.html", results.MANIFEST])
@pytest.mark.parametrize("what", ["folder", "file", "pipe", "nowhere"])
@pytest.mark.parametrize("options", [{"overwrite": True}, {"add": True}])
def test_links_and_pipes_where_a_result_goes_are_somebody_elses(out, outside, name, what, options):
    put(out / name, what, outside)
    with pytest.raises(OutputError):
        make(out, "maps/a.exr", "report.html", **options)
    assert (out / name).is_symlink() or (out / name).is_fifo()


@pytest.mark.parametrize("manifest", [["../outside/a.exr"], ["maps/a.exr"], ["maps/../../outside/a.exr"],
                          ["{outside}/a.exr"], ["..", ".", "", "a\0b", "\ud800"],
                          ["linked/a.exr", 1, None, ["a"]], {"maps/a.exr": 1}, "maps/a.exr", 5, {"files": 5},
                          {"files": {"maps/a.exr": 1}, "serial": "x"},
                          {"files": ["maps", "linked", "deep/maps/a.exr"]}])
def test_a_manifest_deletes_nothing_outside(tmp_path, outside, manifest):
    out = tmp_path / "out"
    (out / "deep").mkdir(parents=True)
    for name in ("maps", "linked", "deep/maps"):
        (out / name).symlink_to(outside / "maps" if name != "linked" else outside)
    (out / results.MANIFEST).write_text(json.dumps(manifest).replace("{outside}", str(outside)))
    with pytest.raises(OutputError, match="with deep/maps, linked, maps; move"):
        make(out, "one", overwrite=True)
    make(out, "one", add=True)
    assert all((out / name).is_symlink() for name in ("maps", "linked", "deep/maps"))


def test_a_manifest_nested_without_end_is_none(out):
    (out / results.MANIFEST).write_text("[" * 100_000)
    with pytest.raises(OutputError, match="with maps/a.exr, report.html; move"):
        make(out, "one", overwrite=True)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files away")
@pytest.mark.parametrize("name", ["", results.CHECKPOINT])
def test_files_of_another_user_are_not_gone_on_with(out, name):
    partial = unfinished(out, results.CHECKPOINT)
    os.chown(partial / name, 12345, 12345)
    with pytest.raises(OutputError, match="of user 12345"):
        make(out, "maps/a.exr", overwrite=True, resume=True)
    assert (out / "maps/a.exr").read_text() == "old"
    os.chown(out, 12345, 12345)  # whose folder it is may go on in it, and so may we
    make(out, "maps/a.exr", overwrite=True, resume=True)
    assert (out / "maps/a.exr").read_text() == "new"
