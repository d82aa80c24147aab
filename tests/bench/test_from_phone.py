"""The benchmark's suite ``capture``: a tiny case of each kind from end to end, figures against closed forms;
no times.
"""

import json
from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, GRID, photos_of

from mitsvbrdf import cli
from mitsvbrdf.bench import from_phone as suite
from mitsvbrdf.bench.from_phone import CaptureJob, capture_jobs, recovered, scaled_diffuse_rmse
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.suite_tables import capture_tables
from mitsvbrdf.capture import write_capture
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import HierarchicalConfig
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.measure.metrics import map_rmse
from mitsvbrdf.synth.phone import HandheldPhone

TINY = ["bench", "--suite", "capture", "--renderer", "analytic", "--resolution", "16", "--budgets", "0.2",
        "--seeds", "0",
        "--megapixels", "0.2"]


def test_recovered_cameras_are_compared_after_scale_and_shift():
    given = GRID
    moved = replace(given, camera=given.camera / 1.3 + torch.tensor([0.2, -0.1, 0.0]))
    found = recovered(moved, given)
    assert found["lateral"] < 1e-12 and found["depth"] < 1e-12 and found["scale"] == pytest.approx(1.3)
    aside = given.camera.clone()
    # their mean is 0: no shift takes it away
    aside[:, 0] += torch.tensor([0.1, -0.1, 0.1, -0.1, 0.0, 0.1, -0.1, 0.1, -0.1])
    worse = recovered(replace(given, camera=aside), given)
    assert 0.09 < worse["lateral"] < 0.11 and worse["depth"] < 0.01


def test_recovered_is_in_patch_sides():
    given = GRID
    in_cm = replace(given, camera=given.camera * 11.5, light=given.light * 11.5, size=11.5)
    assert recovered(in_cm, given)["scale"] == pytest.approx(1)


def test_scaled_diffuse_error_does_not_see_a_factor():
    truth = make_material("inlay", 16)
    darker = SVBRDF(truth.bsdf, dict(truth.maps) | {"diffuse": truth["diffuse"] * 0.5})
    assert map_rmse(darker, truth)["diffuse"] > 0.05
    assert scaled_diffuse_rmse(darker, truth) < 1e-6
    noisy = SVBRDF(truth.bsdf, dict(truth.maps) | {"diffuse": truth["diffuse"].flip(0)})
    assert 0.01 < scaled_diffuse_rmse(noisy, truth) <= map_rmse(noisy, truth)["diffuse"]


@pytest.mark.slow
def test_a_phone_with_a_sheet_from_end_to_end(monkeypatch):
    monkeypatch.setattr(suite, "SAMPLE_SIDE", 128)
    job = CaptureJob("material", "builtin:leather", True, HandheldPhone(megapixels=0.2, photos=4),
                     HierarchicalConfig(budget=0.2), 16, ANALYTIC)
    made = job.run()
    errors = made["errors"]
    assert made["stopped"] == "done", made["why"]
    assert errors["photos"] == 4 and errors["cameras"] < 0.01 and errors["power"] == pytest.approx(1,
                                                                                                   abs=0.05)
    assert errors["ratio"] == pytest.approx(errors["found mean"] / errors["true mean"])
    # encoded below 0.01 or so, a factor is not exact
    assert errors["found scaled diffuse"] <= errors["found diffuse"] + 1e-4
    assert {"taking", "fit, found views", "fit, true views"} < set(made["seconds"])
    check_benchmark({"schema_version": 2, "settings": {}, "machine": {}, "versions": {}, "seeds": [],
                     "published": {},
                     "records": [job.key | {"config": job.settings} | made]}, "here")


def test_each_material_has_a_sheet_and_none():
    jobs = capture_jobs(["builtin:inlay"], ["/there/book"], HandheldPhone(), HierarchicalConfig(), 16, None,
                        "")
    assert [tuple(job.key.values())[1:] for job in jobs] == [("material", "inlay", True),
                                                             ("material", "inlay", False),
                                                             ("capture", "book", False)]


def test_a_real_capture_by_the_command_which_goes_on(tmp_path, capsys):
    shots = photos_of(make_material("inlay", 16))
    write_capture(shots, tmp_path / "given")
    out, page = tmp_path / "b.json", tmp_path / "b.md"
    arguments = [*TINY, "--materials", "none", "--captures", str(tmp_path / "given"), "--json", str(out)]
    assert cli.main([*arguments, "--page", str(page)]) == 0
    record, = json.loads(out.read_text())["records"]
    assert record["stopped"] == "done", record["why"]
    assert {"fitted lateral", "estimated depth", "ratio", "refined left out",
            "held left out"} < set(record["errors"])
    assert "nothing to do" not in capsys.readouterr().out
    before = out.read_bytes()
    assert cli.main(arguments) == 0 and "nothing to do" in capsys.readouterr().out and out.read_bytes() == before
    text = page.read_text()
    assert "## From a phone to maps" in text and "| given |" in text
    assert "--suite capture --materials none --captures given --budgets 0.2" in text


def test_what_cannot_be_done_is_a_record_and_a_note(tmp_path):
    job = CaptureJob("capture", str(tmp_path / "nowhere"), False, HandheldPhone(), HierarchicalConfig(), 16,
                     ANALYTIC)
    made = job.key | {"config": job.settings} | job.run()
    assert made["stopped"] == "failed" and not made["errors"] and "nowhere" in made["why"]
    table = capture_tables({"records": [made]})[0]
    assert table.rows == [["nowhere", *["failed"] * 7]] and "nowhere" in table.note
    with pytest.raises(ConfigError):
        check_benchmark({"schema_version": 2, "settings": {}, "machine": {}, "versions": {}, "seeds": [],
                         "published": {},
                         "records": [made | {"sheet": "yes"}]}, "x")


def test_tables_show_the_median():
    def record(name, cameras):
        errors = {"cameras": cameras, "found mean": 0.1, "true mean": 0.08, "ratio": 1.25}
        return {"suite": "capture", "kind": "material", "name": name, "sheet": True, "config": {},
                "errors": errors,
                "seconds": {"taking": cameras}, "stopped": "done", "why": None}

    failed = record("d", 0) | {"errors": {}, "seconds": {}, "stopped": "failed", "why": "too few"}
    three = [record("a", 0.01), record("b", 0.03), record("c", 0.002)]
    assert capture_tables({"records": [*three, failed]})[0].rows[-1][:2] == ["median of 3 of 4", "1.00 %"]
    table, seconds = capture_tables({"records": three})
    assert table.rows[-1][:2] == ["median", "1.00 %"] and table.rows[1][1] == "3.00 %"
    assert table.rows[-1][table.heads.index("ratio")] == "1.250" and seconds.rows == [["taking", "0.01"]]
