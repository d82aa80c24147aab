"""Folders are read as fits only where they are some, and photos are those of the fit or refused."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from helpers import ANALYTIC, photos_of
from helpers.fit_pages import FAST, SIDE, Page

from mitsvbrdf import cli
from mitsvbrdf.capture import read_capture, write_capture
from mitsvbrdf.errors import OutputError
from mitsvbrdf.fit import DirectConfig, fit_svbrdf
from mitsvbrdf.fit.result import Fit
from mitsvbrdf.io import images
from mitsvbrdf.material.made import make_material
from mitsvbrdf.report import fit_page
from mitsvbrdf.report.checks import fit_report
from mitsvbrdf.report.fit_page import write_report
from mitsvbrdf.report.folder import write_fit


def test_trouble_is_told(copy):
    record = json.loads((copy / "fit.json").read_text())
    record |= {"warnings": ["<b>doubt</b> & more"], "stopped": "interrupted", "undone_steps": 1, "undone": [
        {"iteration": 7, "reason": "loss not finite"}], "trace": record["trace"][:1]}
    (copy / "fit.json").write_text(json.dumps(record))
    write_report(copy, quick=True)
    page = Page(copy / "report.html")
    assert "<b>doubt</b> & more" in page.text
    assert page.row("step undone") == ["7", "loss not finite"]


def changed(**fields):
    return lambda out: (out / "fit.json").write_text(
        json.dumps(json.loads((out / "fit.json").read_text()) | fields))


def spoil_map(out):
    (out / "maps/normal.exr").unlink()
    (out / "maps/normal.png").unlink()


def spoil_from(out):
    record = json.loads((out / "fit.json").read_text())
    record["calibration"]["from"] = "nowhere"
    (out / "fit.json").write_text(json.dumps(record))


@pytest.mark.parametrize("spoil, words", [
    (lambda out: (out / "fit.json").unlink(), ("mitsvbrdf fit", "no fit.json")),
    (lambda out: (out / "fit.json").write_text("{"), ("fit.json",)),
    (changed(schema_version=2), ("schema version 1", "schema_version")),
    (changed(confidence={"diffuse": {}}), ("confidence", "median_sd")),
    (changed(per_photo={"../../etc": 0.1}), ("per_photo",)), (changed(trace=[{"seconds": 1}]), ("trace",)),
    (lambda out: shutil.rmtree(out / "rerendered"), ("rerendered/", "--pages all")),  # as of --pages none
    (spoil_from, ("calibration.from",)), (spoil_map, ("normal.exr",)),
    (lambda out: (out / "rerendered/01.png").write_text("no picture"), ("01.png",)),
    (lambda out: images.write_png(out / "photos/01.png", torch.zeros(8, 8, 3)),
     ("photos/01.png", "--capture"))])
def test_folders_that_are_no_fit_are_refused(spoil, words, copy, capsys):
    spoil(copy)
    before = (copy / "report.html").read_text()
    assert cli.main(["report", str(copy), "--quick"]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and all(word in message for word in words), message
    assert (copy / "report.html").read_text() == before


def test_photos_of_another_capture_are_refused(copy, photos, tmp_path, capsys):
    shots = read_capture(photos)
    write_capture(replace(shots, photos=shots.photos.flip(2)), tmp_path / "other")
    write_capture(shots.pick([0, 1]), tmp_path / "few")
    write_capture(shots.averaged(16), tmp_path / "small")
    before = sorted(copy.rglob("*"))
    for name, words in (("other", ("photo 00 is another", "give the capture")), ("few", ("photos among",)),
                        ("small", ("16 px",)), ("nowhere", ("a folder of photos",))):
        assert cli.main(["report", str(copy), "--quick", "--capture", str(tmp_path / name)]) == 2
        message = capsys.readouterr().err
        assert message.count("error:") == 1 and all(word in message for word in words), message
    assert sorted(copy.rglob("*")) == before
    assert cli.main(["report", str(tmp_path / "nowhere")]) == 2
    assert "which has no fit.json" in capsys.readouterr().err


def test_photos_are_never_written_over_those_of_the_capture(copy, photos, tmp_path, capsys):
    # A capture in OUT/photos, plain or calibrated, named by its folder or its JSON file.
    project = tmp_path / "project"
    shutil.copytree(photos, project / "photos")
    for k in (0, 1):
        shutil.copy(photos / f"target/{k:02d}.png", project / "photos")
    before = {path: path.read_bytes() for path in project.rglob("*.png")}
    for capture in (project / "photos", project / "photos/capture.json"):
        assert cli.main(["fit", str(capture), "-o", str(project), *FAST, "--overwrite"]) == 2
        assert "holds the photos" in capsys.readouterr().err
    shots = read_capture(project / "photos")
    found = fit_svbrdf(shots, ANALYTIC, DirectConfig(iterations=1))
    for out in (project, project / "photos"):
        with pytest.raises(OutputError, match="own photos would be replaced"):
            write_fit(found, shots, out)
    assert {path: path.read_bytes() for path in project.rglob("*.png")} == before
    # What an earlier page kept is no capture: its views are gone.
    assert cli.main(["report", str(copy), "--quick", "--capture", str(copy / "photos")]) == 2
    assert "holds the photos" in capsys.readouterr().err
    write_capture(replace(shots, calibration="none"), tmp_path / "plain")
    assert cli.main(["report", str(copy), "--quick", "--capture", str(tmp_path / "plain")]) == 2
    assert "with calibration" in capsys.readouterr().err


def test_a_fit_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    shots, out = photos_of(make_material("tiles", 8)), tmp_path / "out"
    found, fixed = (fit_svbrdf(shots, ANALYTIC, DirectConfig(iterations=1, fix=fix))
                    for fix in ((), ("roughness=0.5",)))
    write_fit(found, shots, out, pages=False)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with monkeypatch.context() as patch:
        patch.setattr("mitsvbrdf.report.folder.write_json", lambda *_: 1 / 0)
        for place in (out, tmp_path / "new"):
            with pytest.raises(ZeroDivisionError):
                write_fit(fixed, shots, place, pages=False, overwrite=True)
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    assert not (tmp_path / "new").exists() and (out / "uncertainty/roughness.exr").is_file()
    write_fit(fixed, shots, out, pages=False, overwrite=True)
    assert not (out / "uncertainty/roughness.exr").exists()
    assert Fit.of_maps(out).svbrdf["roughness"].unique().item() == 0.5


def test_a_page_is_not_written_beside_another_fit(copy, monkeypatch):
    def slow(*arguments, **options):
        (copy / "fit.json").write_text(json.dumps(json.loads((copy / "fit.json").read_text()) | {"seed": 7}))
        return fit_report(*arguments, **options)

    monkeypatch.setattr(fit_page, "fit_report", slow)
    before = (copy / "report.html").read_bytes()
    with pytest.raises(OutputError, match="another one"):
        write_report(copy, quick=True)
    assert (copy / "report.html").read_bytes() == before


def test_a_capture_whose_name_is_not_utf8_loses_no_fit(photos, tmp_path):
    # as Python names such a folder; and no formula
    shots = replace(read_capture(photos), source=Path("caf\udce9 $\\x_$"))
    write_fit(fit_svbrdf(shots, ANALYTIC, DirectConfig(iterations=1)), shots, tmp_path)
    assert "caf? $\\x_$" in Page(tmp_path / "report.html").text and (tmp_path / "sheet.png").is_file()


def test_a_report_json_of_somebody_else_is_not_trusted(copy):
    record = json.loads((copy / "report.json").read_text())
    for photo in record["photos"][3:]:
        photo |= {"photo": "../secret.png", "rerendered": "../secret.png"}
    images.write_png(copy.parent / "secret.png", torch.zeros(SIDE, SIDE, 3))
    (copy / "report.json").write_text(json.dumps(record))
    assert "secret" not in str(write_report(copy, quick=True)["photos"])
    (copy / "report.json").write_text("[1]")
    assert write_report(copy, quick=True)["held_out_rmse"] is None
