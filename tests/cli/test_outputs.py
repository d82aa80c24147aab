"""Files to write are checked before the work begins; each mistake is one message with exit code 2."""

from pathlib import Path

import pytest
from helpers.commands import FAST, fails

from mitsvbrdf import cli
from mitsvbrdf.io import files, results
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.material.maps import flat


def test_output_that_cannot_be_written(shots, tmp_path, capsys):
    if Path("/dev/full").exists() and Path("/proc/1").exists():
        fails(capsys, tmp_path, ["fit", shots, "-o", "/proc/out", *FAST], "/proc/out")


WRITING = [["crosscheck", "--json"], ["crosscheck", "--html"], ["stability", "--json"], ["evaluate",
    "builtin:tiles", "--reference", "builtin:tiles", "--json"], ["compare", "builtin:tiles", "--capture",
    "shots", "-o"], ["compare", "builtin:tiles", "--capture", "shots", "-o", "../c.html", "--json"], ["bench",
    "--page"], ["sheet", "-o"], ["pretrain", "shots", "-o"]]


@pytest.fixture
def lazy(tmp_path, monkeypatch):
    """No command may begin its work; one file that is the user's own."""
    for name in ("verify.crosscheck.crosscheck", "cli.stability.run", "material.made.make_material",
                 "capture.read_capture", "cli.bench.find_tasks", "capture.align.sheet.write_sheet",
                 "cli.fit.read_photos"):
        monkeypatch.setattr(f"mitsvbrdf.{name}", lambda *_, **__: pytest.fail("worked first"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    return tmp_path


@pytest.mark.parametrize("command", [*WRITING, ["bench", "--json"]])
def test_bad_outputs_are_found_before_the_work(command, lazy, capsys):
    fails(capsys, lazy, [*command, lazy], "a file to write")
    fails(capsys, lazy, [*command, lazy / "file/record"], "file/record")


@pytest.mark.parametrize("command", WRITING)
def test_files_that_are_there_are_replaced_only_when_asked(command, lazy, capsys):
    fails(capsys, lazy, [*command, "file"], "file, which exists", "--overwrite")
    (lazy / "link").symlink_to("file")
    fails(capsys, lazy, [*command, "link"], "link, which exists", "--overwrite")


def test_pictures_beside_a_page_are_no_less(lazy, capsys):
    (lazy / "p.svg").write_text("mine")
    fails(capsys, lazy, ["bench", "--page", "p.md"], "p.svg", "--overwrite")


@pytest.mark.parametrize("command", [
    ["crosscheck", "--json", "a", "--html", "./a"], ["crosscheck", "--json", "a", "--html", "a/b"],
    ["crosscheck", "--json", "a/b", "--html", "a"], ["crosscheck", "--json", "a", "--html", "b/../a"],
    ["compare", "builtin:tiles", "--capture", "shots", "-o", "a", "--json", "a"],
    ["bench", "--page", "a.svg"]])
def test_two_outputs_are_two_files(command, lazy, capsys):
    fails(capsys, lazy, command, "a file of its own")


@pytest.mark.parametrize("command, name", [
    (["evaluate", "fit/maps", "--reference", "builtin:tiles", "--json"], "fit/fit.json"),
    (["sheet", "-o"], "fit/maps/diffuse.exr"),
    (["evaluate", "file", "--reference", "builtin:tiles", "--json"], "file"),
    (["evaluate", "builtin:tiles", "--capture", "shots", "--json"], "shots/new.json"),
    (["compare", "a=b", "tiles=fit", "--capture", "shots", "-o"], "fit/fit.json"),
    (["compare", "builtin:tiles", "--capture", "shots/capture.json", "-o"], "shots/target/04.html"),
    (["crosscheck", "fit", "--views", "shots", "--html"], "shots/target/00.png"),
    (["bench", "--json", "b.json", "--page"], "b.json"),
    (["pretrain", "shots/target/00.png", "-o"], "shots/target/00.png")])
def test_what_is_read_or_part_of_a_result_is_not_written(command, name, lazy, capsys):
    for file in ("shots/capture.json", "shots/target/00.png"):
        files.write_json(lazy / file, {})
    with results.output_folder(lazy / "fit", overwrite=False) as folder:
        for file in ("fit.json", "maps/diffuse.exr"):
            files.write_json(folder / file, {})
    fails(capsys, lazy, [*command, name, "--overwrite"], name)


def test_a_file_of_ones_own_in_a_result_is_no_part_of_it(lazy, capsys):
    with results.output_folder(lazy / "fit", overwrite=False) as folder:
        save_maps(flat(8), folder / "maps")
    for options in ([], ["--overwrite"]):
        assert cli.main(["evaluate", "fit", "--reference", "fit/maps", "--json", "fit/e.json", *options]) == 0


@pytest.mark.parametrize("command", [["render", "{}", "-o", "{}"], ["synth", "{}", "-o", "{}"]])
def test_results_among_maps_would_take_their_place(command, tmp_path, capsys):
    save_maps(flat(8), tmp_path / "fit/maps")
    for place in ("fit", "fit/maps"):
        words = [word.format(tmp_path / place) for word in command]
        fails(capsys, tmp_path, [*words, "--overwrite"], "which holds the maps")


def test_a_fit_reads_no_photo_for_a_place_that_is_taken(lazy, capsys):
    with results.output_folder(lazy / "done", overwrite=False) as folder:
        (folder / "fit.json").touch()
    with pytest.raises(ZeroDivisionError), results.output_folder(lazy / "begun", overwrite=False) as folder:
        (folder / results.CHECKPOINT).touch()
        raise ZeroDivisionError
    for out, words in (("done", "which has results"), ("begun", "no unfinished run"), ("file", "the file"),
                       ("file/out", "file/out")):
        fails(capsys, lazy, ["fit", "shots", "-o", out], words)
    with results.output_folder(lazy / "done", overwrite=True):
        fails(capsys, lazy, ["fit", "shots", "-o", "done", "--overwrite"], "in use by another run")


@pytest.mark.parametrize("command", [["render", "builtin:tiles"], ["synth", "builtin:tiles"]])
def test_nothing_is_rendered_for_a_place_that_is_taken(command, tmp_path, capsys, monkeypatch):
    for name in ("render.analytic.AnalyticRenderer.render", "cli.synth.photograph"):
        monkeypatch.setattr(f"mitsvbrdf.{name}", lambda *_, **__: pytest.fail("worked first"))
    (tmp_path / "mine.txt").write_text("mine")
    fails(capsys, tmp_path, [*command, "-o", tmp_path, "--renderer", "analytic"], "which has results")
