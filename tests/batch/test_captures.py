"""Which captures the words of a command line and the lines of a list stand for."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

import pytest

from mitsvbrdf.batch import captures as captures_module
from mitsvbrdf.batch.captures import Entry, Mistakes, captures, local_capture, name_of
from mitsvbrdf.errors import CaptureError, ConfigError, MitsvbrdfError


@pytest.fixture
def shots(tmp_path, monkeypatch):
    """Four captures in shots/, beside what is none; the test is in the folder above."""
    monkeypatch.chdir(tmp_path)
    for name, file in (("wood", "00.png"), ("brick", "IMG_1.JPG"), ("a b", "capture.json"),
                       ("text", "camera_pos.txt")):
        (tmp_path / "shots" / name).mkdir(parents=True)
        (tmp_path / "shots" / name / file).touch()
    for name in ("empty", ".hidden", "fit"):
        (tmp_path / "shots" / name).mkdir()
    (tmp_path / "shots/.hidden/00.png").touch()
    (tmp_path / "shots/empty/._00.png").touch()  # what some systems leave beside a photo
    (tmp_path / "shots/fit/fit.json").touch()  # a result, with its preview
    (tmp_path / "shots/fit/preview.jpg").touch()
    return Path(os.path.realpath(tmp_path / "shots"))


def entries(names):
    """The captures that names stand for; mistakes are raised."""
    mistakes = Mistakes()
    found = captures(names, mistakes)
    mistakes.tell()
    return found


def found(*names):
    """The folders' names and options."""
    return [(os.path.basename(entry.source), *entry.own) for entry in entries(names)]


def write_list(text, name="list.txt"):
    Path(name).write_text(text)
    return name


def test_a_capture_is_its_absolute_path(shots):
    assert entries(["shots/wood"]) == [Entry(str(shots / "wood"))]


def test_a_folder_of_captures_is_those_right_inside_by_name(shots):
    assert found("shots") == [("a b",), ("brick",), ("text",), ("wood",)]


def test_names_stand_in_the_order_of_the_command_line(shots):
    assert found("shots/wood", "shots/brick") == [("wood",), ("brick",)]


def test_a_json_file_is_a_capture_by_itself(shots):
    (shots / "a b/Some.JSON").touch()
    assert [entry.source for entry in entries(["shots/a b/capture.json", "shots/a b/Some.JSON"])] == [
        str(shots / "a b/capture.json"), str(shots / "a b/Some.JSON")]


def test_a_pattern_is_what_matches_it_by_name(shots):
    assert found("shots/[wb]*") == [("brick",), ("wood",)]


def test_a_pattern_passes_over_json_files_unless_it_asks_for_them(shots):
    Path("shots/wood-notes.json").touch()
    assert found("shots/wo*") == [("wood",)]
    assert found("shots/*/capture.json") == [("capture.json",)]


def test_a_folder_whose_name_looks_like_a_pattern_is_that_folder(shots):
    (shots / "wo[o]d").mkdir()
    (shots / "wo[o]d/00.png").touch()
    assert found("shots/wo[o]d") == [("wo[o]d",)]


def test_a_link_is_what_it_points_to(shots):
    Path("link").symlink_to("shots/wood")
    assert found("link") == [("wood",)]


def test_a_list_has_a_capture_and_its_own_options_a_line(shots):
    write_list("""# what there is
        wood --seed 3 --tag "old wood"

        'a b'    # a remark with ' in it
        brick#1 --fix diffuse=red
        [wt]* --seed 4
    """, "shots/list.txt")
    (shots / "brick#1").mkdir()
    (shots / "brick#1/00.png").touch()
    assert found("shots/list.txt") == [("wood", "--seed", "3", "--tag", "old wood"), ("a b",),
                                       ("brick#1", "--fix", "diffuse=red"), ("text", "--seed", "4"),
                                       ("wood", "--seed", "4")]
    assert entries(["shots/list.txt"])[1].where == "line 4 of shots/list.txt"


def test_an_absolute_path_in_a_list_is_itself(shots):
    assert found(write_list(f"{shots}/wood\n")) == [("wood",)]


def test_a_list_may_begin_with_the_mark_of_some_editors(shots):
    Path("list.txt").write_bytes(b"\xef\xbb\xbfshots/wood\r\nshots/brick\r\n")
    assert found("list.txt") == [("wood",), ("brick",)]


