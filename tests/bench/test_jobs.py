"""One fit of each kind, and what it is judged by, against independent loops."""

import json
import math
from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, GRID, photos_of
from helpers.bench_records import SETTINGS, benchmark

from mitsvbrdf.bench import jobs, methods, summary
from mitsvbrdf.bench.methods import fit
from mitsvbrdf.bench.peers_baseline import PeersConfig
from mitsvbrdf.bench.published import published
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.store import Store, read_benchmark
from mitsvbrdf.bench.tasks import known_material, novel_light_rmse, novel_views, real_capture
from mitsvbrdf.capture import write_capture
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import DirectConfig, GanConfig
from mitsvbrdf.fit.loop import Loop
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps


@pytest.mark.parametrize("config", [
    DirectConfig(iterations=2), GanConfig(iterations=1, width=8, preset="paper-one-stage"),
    PeersConfig(iterations=2)])
def test_one_fit_of_each_kind(config):
    shots = photos_of(make_material("inlay", 16))
    found = fit(shots, ANALYTIC, config)
    assert found.iterations == config.iterations and found.stopped == "iterations" and 0 < found.seconds <= found.wall
    # What it predicts for the photos it saw is the error of the fit, whatever light the method takes for
    # granted.
    assert found.predict(shots)[1] == pytest.approx(found.rmse, rel=1e-6)
    falloff = "none" if isinstance(config, GanConfig) and config.of_paper else "inverse-square"
    assert methods.as_lit(shots, config).views.falloff == falloff


@pytest.mark.parametrize("config", [DirectConfig(), GanConfig(width=8), PeersConfig()])
def test_a_fit_without_a_step_is_no_result(config, monkeypatch):
    # As where the budget is over before the first step, on any machine.
    monkeypatch.setattr(Loop, "_limit_reached", lambda loop: "budget")
    task = known_material("builtin:inlay", 16, GRID, ANALYTIC)
    found = jobs.FitJob("methods", "any", config, task, 0.1, 0, ANALYTIC).run()
    assert found["stopped"] == "failed" and "longer budget" in found["why"] and found["errors"] == {}


def test_a_fit_that_cannot_be_done_is_a_record(monkeypatch):
    def refused(*_, **__):
        raise ConfigError("a fit that stays finite", "none", "lower the learning rate")
    monkeypatch.setattr(jobs, "fit", refused)
    task = known_material("builtin:inlay", 16, GRID, ANALYTIC)
    job = jobs.FitJob("methods", "direct", DirectConfig(), task, 0.1, 0, ANALYTIC)
    found = job.key | {"config": job.settings} | job.run()
    assert found["stopped"] == "failed" and "stays finite" in found["why"] and found["errors"] == {}
    check_benchmark(benchmark([found]), "here")
    assert summary.curves([found], "mean") == {} and summary.failures([found]) == [found]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_errors_that_are_not_finite_make_a_record_of_a_fit_that_failed(value, monkeypatch, tmp_path):
    task = known_material("builtin:inlay", 16, GRID, ANALYTIC)
    monkeypatch.setattr(jobs, "fit", lambda *_, **__: None)
    monkeypatch.setattr(type(task), "errors", lambda *_: {"mean": 0.1, "novel_light": value})
    monkeypatch.setattr(type(task), "looks", lambda *_: {})
    store = Store(tmp_path / "b.json", SETTINGS)
    assert jobs.run([jobs.FitJob("methods", "direct", DirectConfig(), task, 0.1, 0, ANALYTIC)], store) == {}
    (found,) = read_benchmark(tmp_path / "b.json")["records"]
    assert found["stopped"] == "failed" and "novel_light not finite" in found["why"] and found["errors"] == {}


