"""A fit's folder keeps its files and its page together, and never shows one fit's page beside another fit."""

import json
import math
import shutil
import signal

import numpy as np
import pytest
import torch
from helpers import GRID, photos_of
from helpers.fit_pages import FAST, SIDE, Page
from helpers.unfinished import unfinished

from mitsvbrdf import cli
from mitsvbrdf.capture import write_capture
from mitsvbrdf.export.mitsuba import write_scene
from mitsvbrdf.fit.result import Fit
from mitsvbrdf.io import results
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.views import Views


def test_a_fit_is_not_lost_with_its_page(photos, tmp_path, monkeypatch, capsys):
    def breaks(*_, **__):
        raise RuntimeError("no page today")

    arguments = ["fit", str(photos), "-o", str(tmp_path / "out"), *FAST]
    with monkeypatch.context() as patch:
        patch.setattr("mitsvbrdf.report.folder.write_report", breaks)
        assert cli.main(arguments) == 0
    assert "no page today" in capsys.readouterr().out and not (tmp_path / "out/report.html").exists()
    assert load_maps(tmp_path / "out").resolution == SIDE
    assert cli.main(["report", str(tmp_path / "out"), "--quick"]) == 0
    assert (tmp_path / "out/report.html").is_file()


def test_the_page_is_made_again_from_the_folder_alone(copy):
    before = json.loads((copy / "report.json").read_text())
    page = Page(copy / "report.html")
    assert cli.main(["report", str(copy), "--quick"]) == 0
    again = json.loads((copy / "report.json").read_text())
    machine = again.pop("machine"), before.pop("machine")  # libLLVM only counts where it was loaded
    assert again == before and machine[0]["cores"] == machine[1]["cores"]
    assert Page(copy / "report.html").pictures == page.pictures


def test_without_photos_the_renderings_are_shown_and_the_capture_brings_them_back(copy, fitted, photos):
    before = json.loads((copy / "report.json").read_text())
    for name in ("photos", "predicted"):
        shutil.rmtree(copy / name)
    for name in ("report.html", "report.json"):
        (copy / name).unlink()
    names = [name for name in results.own_files(copy) if name != "photos/00.png"]
    (copy / results.MANIFEST).write_text(json.dumps({"serial": 1, "files": names}))
    (copy / "photos").mkdir()
    (copy / "photos/mine").write_text("mine")  # a file of somebody else, and no photo
    assert cli.main(["report", str(copy), "--quick"]) == 0
    page = Page(copy / "report.html")
    assert "were not kept here" in page.text and "photo 00" not in page.pictures
    assert page.pixels("photo 00, re-rendered").shape == (SIDE, SIDE, 3) and "held out" not in page.text
    (copy / "photos/mine").rename(copy / "photos/00.png")
    assert cli.main(["report", str(copy), "--quick", "--capture", str(photos)]) == 2  # replaces nobody's file
    (copy / "photos/00.png").unlink()
    assert cli.main(["report", str(copy), "--quick", "--capture", str(photos)]) == 0
    assert json.loads((copy / "report.json").read_text())["photos"] == before["photos"]
    assert Page(copy / "report.html").pictures == Page(fitted / "report.html").pictures
    written = set(results.own_files(copy))
    assert {"report.html", "report.json", "photos/00.png", "photos/04.png", "predicted/04.png"} <= written


def test_ctrl_c_while_a_fit_is_written_is_heard_when_all_is_there(photos, tmp_path, monkeypatch, capsys):
    real = write_scene

    def pressed(*arguments):
        signal.raise_signal(signal.SIGINT)
        real(*arguments)

    monkeypatch.setattr("mitsvbrdf.report.folder.write_scene", pressed)
    assert cli.main(["fit", str(photos), "-o", str(tmp_path / "out"), *FAST]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert not results.partial_folder(tmp_path / "out").exists()
    assert Fit.load(tmp_path / "out") and (tmp_path / "out/report.html").is_file()


def test_an_unfinished_fit_is_no_matter_of_the_page(copy):
    partial = unfinished(copy, results.CHECKPOINT)
    assert cli.main(["report", str(copy), "--quick"]) == 0
    assert (partial / results.CHECKPOINT).read_bytes() == b"state"


def test_a_page_that_fails_leaves_the_earlier_one(copy, photos, monkeypatch):
    def files():
        return {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}

    before = files()
    monkeypatch.setattr("mitsvbrdf.report.fit_page._write_page", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cli.main(["report", str(copy), "--quick", "--capture", str(photos)])
    assert files() == before


def test_the_next_fit_takes_the_pages_files_away(copy, photos):
    assert cli.main(["report", str(copy), "--quick", "--capture", str(photos)]) == 0
    assert cli.main(["fit", str(photos), "-o", str(copy), *FAST, "--overwrite"]) == 0
    assert not (copy / "predicted").exists() and not list(copy.rglob("*.old"))
    assert "held out" not in Page(copy / "report.html").text


def test_a_fit_predicts_nine_photos_and_report_all(tmp_path):
    twelve = Views(*(torch.cat((t, t[:3])) for t in (GRID.camera, GRID.light, GRID.intensity)))
    write_capture(photos_of(make_material("tiles", 8), twelve), tmp_path / "photos")
    options = ["--method", "direct", "--renderer", "analytic", "--iterations", "2", "--resolution", "8",
               "--views", "11"]
    out = tmp_path / "out"
    assert cli.main(["fit", str(tmp_path / "photos"), "-o", str(out), *options]) == 0
    assert len(list((out / "predicted").glob("*.png"))) == 9
    assert cli.main(["report", str(out), "--quick", "--capture", str(tmp_path / "photos")]) == 0
    record = json.loads((out / "report.json").read_text())
    assert [photo["name"] for photo in record["photos"]] == ["11", *(f"{i:02d}" for i in range(11))]
    assert math.sqrt(np.mean([p["rmse"]**2 for p in record["photos"][1:]])) == pytest.approx(
        record["held_out_rmse"], rel=1e-9)
