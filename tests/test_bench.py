"""The benchmark: what is measured, counted, kept and shown, against hand-computed numbers and independent loops; no times."""

import copy
import json
import math
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import pytest
import torch

from mitsvbrdf import cli
from mitsvbrdf.bench import jobs, methods, plots, renderers, summary
from mitsvbrdf.bench.methods import VARIANTS, fit, method_table, settings_of, variant_table
from mitsvbrdf.bench.page import write_benchmark_page
from mitsvbrdf.bench.peers_baseline import PeersBaseline, PeersConfig
from mitsvbrdf.bench.published import published
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.stiff import cameras_off
from mitsvbrdf.bench.store import Store
from mitsvbrdf.bench.tables import equal_error, equal_time
from mitsvbrdf.bench.tasks import known_material, novel_light_rmse, novel_views, real_capture
from mitsvbrdf.capture import write_capture
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import DirectConfig, GanConfig, HierarchicalConfig, HybridConfig, config, fit_svbrdf
from mitsvbrdf.fit.loop import Loop
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.render import make_renderer
from mitsvbrdf.render.scene import SceneRenderer
from mitsvbrdf.synth.photograph import photograph
from mitsvbrdf.views import nine_view_grid

ANALYTIC = make_renderer("analytic")
SETTINGS = {"resolution": 16, "views": "builtin:grid", "renderer": "analytic", "variant": "llvm_ad_rgb", "quick": False}
TINY = ["bench", "--renderer", "analytic", "--materials", "inlay", "--captures", "none", "--resolution", "16", "--budgets",
        "0.1,0.2", "--seeds", "0,1"]


def record(method="hybrid", budget=10.0, seed=0, name="a", kind="material", suite="methods", seconds=None, **errors):
    return {"suite": suite, "method": method, "kind": kind, "name": name, "budget": budget, "seed": seed, "config": {},
            "seconds": budget if seconds is None else seconds, "wall": budget + 1, "iterations": 5, "stopped": "budget",
            "why": None, "errors": errors}


def timing(median):
    return {"median": median, "low": median * 0.9, "high": median * 1.2, "repeats": 3}


def case(truth="texels", resolution=64, views=9, skipped=()):
    samples = (1,) if truth == "texels" else (4, 16)
    rows = [{"renderer": name, "samples": n, "image": 1e-7 * n, "gradient": 2e-7, "forward": timing(0.01 * n),
             "both": timing(0.03)} for name in ("mitsuba", "mitsuba-scene") for n in ((1,) if name == "mitsuba" else samples)]
    return {"suite": "renderers", "bsdf": "principled", "resolution": resolution, "views": views, "truth": truth,
            "config": {"samples": [], "repeats": 3}, "rows": rows, "skipped": list(skipped)}


def benchmark(records, given=None):
    return {"schema_version": 1, "settings": SETTINGS | {"code": "0123456789ab"}, "machine": {"cores": 2, "system": "Linux"},
            "versions": {"mitsuba": "3.9", "torch": None}, "seeds": sorted({r["seed"] for r in records if "seed" in r}),
            "published": given or {}, "records": records}


# ------------------------------------------------------------------------------------------------------ the peers' baseline
def test_peers_baseline_is_plain_adam_on_clamped_gamma_values():
    views = nine_view_grid().pick([0, 2, 5])
    capture = photograph(make_material("inlay", 8), views, ANALYTIC)
    method, config = PeersBaseline(capture, ANALYTIC, PeersConfig()), PeersConfig()
    losses = [method.step(k / 6)["l2"] for k in range(6)]

    # The same by hand: gamma-encoded maps on [-1, 1], 9 channels in one tensor, and torch's Adam.
    start = torch.cat((torch.full((8, 8, 3), 0.0), torch.full((8, 8, 3), 2 * 0.04 - 1), torch.full((8, 8, 1), 2 * 0.2 - 1),
                       torch.zeros(8, 8, 2)), dim=-1)
    textures = start.clone().requires_grad_()
    adam, expected = torch.optim.Adam([textures], lr=0.01), []
    for _ in range(6):
        diffuse, specular, roughness = (((textures + 1) / 2) ** 2.2)[..., :7].split((3, 3, 1), dim=-1)
        x, y = textures[..., 7], textures[..., 8]
        normal = torch.stack((x, y, (1 - x**2 - y**2).sqrt()), dim=-1)
        maps = {"diffuse": diffuse, "specular": specular, "roughness": roughness, "normal": normal}
        rendered = ANALYTIC.render(type(make_material("inlay", 8))("roughconductor", maps), views)
        loss = ((rendered.clamp(1e-6, 1) ** (1 / 2.2) - capture.photos) ** 2).mean()
        expected.append(float(loss.detach()))
        adam.zero_grad()
        loss.backward()
        adam.step()
    assert config.iterations == 1000
    assert losses == pytest.approx(expected, rel=1e-5)  # measured: the same bits
    assert losses[-1] < 0.99 * losses[0]
    found = method.estimate()[0]
    assert float((found["diffuse"] - diffuse.detach()).abs().max()) < 0.01  # one step apart, 0.005 encoded; measured 0.0051


