"""References, the paper's schedule, and the seconds of an iteration: each a tiny case, against independent
counts.
"""

import json
from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, GRID, photos_of
from helpers.bench_records import benchmark

from mitsvbrdf.bench.paper import schedule
from mitsvbrdf.bench.paper.references import START, ReferenceJob, peers
from mitsvbrdf.bench.paper.schedule import ScheduleJob
from mitsvbrdf.bench.paper.steps import EARLIER, NOW, EarlierGan, StepJob
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.tasks import known_material, real_capture
from mitsvbrdf.capture import write_capture
from mitsvbrdf.capture.guess import guess_diffuse
from mitsvbrdf.color import encode
from mitsvbrdf.fit import FitTask, GanConfig
from mitsvbrdf.fit.generator.gan import Gan
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps


def rmse(a, b):
    return float((a.double() - b.double()).square().mean().sqrt())


def kept(job):
    record = job.key | {"config": job.settings} | job.run()
    check_benchmark(benchmark([json.loads(json.dumps(record))]), "here")
    return record


def test_references_of_a_material_are_counted_as_its_maps_are(tmp_path):
    save_maps(make_material("leather", 16), tmp_path / "hide")
    save_maps(make_material("tiles", 16), tmp_path / "hide/peers/gao2019")
    task = known_material(str(tmp_path / "hide"), 16, GRID, ANALYTIC)
    errors = kept(ReferenceJob(task, ANALYTIC))["errors"]
    assert set(errors) == {"guess robust", "guess min", "guess mean-blur", START, "Gao 2019"}
    for method in ("robust", "min"):
        guess = guess_diffuse(task.photos, method)
        assert errors[f"guess {method}"] == {"diffuse": pytest.approx(rmse(encode(guess),
                                                                           encode(task.truth["diffuse"])),
                                                                      1e-5)}
    assert errors[START]["diffuse"] == errors["guess robust"]["diffuse"]
    assert {"specular", "roughness", "normal", "mean", "novel_light", "photos"} < set(errors[START])
    tiles = make_material("tiles", 16)
    # Maps in files have 8 bits: off by up to 0.002.
    assert errors["Gao 2019"]["normal"] == pytest.approx(rmse(tiles["normal"] / 2, task.truth["normal"] / 2),
                                                         abs=0.004)


def test_published_maps_are_counted_at_the_size_of_the_fits(tmp_path):
    save_maps(make_material("leather", 32), tmp_path / "hide")
    save_maps(make_material("tiles", 32), tmp_path / "hide/peers/gao2019")
    found = peers(known_material(str(tmp_path / "hide"), 16, GRID, ANALYTIC))
    assert found["Gao 2019"].resolution == 16 and peers(known_material("builtin:inlay", 16, GRID,
                                                                       ANALYTIC)) == {}


def test_references_of_a_capture_are_the_starts_photos(tmp_path):
    write_capture(photos_of(make_material("inlay", 16)), tmp_path / "shots")
    errors = kept(ReferenceJob(real_capture(tmp_path / "shots", 16), ANALYTIC))["errors"]
    assert set(errors) == {START} and set(errors[START]) == {"seen", "left_out"}


def test_a_schedule_keeps_how_its_errors_fall(monkeypatch):
    monkeypatch.setattr(schedule, "POINTS", 8)
    task = known_material("builtin:inlay", 16, GRID, ANALYTIC)
    config = GanConfig(preset="paper-two-stage", width=4, iterations=16)
    job = ScheduleJob("gan-two-stage", config, task, 3, ANALYTIC)
    found = kept(job)
    assert [entry["iteration"] for entry in found["trace"]] == [2 * k for k in range(9)]
    assert found["iterations"] == 16 and found["stopped"] == "iterations" and found["seed"] == 3
    assert {"diffuse", "specular", "roughness", "normal", "mean", "photos"} < set(found["trace"][0])
    # The result is the state that explains its photos best.
    best = min(found["trace"], key=lambda entry: entry["photos"])
    assert found["errors"] == {name: best[name] for name in found["errors"]}
    assert job.settings["iterations"] == 16 and job.settings["resolution"] == 16 and job.settings[
        "width"] == 4


@pytest.mark.parametrize("preset", ["minutes", "paper-two-stage"])
def test_an_iteration_is_timed_beside_the_earlier_one(preset):
    found = kept(StepJob(GanConfig(preset=preset, width=4), 16, ANALYTIC, repeats=2))
    assert [row["version"] for row in found["rows"]] == [NOW, EARLIER] and found["ratio"]["repeats"] == 2
    for row in found["rows"]:
        assert sum(row["parts"].values()) == pytest.approx(1, abs=1e-3) and {"network",
                                                                             "renderer"} < set(row["parts"])
    assert found["rows"][1]["bfloat16"] is False


@pytest.mark.parametrize("preset", ["paper-one-stage", "minutes"])
def test_the_earlier_iteration_trains_the_same(preset):
    config = GanConfig(preset=preset, width=4, precision="float32", seed=1)
    task = FitTask(photos_of(make_material("inlay", 16)), ANALYTIC, replace(config, iterations=2))
    states = []
    for kind in (Gan, EarlierGan):
        method = kind(task)
        for _ in range(2):
            method.step(0.5)
        states.append(method.state())
    # The diffuse loss of a later gradient step has no gradient to the other decoder: the same numbers come
    # out.
    for name, value in states[0].items():
        assert torch.allclose(value.double(), states[1][name].double(), rtol=1e-4, atol=1e-6), name