def test_a_dash_is_a_list_on_standard_input(shots, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"shots/wood --seed 1\n")))
    assert entries(["-"]) == [Entry(str(shots / "wood"), ("--seed", "1"), "line 1 of standard input")]


@pytest.mark.parametrize("names, said", [
    ([], "none"), (["nowhere"], "nothing at nowhere"), (["shots/empty"], "no photos"),
    (["shots/fit"], "no photos"),
    (["shots/zz*"], "none like shots/zz"), (["shots/wood/00.png/x"], "nothing at")])
def test_what_stands_for_no_capture_is_refused(shots, names, said):
    with pytest.raises(CaptureError, match=said):
        entries(names)


@pytest.mark.parametrize("line, error, said", [
    ("nowhere", CaptureError, r"nothing at nowhere \(line 2 of list.txt\)"),
    ("zz*", CaptureError, r"none like zz\* \(line 2"),
    ("shots/empty", CaptureError, r"no photos \(line 2"),
    ("list.txt", CaptureError, "line 2"),  # of lists there is one level
    ("'shots/wood", ConfigError, r"No closing quotation \(line 2 of list.txt\); close the quotes")])
def test_a_mistake_in_a_list_is_told_with_its_line(shots, line, error, said):
    with pytest.raises(error, match=said):
        entries([write_list(f"shots/wood\n{line}\n")])


def test_all_mistakes_of_all_lists_are_told_at_once(shots):
    write_list("nowhere\nshots/wood\n'shots/brick\n", "one.txt")
    write_list("".join(f"gone-{k}\n" for k in range(30)), "many.txt")
    with pytest.raises(ConfigError) as error:
        entries(["one.txt", "lost", "many.txt"])
    lines = str(error.value).splitlines()
    assert "got 33" in lines[0] and len(lines) == 34
    for line, told in zip(lines[1:], ("nowhere (line 1 of one.txt)", "line 3 of one.txt",
                                      "nothing at lost;",
                                      "gone-0 (line 1 of many.txt)")):
        assert told in line


def test_a_library_among_the_captures_is_passed_over(shots):
    (shots / "library/wood-1a2b3c4d").mkdir(parents=True)
    (shots / "library/.token").touch()
    (shots / "library/wood-1a2b3c4d/preview.jpg").touch()
    for names in (["shots"], ["shots/[lwb]*", "shots/text", "shots/a b"], ["shots", "shots/library"]):
        assert sorted(found(*names)) == [("a b",), ("brick",), ("text",), ("wood",)]
    with pytest.raises(CaptureError, match="captures to fit, got none"):
        entries(["shots/library"])


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"shots/w\xe9\n"])
def test_a_list_that_is_no_text_is_refused(shots, monkeypatch, content):
    Path("list.txt").write_bytes(content)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))
    for name in ("list.txt", "-"):
        with pytest.raises(MitsvbrdfError, match="UTF-8"):
            entries([name])


def test_a_folder_that_may_not_be_read_counts_as_a_capture_so_that_others_go_on(shots, monkeypatch):
    listed = os.listdir

    def forbidden(folder):
        if Path(folder).name == "brick":
            raise PermissionError(13, "Permission denied", str(folder))
        return listed(folder)

    monkeypatch.setattr(captures_module.os, "listdir", forbidden)
    assert found("shots") == [("a b",), ("brick",), ("text",), ("wood",)]


@pytest.mark.parametrize("source, name", [
    ("/x/wood bamboo", "wood_bamboo"), ("/x/wood/capture.json", "wood"), ("s3://box/shots/wood/", "wood"),
    ("/x/木目", "capture"), ("/x/.hidden", "hidden"), ("/x/a\nb", "a_b"), ("/x/-rf", "rf"),
    ("/x/" + "a" * 200, "a" * 80), ("/", "capture"), ("/x/../..", "capture")])
def test_names_have_letters_that_every_file_system_has(source, name):
    assert name_of(source) == name


def test_captures_behind_a_url_are_found_as_in_a_folder(shots):
    url = shots.as_uri()
    assert found(url) == found("shots")
    assert found(f"{url}/a b/capture.json") == [("a b",)]
    with pytest.raises(CaptureError, match="none at"):
        entries([f"{url}/empty"])
    with local_capture(f"{url}/wood") as folder:
        assert [path.name for path in folder.iterdir()] == ["00.png"] and folder.name == "wood"
    assert not folder.exists()