def test_peers_baseline_goes_on_bit_by_bit_and_stays_in_range():
    capture = photograph(make_material("tiles", 8), nine_view_grid(), ANALYTIC)
    method = PeersBaseline(capture, ANALYTIC, PeersConfig(learning_rate=0.7))  # large steps, so that every bound is met
    for _ in range(5):
        method.step(0.0)
    state = method.state()
    after = [method.step(0.0)["l2"] for _ in range(2)]
    method.load_state(state)
    assert [method.step(0.0)["l2"] for _ in range(2)] == after
    method.estimate()[0].check()
    for name in ("diffuse", "specular", "roughness"):
        assert float(method.textures[name].detach().abs().max()) <= 1
    with pytest.raises(ConfigError, match="principled"):
        PeersConfig(bsdf="principled").check()


# ------------------------------------------------------------------------------------------------------------------- methods
def test_the_table_has_every_method_and_preset():
    table = method_table(config.CONFIGS)
    assert {"hierarchical", "hybrid", "direct", "gan-one-stage", "gan-two-stage", "peers-baseline"} <= set(table)
    assert next(iter(table)) == next(iter(config.CONFIGS))  # the default first
    assert table["gan-two-stage"].preset == "paper-two-stage"
    assert "seed" not in settings_of(HybridConfig()) and settings_of(HybridConfig()) == json.loads(
        json.dumps(settings_of(HybridConfig())))


def test_every_variant_is_one_of_the_default_method():
    default = next(iter(method_table(config.CONFIGS).values()))
    table = variant_table(default, VARIANTS)
    assert list(table) == ["full", *VARIANTS]
    for name, changes in VARIANTS.items():
        assert table[name] != default and {key: getattr(table[name], key) for key in changes} == changes
    with pytest.raises(ConfigError, match="no_such_setting"):
        variant_table(default, {"wrong": {"no_such_setting": 1}})
    with pytest.raises(ConfigError, match="tails >= 0"):
        variant_table(default, {"wrong": {"tails": -1.0}})


@pytest.mark.slow
def test_every_ingredient_changes_real_fits_and_two_of_them_exact_ones(monkeypatch):
    # What ablation.py says. The largest change of a map's value was 0.01 or more, and exactly 0 where it must be.
    monkeypatch.setattr("mitsvbrdf.fit.hierarchical.highlights.CHANCE", 0.0)  # there is hardly any burn-in to take out of these maps

    def maps(shots, config):
        return torch.cat(list(fit_svbrdf(shots, ANALYTIC, config).svbrdf.maps.values()), dim=-1)

    full, off = HierarchicalConfig(iterations=12), cameras_off(16).capture
    whole = maps(off, full)
    for name, changes in VARIANTS.items():
        assert (maps(off, replace(full, **changes)) - whole).abs().max() > 1e-3, name
    both = {"materials", "neighbours"}
    assert [set(changes) <= both for changes in VARIANTS.values()] == [True, True] + [False] * (len(VARIANTS) - 2)
    exact = photograph(make_material("inlay", 16), nine_view_grid(), ANALYTIC)
    others = {key: value for changes in VARIANTS.values() for key, value in changes.items() if key not in both}
    assert torch.equal(maps(exact, replace(full, **others)), maps(exact, full))


@pytest.mark.parametrize("config", [DirectConfig(iterations=2), GanConfig(iterations=1, width=8), PeersConfig(iterations=2)])
def test_one_fit_of_each_kind(config):
    shots = photograph(make_material("inlay", 16), nine_view_grid(), ANALYTIC)
    found = fit(shots, ANALYTIC, config)
    assert found.iterations == config.iterations and found.stopped == "iterations" and 0 < found.seconds <= found.wall
    # What it predicts for the photos it saw is the error of the fit, whatever light the method takes for granted.
    assert found.predict(shots) == pytest.approx(found.rmse, rel=1e-6)
    falloff = "none" if isinstance(config, GanConfig) else "inverse-square"
    assert methods.as_lit(shots, config).views.falloff == falloff


@pytest.mark.parametrize("config", [DirectConfig(), GanConfig(width=8), PeersConfig()])
def test_a_fit_without_a_step_is_no_result(config, monkeypatch):
    # As where the budget is over before the first step, on any machine.
    monkeypatch.setattr(Loop, "_limit_reached", lambda loop: "budget")
    task = known_material("builtin:inlay", 16, nine_view_grid(), ANALYTIC)
    found = jobs.FitJob("methods", "any", config, task, 0.1, 0, ANALYTIC).run()
    assert found["stopped"] == "failed" and "longer budget" in found["why"] and found["errors"] == {}


