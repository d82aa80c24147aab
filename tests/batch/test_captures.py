"""Which captures the words of a command line and the lines of a list stand for."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from mitsvbrdf.batch import captures as captures_module
from mitsvbrdf.batch.captures import Entry, captures, local_capture, name_of, rectified
from mitsvbrdf.capture.align import from_sheet
from mitsvbrdf.errors import CaptureError, ConfigError, InputWarning
from mitsvbrdf.io import images


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


def found(*names):
    return [(os.path.basename(entry.source), *entry.own) for entry in captures(names)]


def write_list(text, name="list.txt"):
    Path(name).write_text(text)
    return name


def test_captures_are_absolute_paths_in_the_order_of_the_command_line(shots):
    Path("link").symlink_to("shots/brick")
    assert captures(["shots/wood", "link"]) == [Entry(str(shots / "wood")), Entry(str(shots / "brick"))]


def test_a_folder_of_captures_is_those_right_inside_by_name(shots):
    assert found("shots") == [("a b",), ("brick",), ("text",), ("wood",)]


def test_a_json_file_is_a_capture_by_itself(shots):
    (shots / "a b/Some.JSON").touch()
    assert [entry.source for entry in captures(["shots/a b/capture.json", "shots/a b/Some.JSON"])] == [
        str(shots / "a b/capture.json"), str(shots / "a b/Some.JSON")]


def test_a_list_has_a_capture_and_its_own_options_a_line(shots):
    write_list("""# what there is
        wood --seed 3 --tag "old wood"

        'a b'    # a remark with ' in it
        brick#1 --fix diffuse=red
    """, "shots/list.txt")
    (shots / "brick#1").mkdir()
    (shots / "brick#1/00.png").touch()
    assert found("shots/list.txt") == [("wood", "--seed", "3", "--tag", "old wood"), ("a b",),
                                       ("brick#1", "--fix", "diffuse=red")]
    assert captures(["shots/list.txt"])[1].where == "line 4 of shots/list.txt"


def test_a_list_may_begin_with_the_mark_of_some_editors_and_have_absolute_paths(shots):
    Path("list.txt").write_bytes(f"\ufeffshots/wood\r\n{shots}/brick\r\n".encode())
    assert found("list.txt") == [("wood",), ("brick",)]


@pytest.mark.parametrize("names, said", [
    ([], "none"), (["nowhere"], "nothing at nowhere"), (["shots/empty"], "no photos"),
    (["shots/fit"], "no photos"), (["shots/wood/00.png/x"], "nothing at")])
def test_what_stands_for_no_capture_is_refused(shots, names, said):
    with pytest.raises(CaptureError, match=said):
        captures(names)


@pytest.mark.parametrize("line, error, said", [
    ("nowhere", CaptureError, r"nothing at nowhere \(line 2 of list.txt\)"),
    ("shots/empty", CaptureError, r"no photos \(line 2"),
    ("list.txt", CaptureError, r"no folder at list.txt \(line 2"),  # of lists there is one level
    ("'shots/wood", ConfigError, r"No closing quotation \(line 2 of list.txt\); close the quotes")])
def test_a_mistake_in_a_list_is_told_with_its_line(shots, line, error, said):
    with pytest.raises(error, match=said):
        captures([write_list(f"shots/wood\n{line}\n")])


def test_a_library_among_the_captures_is_passed_over(shots):
    (shots / "library/wood-1a2b3c4d").mkdir(parents=True)
    (shots / "library/.token").touch()
    (shots / "library/wood-1a2b3c4d/preview.jpg").touch()
    for names in (["shots"], ["shots", "shots/library"]):
        assert sorted(found(*names)) == [("a b",), ("brick",), ("text",), ("wood",)]
    with pytest.raises(CaptureError, match="captures to fit, got none"):
        captures(["shots/library"])


def test_a_picture_beside_captures_does_not_take_their_place_in_silence(shots):
    (shots / "overview.jpg").touch()
    with pytest.warns(InputWarning, match="passed over: a b, brick, text, wood"):
        assert found("shots") == [("shots",)]
    (shots / "capture.json").touch()  # it states which photos are its own
    assert found("shots") == [("shots",)]


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"shots/w\xe9\n"])
def test_a_list_that_is_no_text_is_refused(shots, content):
    Path("list.txt").write_bytes(content)
    with pytest.raises(CaptureError, match="UTF-8"):
        captures(["list.txt"])


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


@pytest.mark.slow
def test_captures_behind_a_url_are_found_as_in_a_folder(shots):
    url = shots.as_uri()
    assert found(url) == found("shots")
    assert found(f"{url}/a b/capture.json") == [("a b",)]
    with pytest.raises(CaptureError, match="none at"):
        captures([f"{url}/empty"])
    with local_capture(f"{url}/wood") as folder:
        assert [path.name for path in folder.iterdir()] == ["00.png"] and folder.name == "wood"
    assert not folder.exists()


def test_a_sheet_without_its_size_is_told_with_the_options_of_a_batch(tmp_path, monkeypatch):
    for number in range(3):
        images.write_png(tmp_path / f"{number}.png", torch.full((64, 64, 3), 0.5))
    monkeypatch.setattr(from_sheet, "find_edges", lambda *_, **__: SimpleNamespace(corners=range(30)))
    with pytest.raises(CaptureError, match="30 tags in 0.*`--sheet 18`, to the command or on the line of a "
                                           "list") as error:
        rectified(tmp_path, tmp_path / "out", None, None, 256)
    assert "mitsvbrdf capture" not in str(error.value)