def test_what_ends_a_warm_up_or_a_job_ends_no_other(monkeypatch, tmp_path):
    task, other = (known_material(f"builtin:{name}", 16, GRID, ANALYTIC) for name in ("inlay", "leather"))
    figures = {"seconds": 0.1, "wall": 0.2, "iterations": 3, "stopped": "budget", "why": None,
               "errors": {"mean": 0.1}}

    def broken(job, *_):
        if job.task is task:
            raise RuntimeError("out of memory")
        return figures

    monkeypatch.setattr(jobs.FitJob, "warm_up", lambda job: broken(replace(job, task=task)))
    monkeypatch.setattr(jobs.FitJob, "run", broken)
    todo = [jobs.FitJob("methods", "direct", DirectConfig(), each, 0.1, 0, ANALYTIC) for each in (task,
                                                                                                  other)]
    store = Store(tmp_path / "b.json", SETTINGS)
    assert jobs.run(todo, store) == {todo[0].title: "RuntimeError: out of memory"}
    assert [r["name"] for r in store.records] == ["leather"]


def test_novel_light_stands_where_no_photo_had_it():
    views = replace(GRID, size=2.0, camera=GRID.camera * 2, light=GRID.light * 2)
    lit = novel_views(views)
    assert lit.size == 1.0 and torch.equal(lit.camera, torch.tensor([[0.0, 0.0, 2.0]],
                                                                    dtype=torch.float64).expand(8, 3))
    tilt = torch.rad2deg(torch.acos(lit.light[:, 2] / lit.light.norm(dim=1)))
    assert torch.allclose(tilt, torch.tensor([25.0] * 4 + [50.0] * 4, dtype=torch.float64))
    assert float(torch.rad2deg(torch.acos(views.light[:, 2] / views.light.norm(dim=1))).max()) < 20


def test_novel_light_error_of_two_flat_greys_is_that_of_their_lambert_shading():
    def grey(rho):
        maps = dict(make_material("inlay", 8).maps)
        up = torch.tensor([0.0, 0.0, 1.0]).expand(8, 8, 3).contiguous()
        return type(make_material("inlay", 8))("roughconductor", maps | {
            "diffuse": torch.full((8, 8, 3), rho), "specular": torch.zeros(8, 8, 3), "normal": up})
    error, squares = novel_light_rmse(grey(0.2), grey(0.5), GRID), []
    for light, power in zip(novel_views(GRID).light.tolist(), [math.pi * 4] * 8):
        for i in range(8):
            for j in range(8):
                x, y = (j + 0.5) / 8 - 0.5, 0.5 - (i + 0.5) / 8
                d2 = (light[0] - x) ** 2 + (light[1] - y) ** 2 + light[2] ** 2
                shown = [(rho / math.pi * power * light[2] / d2**1.5) ** (1 / 2.2) for rho in (0.2, 0.5)]
                squares.append((shown[0] - shown[1]) ** 2)
    # float32 rendering; measured 1e-7
    assert error == pytest.approx(math.sqrt(sum(squares) / len(squares)), rel=1e-5)


def test_photos_4_and_7_are_left_out(tmp_path):
    shots = photos_of(make_material("inlay", 16))
    write_capture(shots, tmp_path / "shots")
    task = real_capture(tmp_path / "shots", 16)
    assert task.photos.index == (0, 1, 2, 3, 5, 6, 8) and task.unseen.index == (4, 7) and task.name == "shots"
    found = task.errors(fit(task.photos, ANALYTIC, DirectConfig(iterations=2)))
    assert set(found) == {"seen", "left_out"} and found["seen"] != found["left_out"]
    assert task.key == {"kind": "capture", "name": "shots", "left_out": [4, 7]}
    write_capture(shots.pick([0, 1]), tmp_path / "two")
    assert real_capture(tmp_path / "two", 16).unseen is None
    stated = json.loads((tmp_path / "shots/capture.json").read_text())
    (tmp_path / "shots/capture.json").write_text(json.dumps(stated | {"idx": [4, 7]}))
    with pytest.raises(ConfigError, match="besides"):
        real_capture(tmp_path / "shots", 16)