def test_a_fit_that_cannot_be_done_is_a_record(monkeypatch):
    def refused(*_, **__):
        raise ConfigError("a fit that stays finite", "none", "lower the learning rate")
    monkeypatch.setattr(jobs, "fit", refused)
    task = known_material("builtin:inlay", 16, nine_view_grid(), ANALYTIC)
    job = jobs.FitJob("methods", "direct", DirectConfig(), task, 0.1, 0, ANALYTIC)
    found = job.key | {"config": job.settings} | job.run()
    assert found["stopped"] == "failed" and "stays finite" in found["why"] and found["errors"] == {}
    check_benchmark(benchmark([found]), "here")
    assert summary.curves([found], "mean") == {} and summary.failures([found]) == [found]


# --------------------------------------------------------------------------------------------------------------------- tasks
def test_novel_light_stands_where_no_photo_had_it():
    views = replace(nine_view_grid(), size=2.0, camera=nine_view_grid().camera * 2, light=nine_view_grid().light * 2)
    lit = novel_views(views)
    assert lit.size == 1.0 and torch.equal(lit.camera, torch.tensor([[0.0, 0.0, 2.0]], dtype=torch.float64).expand(8, 3))
    tilt = torch.rad2deg(torch.acos(lit.light[:, 2] / lit.light.norm(dim=1)))
    assert torch.allclose(tilt, torch.tensor([25.0] * 4 + [50.0] * 4, dtype=torch.float64))
    assert float(torch.rad2deg(torch.acos(views.light[:, 2] / views.light.norm(dim=1))).max()) < 20


def test_novel_light_error_of_two_flat_greys_is_that_of_their_lambert_shading():
    def grey(rho):
        maps = dict(make_material("inlay", 8).maps)
        up = torch.tensor([0.0, 0.0, 1.0]).expand(8, 8, 3).contiguous()
        return type(make_material("inlay", 8))("roughconductor", maps | {
            "diffuse": torch.full((8, 8, 3), rho), "specular": torch.zeros(8, 8, 3), "normal": up})
    error, squares = novel_light_rmse(grey(0.2), grey(0.5), nine_view_grid()), []
    for light, power in zip(novel_views(nine_view_grid()).light.tolist(), [math.pi * 4] * 8):
        for i in range(8):
            for j in range(8):
                x, y = (j + 0.5) / 8 - 0.5, 0.5 - (i + 0.5) / 8
                d2 = (light[0] - x) ** 2 + (light[1] - y) ** 2 + light[2] ** 2
                shown = [(rho / math.pi * power * light[2] / d2**1.5) ** (1 / 2.2) for rho in (0.2, 0.5)]
                squares.append((shown[0] - shown[1]) ** 2)
    assert error == pytest.approx(math.sqrt(sum(squares) / len(squares)), rel=1e-5)  # float32 rendering; measured 1e-7


def test_photos_4_and_7_are_left_out(tmp_path):
    shots = photograph(make_material("inlay", 16), nine_view_grid(), ANALYTIC)
    write_capture(shots, tmp_path / "shots")
    task = real_capture(tmp_path / "shots", 16)
    assert task.photos.index == (0, 1, 2, 3, 5, 6, 8) and task.left_out.index == (4, 7) and task.name == "shots"
    found = task.errors(fit(task.photos, ANALYTIC, DirectConfig(iterations=2)))
    assert set(found) == {"seen", "left_out"} and found["seen"] != found["left_out"]
    write_capture(shots.pick([0, 1]), tmp_path / "two")
    assert real_capture(tmp_path / "two", 16).left_out is None
    stated = json.loads((tmp_path / "shots/capture.json").read_text())
    (tmp_path / "shots/capture.json").write_text(json.dumps(stated | {"idx": [4, 7]}))
    with pytest.raises(ConfigError, match="besides"):
        real_capture(tmp_path / "shots", 16)


def test_known_materials_are_judged_as_evaluate_judges_them(tmp_path):
    from mitsvbrdf.evaluate import evaluate_maps

    save_maps(make_material("leather", 32), tmp_path / "leather")
    task = known_material(str(tmp_path / "leather"), 16, nine_view_grid(), ANALYTIC)
    assert task.photos.resolution == 16 and task.truth.resolution == 32
    found = fit(task.photos, ANALYTIC, DirectConfig(iterations=2))
    errors = task.errors(found)
    assert {k: errors[k] for k in ("diffuse", "roughness", "mean")} == {
        k: v for k, v in evaluate_maps(found.svbrdf, tmp_path / "leather").items() if k in ("diffuse", "roughness", "mean")}
    assert errors["photos"] == found.rmse and errors["novel_light"] > 0


