"""Links, pipes, names that lead elsewhere and files of other users in a result folder: refused, and nothing
outside changes.
"""

import json
import os

import pytest

from mitsvbrdf.errors import OutputError
from mitsvbrdf.io import files, result_folder
from mitsvbrdf.io.journal import JOURNAL


@pytest.fixture
def outside(tmp_path):
    """A folder of somebody else; in the end all in it is as it was."""
    folder = tmp_path / "outside"
    (folder / "maps").mkdir(parents=True)
    for name in ("maps/a.exr", "a.exr", "report.html", "list"):
        (folder / name).write_text("theirs")
    yield folder
    assert {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*")
            if path.is_file()} == dict.fromkeys(
        ("maps/a.exr", "a.exr", "report.html", "list"), "theirs")


@pytest.fixture
def out(tmp_path):
    """A result of an earlier command."""
    make(tmp_path / "out", "old", "maps/a.exr", "report.html")
    return tmp_path / "out"


def make(out, text, *names, **options):
    with result_folder.output_folder(out, **({"overwrite": False} | options)) as folder:
        for name in names:
            files.write_bytes(folder / name, text.encode())


def put(path, what, outside):
    """Something in place of a file or a folder."""
    path.parent.mkdir(exist_ok=True)
    if what == "pipe":
        os.mkfifo(path)
    elif what == "nowhere":
        path.symlink_to(outside / "new")
    else:
        path.symlink_to(outside / {"folder": "maps", "file": "list"}[what])


@pytest.mark.parametrize("options", [{}, {"overwrite": True}, {"overwrite": True, "resume": True},
                                     {"add": True}])
@pytest.mark.parametrize("name, what", [
    (".partial", "folder"), (".partial", "nowhere"), *(
        (f".partial/{name}", what) for name in (result_folder.LOCK, result_folder.CHECKPOINT, JOURNAL, "maps")
        for what in ("file", "pipe", "nowhere", "folder"))])
def test_links_and_pipes_where_a_result_is_made_are_refused(out, outside, name, what, options):
    put(out / name, what, outside)
    with pytest.raises(OutputError):
        make(out, "new", "maps/a.exr", **options)
    assert os.path.lexists(out / name) and (out / "maps/a.exr").read_text() == "old"
    assert not result_folder.in_use(out)


@pytest.mark.parametrize("name", ["maps", "maps/a.exr", "report.html", result_folder.MANIFEST])
@pytest.mark.parametrize("what", ["folder", "file", "pipe", "nowhere"])
@pytest.mark.parametrize("options", [{"overwrite": True}, {"add": True}])
def test_links_and_pipes_where_a_result_goes_are_somebody_elses(out, outside, name, what, options):
    place = out / name
    files.remove(place)
    put(place, what, outside)
    make(out, "new", "maps/a.exr", "report.html", **options)
    for each in ("maps/a.exr", "report.html"):
        assert (out / each).read_text() == "new" and (out / each).resolve() == out / each
    assert files.is_regular(out / result_folder.MANIFEST)
    aside = place.with_name(f"{place.name}.old")
    assert aside.is_symlink() or aside.is_fifo()  # out of the way, not lost


@pytest.mark.parametrize("manifest", [
    ["../outside/a.exr"], ["maps/a.exr"], ["maps/../../outside/a.exr"], ["{outside}/a.exr"],
    ["..", ".", "", "a\0b", "\ud800"],
    ["linked/a.exr", 1, None, ["a"]], {"maps/a.exr": 1}, "maps/a.exr", 5, [".partial/.lock"],
    ["deep/maps/a.exr"]])
def test_a_manifest_deletes_nothing_outside(tmp_path, outside, manifest):
    out = tmp_path / "out"
    (out / "deep").mkdir(parents=True)
    for name in ("maps", "linked", "deep/maps"):
        (out / name).symlink_to(outside / "maps" if name != "linked" else outside)
    (out / result_folder.MANIFEST).write_text(json.dumps(manifest).replace("{outside}", str(outside)))
    make(out, "new", "one", overwrite=True)
    assert (out / "one").read_text() == "new" and all((out / name).is_symlink() for name in ("maps", "linked",
                                                                                             "deep/maps"))


def test_a_manifest_nested_without_end_is_none(out):
    (out / result_folder.MANIFEST).write_text("[" * 100_000)
    make(out, "new", "one", overwrite=True)
    assert (out / "maps/a.exr").read_text() == "old" and (out / "one").read_text() == "new"


@pytest.mark.parametrize("journal", [
    {"new": ["../outside/a.exr"]}, {"earlier": ["../outside/a.exr"]}, {"new": ["{outside}/a.exr"]},
    {"new": [".partial/.lock"]},
    {"staged": ".."}, {"staged": "{outside}"}, {"staged": "linked"}, {"new": ["linked/a.exr"]}, {"new": 5},
    {"new": [5]}, {"earlier": {}}, [], 5, None, "x"])
def test_a_journal_moves_nothing_from_or_to_outside(out, outside, journal):
    partial = result_folder.partial_folder(out)
    partial.mkdir()
    text = json.dumps({"staged": "", "earlier": [], "new": []} | journal if isinstance(journal, dict)
                      else journal)
    (partial / JOURNAL).write_text(text.replace("{outside}", str(outside)))
    if journal == {"new": ["linked/a.exr"]}:
        (partial / "linked").symlink_to(outside)
    if journal == {"earlier": {}}:  # as good as a list of none
        return result_folder.settle(out)
    for read in (lambda: result_folder.settle(out), lambda: make(out, "new", "one", overwrite=True)):
        with pytest.raises(OutputError):
            read()
    assert (out / "maps/a.exr").read_text() == "old" and (partial / JOURNAL).exists()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files away")
@pytest.mark.parametrize("name", [".partial", ".partial/checkpoint.safetensors", ".partial/.journal",
                                  ".partial/maps/a.exr"])
def test_files_of_another_user_are_not_gone_on_with(out, name):
    files.write_bytes(result_folder.partial_folder(out) / "maps/a.exr", b"half")
    (out / name).touch()
    os.chown(out / name, 12345, 12345)
    for options in ({"overwrite": True}, {"overwrite": True, "resume": True}, {"add": True}):
        with pytest.raises(OutputError, match="of user 12345"):
            make(out, "new", "maps/a.exr", **options)
    assert (out / "maps/a.exr").read_text() == "old"
    os.chown(out, 12345, 12345)  # whose folder it is may go on in it, and so may we
    (out / ".partial/.journal").unlink(missing_ok=True)
    make(out, "new", "maps/a.exr", overwrite=True)
    assert (out / "maps/a.exr").read_text() == "new"


def test_what_the_user_names_may_be_a_link(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to("disk")
    make(tmp_path / "out", "new", "maps/a.exr")
    make(tmp_path / "out", "newer", "maps/a.exr", overwrite=True)
    assert (tmp_path / "disk/maps/a.exr").read_text() == "newer"


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