def test_flip_of_pictures_is_that_of_each_beside_its_own(tmp_path):
    flip_evaluator = pytest.importorskip("flip_evaluator")
    write_capture(photos_of(make_material("inlay", 16)), tmp_path / "shots")
    task = real_capture(tmp_path / "shots", 16)
    found = fit(task.photos, ANALYTIC, DirectConfig(iterations=2))
    looks = task.looks(found)
    assert set(looks) == {"flip_seen", "flip_left_out"}
    images, _ = found.predict(task.unseen)
    shown = images.clamp(0, 1) ** (1 / 2.2)
    each = [flip_evaluator.evaluate(photo.numpy(), image.contiguous().numpy(), "LDR")[1]
            for photo, image in zip(task.unseen.photos, shown)]
    # photos there and back; measured 3e-7
    assert looks["flip_left_out"] == pytest.approx(sum(each) / len(each), abs=1e-4)
    known = known_material("builtin:inlay", 16, GRID, ANALYTIC)
    exact = known.looks(replace(fit(known.photos, ANALYTIC, DirectConfig(iterations=1)), svbrdf=known.truth))
    assert exact["flip_novel_light"] == 0 < exact["flip_photos"]


def test_known_materials_are_judged_as_evaluate_judges_them(tmp_path):
    from mitsvbrdf.evaluate import evaluate_maps

    save_maps(make_material("leather", 32), tmp_path / "leather")
    task = known_material(str(tmp_path / "leather"), 16, GRID, ANALYTIC)
    assert task.photos.resolution == 16 and task.truth.resolution == 32
    found = fit(task.photos, ANALYTIC, DirectConfig(iterations=2))
    errors = task.errors(found)
    assert {k: errors[k] for k in ("diffuse", "roughness", "mean")} == {
        k: v for k, v in evaluate_maps(found.svbrdf, tmp_path / "leather").items() if k in ("diffuse",
                                                                                            "roughness", "mean")}
    assert errors["photos"] == found.rmse and errors["novel_light"] > 0


def test_published_numbers_are_those_of_the_same_photos(tmp_path):
    shots = photos_of(make_material("inlay", 16))
    write_capture(shots, tmp_path / "cards")
    save_maps(make_material("leather", 16), tmp_path / "leather")
    tasks = [real_capture(tmp_path / "cards", 16), known_material(str(tmp_path / "leather"), 16, GRID,
                                                                  ANALYTIC),
             known_material("builtin:inlay", 16, GRID, ANALYTIC)]
    maps = {"diffuse": 0.01, "specular": 0.02, "roughness": 0.03, "normal": 0.06}
    stated = {"materials": {"leather": {"materialgan": maps}, "inlay": {"materialgan": maps}},
              "captures": {"cards": {"per_view": [0.1, 0.2, 0.1, 0.1, 0.3, 0.1, 0.1, 0.4, 0.2]}}}
    (tmp_path / "peers.json").write_text(json.dumps(stated))
    found = published(tmp_path / "peers.json", tasks, 256)
    # a made inlay is another
    assert found["material"] == {"leather": {"MaterialGAN": maps | {"mean": pytest.approx(0.03)}}}
    assert found["capture 4,7"]["cards"]["MaterialGAN"] == {"seen": pytest.approx(math.sqrt(0.13 / 7)),
                                                        "left_out": pytest.approx(math.sqrt(0.25 / 2))}
    assert set(found["capture 4,7"]["cards"]) == {"MaterialGAN"}
    stated["captures"]["cards"]["left_out_7_8_rmse_256"] = {"gao2019": 0.5}
    (tmp_path / "peers.json").write_text(json.dumps(stated))
    blind = published(tmp_path / "peers.json", [real_capture(tmp_path / "cards", 16, (7, 8))],
                      256)["capture 7,8"]["cards"]
    # fitted to photos 0 to 6, as fits here are then
    assert blind["Gao 2019 without them"] == {"left_out": 0.5}
    assert blind["MaterialGAN"]["left_out"] == pytest.approx(math.sqrt((0.16 + 0.04) / 2))
    assert published(tmp_path / "peers.json", tasks, 128) == {"material": {}}  # numbers of another size
    assert published(tmp_path / "none.json", tasks, 256) == {"material": {}}
    (tmp_path / "peers.json").write_text('{"materials": []}')
    with pytest.raises(ConfigError, match="peers.json"):
        published(tmp_path / "peers.json", tasks, 256)