# ----------------------------------------------------------------------------------------------------------------- published
def test_published_numbers_are_those_of_the_same_photos(tmp_path):
    shots = photograph(make_material("inlay", 16), nine_view_grid(), ANALYTIC)
    write_capture(shots, tmp_path / "cards")
    save_maps(make_material("leather", 16), tmp_path / "leather")
    tasks = [real_capture(tmp_path / "cards", 16), known_material(str(tmp_path / "leather"), 16, nine_view_grid(), ANALYTIC),
             known_material("builtin:inlay", 16, nine_view_grid(), ANALYTIC)]
    maps = {"diffuse": 0.01, "specular": 0.02, "roughness": 0.03, "normal": 0.06}
    stated = {"materials": {"leather": {"materialgan": maps}, "inlay": {"materialgan": maps}},
              "captures": {"cards": {"per_view": [0.1, 0.2, 0.1, 0.1, 0.3, 0.1, 0.1, 0.4, 0.2]}}}
    (tmp_path / "peers.json").write_text(json.dumps(stated))
    found = published(tmp_path / "peers.json", tasks, 256)
    assert found["material"] == {"leather": {"MaterialGAN": maps | {"mean": pytest.approx(0.03)}}}  # a made inlay is another
    assert found["capture"]["cards"]["MaterialGAN"] == {"seen": pytest.approx(math.sqrt(0.13 / 7)),
                                                        "left_out": pytest.approx(math.sqrt(0.25 / 2))}
    assert published(tmp_path / "peers.json", tasks, 128) == {"material": {}, "capture": {}}  # numbers of another size
    assert published(tmp_path / "none.json", tasks, 256) == {"material": {}, "capture": {}}
    (tmp_path / "peers.json").write_text('{"materials": []}')
    with pytest.raises(ConfigError, match="peers.json"):
        published(tmp_path / "peers.json", tasks, 256)


# ----------------------------------------------------------------------------------------------------------------- renderers
def test_the_truth_of_whole_pixels_is_their_average():
    svbrdf, views = make_material("inlay", 8), renderers.spread_views(2)
    image, gradients = renderers.exact(svbrdf, views, renderers.POINTS_A_SIDE)
    twin, k = make_renderer("analytic64"), 48
    fine = svbrdf.map(lambda t: t.repeat_interleave(k, 0).repeat_interleave(k, 1))
    brute = twin.render(fine, views).reshape(2, 8, k, 8, k, 3).mean(dim=(2, 4))
    centres = twin.render(svbrdf, views)
    off = float(((image - brute) / brute).abs().mean())
    # Measured: texel centres 9.5e-3 off, so 48 x 48 points, of second order, 9.5e-3 / 48^2 = 4.1e-6 themselves; found 4.2e-6.
    assert off < 1e-5 and float(((centres - brute) / brute).abs().mean()) > 1000 * off
    assert gradients["roughness"].shape == (8, 8, 1) and float(gradients["roughness"].abs().max()) > 0


def test_texel_centres_are_those_of_all_views_at_once():
    svbrdf, views = make_material("tiles", 8), renderers.spread_views(3)
    image, gradients = renderers.exact(svbrdf, views, (1,))
    from mitsvbrdf.measure.gradients import render_and_gradients
    whole = render_and_gradients(make_renderer("analytic64"), svbrdf, views)
    assert torch.equal(image, whole.image)
    for name, value in gradients.items():  # float64 sums in another order; measured 4e-16
        assert torch.allclose(value, whole.gradients[name], rtol=1e-12, atol=1e-12)


def test_jittered_rays_come_closer_to_whole_pixels():
    svbrdf, views = make_material("inlay", 16), renderers.spread_views(2)
    image, _ = renderers.exact(svbrdf, views, renderers.POINTS_A_SIDE)
    drawn = [SceneRenderer(samples=n).render(svbrdf, views) for n in (1, 4, 64)]
    one, few, many = (float(((picture - image) / image).abs().mean()) for picture in drawn)
    assert many < few / 8  # stratified: the error goes down as the number of rays goes up, 16 times; measured 18
    assert few > one  # noise: four rays in a grid would be four times better than the centre alone; measured 4 times worse
    with pytest.raises(ConfigError, match="samples"):
        SceneRenderer(samples=10)


def test_a_case_has_every_renderer_and_says_who_sat_out(monkeypatch):
    job = renderers.RenderJob("roughconductor", 16, 2, (1, 4), repeats=1)
    found = job.key | {"config": job.settings} | job.run()
    check_benchmark(benchmark([found]), "here")
    names = [(row["renderer"], row["samples"]) for row in found["rows"]]
    assert names == [("analytic64", 1), ("analytic", 1), ("mitsuba", 1), ("mitsuba-scene", 1), ("mitsuba-scene", 4)]
    centres = {row["image"] for row in found["rows"] if row["samples"] == 1}
    assert max(centres) / min(centres) < 1.01  # against whole pixels all centres are off alike
    job = renderers.RenderJob("principled", 16, 2, repeats=1)
    rows = {row["renderer"]: row for row in job.run()["rows"]}
    # The twin is itself but for the order of its sums; float32 within the tolerances of the cross-check.
    assert rows["analytic64"]["image"] == 0 and rows["analytic64"]["gradient"] < 1e-14
    assert all(0 < rows[name]["image"] < 5e-7 and rows[name]["gradient"] < 2e-6 for name in rows if name != "analytic64")
    monkeypatch.setattr(renderers, "memory_available", lambda: 100 * 16 * 16 * 2)
    assert [s["renderer"] for s in job.run()["skipped"]] == ["analytic64", "analytic", "mitsuba-scene"]


def test_the_cases_cover_sizes_views_and_samples():
    jobs = renderers.render_jobs((64, 256, 512), (1, 9, 16), (1, 4), 3)
    seen = {(j.bsdf, j.resolution, j.views, j.samples) for j in jobs}
    assert len(jobs) == len(seen) == 2 * (3 + 2 + 1)
    assert {(64, 9), (256, 9), (512, 9), (256, 1), (256, 16)} == {(r, v) for _, r, v, s in seen if not s}
    assert {(64, 9, (1, 4))} == {(r, v, s) for _, r, v, s in seen if s}


# ------------------------------------------------------------------------------------------------------------------- summary
TWO = [record("hybrid", b, s, n, mean=e) for b, s, n, e in (
    (10.0, 0, "a", 0.30), (10.0, 0, "b", 0.10), (10.0, 1, "a", 0.20), (10.0, 1, "b", 0.10), (10.0, 2, "a", 0.50),
    (10.0, 2, "b", 0.30), (30.0, 0, "a", 0.08), (30.0, 0, "b", 0.04), (30.0, 1, "a", 0.02))]


def test_curves_are_medians_over_seeds_of_means_over_materials():
    ten, thirty = summary.curves(TWO, "mean")["hybrid"]
    # Seeds: 0.20, 0.15, 0.40; their inclusive quartiles are 0.175 and 0.30.
    assert (ten.median, ten.low, ten.high, ten.seeds) == pytest.approx((0.20, 0.175, 0.30, 3))
    # Seed 1 has no record of b at 30 s and does not count.
    assert (thirty.median, thirty.seeds) == (pytest.approx(0.06), 1)
    assert [p.median for p in summary.curves(TWO, "mean", ["a"])["hybrid"]] == pytest.approx([0.30, 0.05])
    assert summary.curves(TWO, "specular") == {}


def test_seconds_are_the_loops_own():
    fits = [record("peers-baseline", 100.0, s, n, seconds=t, mean=0.1) for s, n, t in (
        (0, "a", 40.0), (0, "b", 44.0), (1, "a", 50.0), (1, "b", 52.0), (2, "a", 10.0), (2, "b", 20.0))]
    assert summary.curves(fits, "mean")["peers-baseline"][0].seconds == 42.0  # of 42, 51 and 15


def test_first_below_and_published_means():
    points = summary.curves(TWO, "mean")["hybrid"]
    assert summary.first_below(points, 0.1).budget == 30.0 and summary.first_below(points, 0.3).budget == 10.0
    assert summary.first_below(points, 0.06) is None
    given = {"material": {"a": {"X": {"mean": 0.1}, "Y": {"mean": 0.3}}, "b": {"X": {"mean": 0.3}}}}
    assert summary.published_mean(given, "material", ["a", "b"], "mean") == {"X": pytest.approx(0.2)}
    assert summary.with_published(given, "material", ["a", "b"], "Y", "mean") == ["a"]
    assert summary.published_mean({}, "material", ["a"], "mean") == {}


def test_differences_are_paired():
    fits = [record(m, 10.0, s, n, suite="ablation", mean=e) for m, s, n, e in (
        ("full", 0, "a", 0.10), ("full", 1, "a", 0.20), ("full", 0, "b", 0.50),
        ("less", 0, "a", 0.11), ("less", 1, "a", 0.25), ("less", 0, "b", 0.49), ("less", 1, "b", 9.0))]
    found = summary.differences(fits, "mean")["less"][10.0]  # +0.01, +0.05, -0.01; the last has no partner
    assert (found["median"], found["low"], found["high"]) == pytest.approx((0.01, 0.0, 0.03))
    assert found["repeats"] == 3


# ------------------------------------------------------------------------------------------------------- tables and pictures
METHODS = [record(m, b, s, n, k, **{e: base * (30 / b) ** 0.5 * (1 + s / 10) * (1.5 if n == "b" else 1)
                                     for e in (("mean", "novel_light", "diffuse", "specular", "roughness", "normal", "photos")
                                               if k == "material" else ("seen", "left_out"))})
           for m, base in (("hybrid", 0.05), ("direct", 0.08), ("peers-baseline", 0.2)) for b in (10.0, 30.0) for s in (0, 1, 2)
           for k in ("material", "capture") for n in ("a", "b")]
GIVEN = {"material": {"a": {"MaterialGAN": {"mean": 0.06}}}, "capture": {n: {"MaterialGAN": {"seen": 0.01, "left_out": 0.02}}
                                                                        for n in ("a", "b")}}


def test_tables_show_the_medians_and_mark_the_lowest():
    table = equal_time(benchmark(METHODS, GIVEN))[0]
    # hybrid at 30 s: 0.05, 0.055, 0.06 times the mean of 1 and 1.5.
    cells = {row[0]: row[1:] for row in table.rows}
    assert table.heads == ["", "10 s", "30 s"] and cells["`hybrid`"][1] == "**0.0688 (0.0656–0.0719)**"
    assert cells["`direct`"][1].startswith("0.1100") and "MaterialGAN, published" not in cells  # it is known of a alone
    seen = next(t for t in equal_time(benchmark(METHODS, GIVEN)) if "seen" in t.title)
    assert ["MaterialGAN, published", "", "0.0100"] in seen.rows


def test_equal_error_names_the_shortest_budget():
    material, capture = equal_error(benchmark(METHODS, GIVEN))
    # The baseline ends at 0.2 * 1.1 * 1.25 = 0.275; hybrid has 0.1191 after 10 s, direct 0.1905.
    assert material.heads[1] == "maps, below `peers-baseline` (0.2750)" and material.heads[2].endswith("on a (0.0600)")
    rows = {row[0]: row[1:] for row in material.rows}
    assert rows["`hybrid`"][:2] == ["10 s", "30 s"]  # on a alone: 0.055 after 30 s
    assert rows["`direct`"][:2] == ["10 s", "not in 30 s (best 0.0880)"] and rows["`peers-baseline`"][0] == "–"
    assert {row[0]: row[2] for row in capture.rows}["`hybrid`"] == "not in 30 s (best 0.0688)"


def test_the_page_has_every_section_and_its_pictures(tmp_path):
    ablation = [record(m, 10.0, 0, "a", suite="ablation", mean=e, novel_light=e) for m, e in (("full", 0.1), ("no luck", 0.12))]
    failed = record("direct", 10.0, 5, "a") | {"stopped": "failed", "why": "no step stays finite"}
    memory = {"renderer": "analytic64", "why": "needs about 42 GiB of memory"}
    records = [*METHODS, *ablation, failed, case(), case(resolution=128, skipped=[memory]), case(views=4), case("pixels")]
    content = check_benchmark(benchmark(records, GIVEN), "here")
    paths = write_benchmark_page(tmp_path / "page.md", content)
    text = paths[0].read_text()
    for words in ("## In short", "## Known materials", "## Real captures", "## Renderers", "## Each ingredient off",
                  "## How to reproduce", "--budgets 10,30 --seeds 0,1,2", "code 0123456789ab", "1 fits failed",
                  "no step stays finite", "needs about 42 GiB", "| no luck | 0.1200, +0.0200 |", "lower on 1 of 1 (a)",
                  "lower on 0 of 2, not on a, b"):
        assert words in text, words
    names = {p.name for p in paths[1:]}
    assert names == {f"page-{n}.svg" for n in ("methods", "renderers", "material-mean", "material-novel-light", "capture-seen",
                                               "capture-left-out")}
    for name in names:
        assert f"({name})" in text
        ElementTree.parse(tmp_path / name)  # well-formed
    drawn = (tmp_path / "page-methods.svg").read_text()
    for label in ("hybrid", "MaterialGAN (published)", "MaterialGAN (saw them)"):
        assert f">{label}</text>" in drawn
    write_benchmark_page(tmp_path / "again.md", content)
    assert (tmp_path / "again-methods.svg").read_bytes() == (tmp_path / "page-methods.svg").read_bytes()


def test_curves_are_drawn_at_the_medians():
    drawing = plots.methods_figure(benchmark(METHODS, GIVEN))
    (panel,) = (p for p in drawing.axes if p.get_title(loc="left") == "Error of the maps")
    lines = {tuple(line.get_ydata().round(6)) for line in panel.get_lines()}
    assert (round(0.05 * 3**0.5 * 1.1 * 1.25, 6), 0.06875) in lines  # hybrid
    assert panel.get_xscale() == panel.get_yscale() == "log"


def test_labels_are_pushed_apart_as_little_as_needed():
    assert plots.spaced([0.1, 0.5, 0.9], 0.1) == [0.1, 0.5, 0.9]
    assert plots.spaced([0.5, 0.5, 0.9], 0.1) == pytest.approx([0.45, 0.55, 0.9])
    assert plots.spaced([0.4, 0.45, 0.5], 0.1) == pytest.approx([0.35, 0.45, 0.55])
    assert plots.spaced([], 0.1) == []


# ------------------------------------------------------------------------------------------------------------ schema, store
@pytest.mark.parametrize("spoil, words", [
    (lambda b: b.update(schema_version=2), "version 2"),
    (lambda b: b.pop("machine"), "the fields"),
    (lambda b: b["records"][0].update(seed="0"), "records.0.seed"),
    (lambda b: b["records"][0].update(seed=True), "records.0.seed"),
    (lambda b: b["records"][0].update(kind="photo"), "records.0.kind"),
    (lambda b: b["records"][0]["errors"].update(mean=float("nan")), "records.0.errors.mean"),
    (lambda b: b["records"][0].pop("wall"), "records.0"),
    (lambda b: b["records"][0].update(extra=1), "records.0"),
    (lambda b: b["records"][1]["rows"][0]["both"].pop("low"), "records.1.rows.0.both"),
    (lambda b: b["records"].append(b["records"][0]), "twice"),
    (lambda b: b["records"].append({"suite": "other"}), "records.2"),
    (lambda b: b.update(records={}), "a list"),
    (lambda b: b.update(seeds=[0.5]), "seeds.0"),
])
def test_schema_names_what_is_wrong(spoil, words):
    content = copy.deepcopy(benchmark([record(mean=0.1), case()]))
    assert check_benchmark(content, "here") is content
    spoil(content)
    with pytest.raises(ConfigError, match=words):
        check_benchmark(content, "here")


def test_other_settings_are_refused(tmp_path):
    store = Store(tmp_path / "b.json", SETTINGS)
    store.add(record(mean=0.1))
    assert Store(tmp_path / "b.json", SETTINGS).records == store.records
    with pytest.raises(ConfigError, match="resolution 16"):
        Store(tmp_path / "b.json", SETTINGS | {"resolution": 32})
    assert Store(tmp_path / "b.json", SETTINGS | {"resolution": 32}, overwrite=True).records == []
    for part, name in (("versions", "mitsuba"), ("machine", "cores"), ("settings", "code")):
        content = json.loads((tmp_path / "b.json").read_text())
        content[part][name] = "another"
        (tmp_path / "c.json").write_text(json.dumps(content))
        with pytest.raises(ConfigError, match=f"{name} 'another'"):
            Store(tmp_path / "c.json", SETTINGS)


def test_a_changed_variant_is_measured_anew(tmp_path):
    task = known_material("builtin:inlay", 16, nine_view_grid(), ANALYTIC)
    old, new = ({"full": DirectConfig(), "less": DirectConfig(smooth=smooth)} for smooth in (0.0, 0.005))
    store = Store(tmp_path / "b.json", SETTINGS)
    for job in jobs.fit_jobs("ablation", old, [task], [0.1], [0, 1], ANALYTIC):
        store.add(record(job.method, 0.1, job.seed, "inlay", suite="ablation", mean=0.1) | {"config": job.settings})
    assert store.pending(jobs.fit_jobs("ablation", old, [task], [0.1], [0, 1], ANALYTIC)) == []
    missing = store.pending(jobs.fit_jobs("ablation", new, [task], [0.1], [0], ANALYTIC))
    assert [(job.method, job.seed) for job in missing] == [("less", 0)]
    assert [r["method"] for r in store.records] == ["full", "full"]  # what was measured with the old settings is gone


# -------------------------------------------------------------------------------------------------------------- the command
@pytest.fixture
def out(tmp_path, monkeypatch):
    monkeypatch.delenv("MITSVBRDF_DATA", raising=False)
    return tmp_path / "b.json"


def test_interrupted_runs_go_on_with_the_same_records(out, monkeypatch, capsys):
    arguments = [*TINY, "--suite", "methods", "--methods", "direct,peers-baseline", "--json", str(out)]
    run, count = jobs.FitJob.run, []

    def thrice(job, report):
        count.append(job.title)
        if len(count) == 4:
            raise KeyboardInterrupt
        return run(job, report)

    monkeypatch.setattr(jobs.FitJob, "run", thrice)
    assert cli.main(arguments) == 130
    assert "3 of 8 records are kept" in capsys.readouterr().out
    first = json.loads(out.read_text())
    check_benchmark(first, "here")
    monkeypatch.setattr(jobs.FitJob, "run", run)
    assert cli.main([*arguments, "--page", str(out.with_suffix(".md"))]) == 0
    assert "3 of 8 records are in" in capsys.readouterr().out
    second = check_benchmark(json.loads(out.read_text()), "here")
    assert second["records"][:3] == first["records"] and len(second["records"]) == 8 and second["seeds"] == [0, 1]
    # Methods take turns, seed by seed: what drifts hits all.
    assert [(r["seed"], r["budget"], r["method"]) for r in second["records"]] == [
        (s, b, m) for s in (0, 1) for b in (0.1, 0.2) for m in ("direct", "peers-baseline")]
    for r in second["records"]:
        assert set(r["errors"]) == {"diffuse", "specular", "roughness", "normal", "mean", "novel_light", "photos"}
    before = out.read_bytes()
    assert cli.main(arguments) == 0 and "nothing to do" in capsys.readouterr().out and out.read_bytes() == before
    page = out.with_suffix(".md").read_text()
    assert "--materials inlay --captures none --methods direct,peers-baseline --budgets 0.1,0.2 --seeds 0,1" in page


@pytest.mark.slow
def test_quick_measures_everything(out, monkeypatch, tmp_path):
    monkeypatch.setattr(sys.modules["mitsvbrdf.cli.bench"], "QUICK_CASES", {"sizes": (8,), "views": (1,), "samples": ()})
    monkeypatch.setattr("mitsvbrdf.evaluate.bench.ablation.VARIANTS", {"no neighbours": {"neighbours": False}})
    for suite in ("ablation", "all"):
        assert cli.main(["bench", "--quick", "--suite", suite, "--renderer", "analytic", "--resolution", "16", "--budgets",
                         "0.1", "--repeats", "1", "--json", str(out), "--page", str(tmp_path / "p.md")]) == 0
    found = check_benchmark(json.loads(out.read_text()), "here")
    suites = [r["suite"] for r in found["records"]]
    assert suites.count("renderers") == 2 * (1 + 1) and suites.count("ablation") == 2
    assert suites.count("methods") == len(method_table(config.CONFIGS))
    page = (tmp_path / "p.md").read_text()
    for heading in ("## In short", "## Known materials", "## Renderers", "## Each ingredient off"):
        assert heading in page
    assert cli.main(["bench", "--suite", "none", "--json", str(out), "--page", str(tmp_path / "q.md")]) == 0
    assert (tmp_path / "q.md").read_text() == page.replace("p-", "q-")


def test_data_is_found_where_it_is_named(out, monkeypatch, tmp_path):
    shots = photograph(make_material("inlay", 16), nine_view_grid(), ANALYTIC)
    write_capture(shots, tmp_path / "data/captures/cards-blue")
    save_maps(make_material("leather", 16), tmp_path / "data/materials/hide")
    arguments = ["bench", "--suite", "methods", "--methods", "direct", "--renderer", "analytic", "--resolution", "16",
                 "--budgets", "0.1", "--seeds", "0", "--json", str(out)]
    assert cli.main([*arguments, "--data", str(tmp_path / "data")]) == 0
    found = json.loads(out.read_text())
    made = ["inlay", "tiles", "leather", "plates"]
    assert [r["name"] for r in found["records"]] == [*made, "hide", "cards-blue"] and found["settings"]["views"] == "cards-blue"
    monkeypatch.setenv("MITSVBRDF_DATA", str(tmp_path / "data"))
    assert cli.main([*arguments, "--materials", "hide", "--captures", "cards-blue"]) == 0  # all there already
    assert json.loads(out.read_text()) == found


@pytest.mark.parametrize("extra, words", [
    (["--methods", "magic"], "hybrid"), (["--budgets", "10,none"], "--budgets"), (["--budgets", "0"], "--budgets"),
    (["--seeds", "-1"], "--seeds"), (["--seeds", "99999999999"], "seed"), (["--resolution", "4"], "--resolution"),
    (["--materials", "builtin:gold"], "made material"), (["--materials", "nowhere"], "nowhere"),
    (["--captures", "nowhere"], "nowhere"), (["--data", "nowhere"], "nowhere"), (["--views", "nowhere"], "nowhere"),
    (["--materials", "none"], "--materials"), (["--suite", "none"], "--json"), (["--repeats", "0"], "--repeats"),
    (["--materials", "inlay,builtin:inlay"], "inlay twice"), (["--suite", "capture", "--captures", "all"], "none called all"),
])
def test_mistakes_are_one_error(extra, words, out, capsys):
    assert cli.main([*TINY, "--suite", "methods", "--json", str(out), *extra]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and words in message
    assert not out.exists()


def test_a_file_that_is_no_benchmark_is_refused_and_kept(out, capsys):
    for content in ("{", "[]", '{"schema_version": 1}'):
        out.write_text(content)
        assert cli.main([*TINY, "--suite", "methods", "--methods", "direct", "--json", str(out)]) == 2
        assert "--overwrite" in capsys.readouterr().err and out.read_text() == content
