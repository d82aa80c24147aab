"""The fits: they find a known material, resume bit by bit, survive Ctrl-C and steps that go wrong."""

import dataclasses
import math
import signal
from types import SimpleNamespace

import pytest
import torch
from helpers import ANALYTIC, GRID, MITSUBA, photos_of
from helpers.variants import mostly_slow

from mitsvbrdf.capture import Capture
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import FitTask, GanConfig, fit_svbrdf, gan_config, make_method, pretrain
from mitsvbrdf.fit.checkpoint import load_tensors
from mitsvbrdf.fit.config import DirectConfig, HierarchicalConfig, HybridConfig
from mitsvbrdf.fit.detail_config import DetailConfig
from mitsvbrdf.fit.loop import Loop
from mitsvbrdf.fit.method import descend
from mitsvbrdf.fit.start import robust_start
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import CHANNELS, flat
from mitsvbrdf.measure.metrics import map_rmse
from mitsvbrdf.render import make_renderer

SMALL = {"hybrid": HybridConfig(width=8), "direct": DirectConfig(), "gan": GanConfig(width=8),
         "gan, one stage": GanConfig(width=8, preset="paper-one-stage"),
         "gan, two stages": GanConfig(width=8, preset="paper-two-stage")}
# Of 64 px there are two phases; the second begins at iteration 10 of 24, the checkpoint is from iteration 5
# or 13.
RESUMED = {name: (config, 32, 13) for name, config in SMALL.items()} | {
    "gan, grown": (GanConfig(width=4, pictures=2), 64, 13),
    "gan, before it grows": (GanConfig(width=4, pictures=2), 64, 5),
    "gan, crops": (GanConfig(width=4, crop=16, features=1.0, paired=True), 32, 13)}


def with_limits(config, **limits):
    return type(config)(**{**vars(config), **limits})


def loop_of(capture, config):
    return Loop(make_method(FitTask(capture, ANALYTIC, config, torch.full((32, 32, 3), 0.3))))


@pytest.mark.parametrize("method", mostly_slow(SMALL, "direct", "hybrid", "gan"))
@pytest.mark.parametrize("bsdf", mostly_slow(CHANNELS, "roughconductor"))
def test_every_method_through_mitsuba(method, bsdf, leather):
    result = fit_svbrdf(leather, make_renderer("mitsuba"),
                        with_limits(SMALL[method], iterations=12, bsdf=bsdf))
    result.svbrdf.check()
    assert result.stopped == "iterations" and result.variant == "llvm_ad_rgb" and result.omitted
    assert [entry["iteration"] for entry in result.trace] == [0, 10, 12]
    assert all(math.isfinite(v) for entry in result.trace for v in entry.values())
    assert result.rerender_rmse == min(entry["rerender_rmse"] for entry in result.trace)
    assert "rerender_rmse" in result.trace[-1] and "diffuse" in result.trace[-1] or method == "direct"


@pytest.mark.parametrize("method", mostly_slow(["hierarchical", *SMALL], "direct"))
def test_every_method_through_float64(method, leather):
    config = with_limits((SMALL | {"hierarchical": HierarchicalConfig()})[method], iterations=1)
    result = fit_svbrdf(leather, make_renderer("analytic64"), config)
    assert result.renderer == "analytic64" and math.isfinite(result.rerender_rmse)


def test_direct_recovers_what_its_photos_show():
    # A rough material with relief, seen from nine sides: 150 steps take the diffuse error to 0.02 and the
    # normals' to 0.01 (measured 0.010 and 0.006); the start alone has 0.05 in the normals.
    truth = make_material("leather", 32)
    capture = photos_of(truth)
    result = fit_svbrdf(capture, make_renderer("mitsuba"), DirectConfig(iterations=150))
    errors = map_rmse(result.svbrdf, truth)
    start = map_rmse(robust_start(capture, result.guess, "roughconductor"), truth)
    assert errors["diffuse"] < 0.02 and errors["normal"] < 0.02 and errors["normal"] < 0.5 * start["normal"]


@pytest.mark.slow
def test_hybrid_improves_on_its_start(capture):
    result = fit_svbrdf(capture, make_renderer("mitsuba"), HybridConfig(width=8, iterations=60))
    assert result.rerender_rmse < 0.6 * result.trace[0]["rerender_rmse"]


@pytest.mark.slow
def test_hybrid_finds_the_flash_beside_the_lens():
    # The calibration claims light at the camera; the photos were lit from 0.1 patch sides to the left.
    lit = dataclasses.replace(GRID, light=GRID.light + torch.tensor([-0.1, 0.0, 0.0]))
    photos = photos_of(flat(32, diffuse=0.2, specular=0.3, roughness=0.3), lit).photos
    result = fit_svbrdf(Capture(photos, GRID), make_renderer("mitsuba"),
                        HybridConfig(width=8, iterations=150))
    assert result.flash_offset[0] < -0.05 and abs(result.flash_offset[1]) < 0.03


@pytest.mark.parametrize("method", mostly_slow(RESUMED, "direct"))
def test_resume_is_bit_equal(method, tmp_path, monkeypatch):
    monkeypatch.setattr(gan_config, "SMALLEST", 32)
    config, side, saved_at = RESUMED[method]
    capture, renderer, config = photos_of(make_material("inlay", side)), MITSUBA, with_limits(config,
                                                                                              iterations=24)
    whole = fit_svbrdf(capture, renderer, config, checkpoint=tmp_path / "whole.safetensors")

    class Stop(Exception):
        pass

    def crash(entry, share):
        if entry["iteration"] == 20:
            raise Stop

    # A run that dies at iteration 20 with its last checkpoint from an earlier one, and one that goes on from
    # there.
    loop = Loop(make_method(FitTask(capture, renderer, config, whole.guess)), tmp_path / "c.safetensors")
    step = loop.method.step

    def saving_step(progress):
        if loop.iteration == saved_at:
            loop.save()
        return step(progress)

    loop.method.step, loop.report = saving_step, crash
    with pytest.raises(Stop):
        loop.run()
    resumed = fit_svbrdf(capture, renderer, config, resume=tmp_path / "c.safetensors",
                         checkpoint=tmp_path / "resumed.safetensors")
    for name, value in whole.svbrdf.maps.items():
        assert torch.equal(value, resumed.svbrdf[name]), name
    assert [e["rerender_rmse"] for e in whole.trace] == [e["rerender_rmse"] for e in resumed.trace]
    # The best state may be an early one: the last, with all that a checkpoint holds, is the same too.
    ends = [load_tensors(tmp_path / f"{name}.safetensors")[0] for name in ("whole", "resumed")]
    assert ends[0].keys() == ends[1].keys()
    for name, value in ends[0].items():
        assert torch.equal(value, ends[1][name]), name


def test_ctrl_c_keeps_the_best_result(capture, tmp_path):
    # a shell's background job has it ignored
    before = signal.signal(signal.SIGINT, signal.default_int_handler)

    def interrupt(entry, share):
        if entry["iteration"] == 10:
            signal.raise_signal(signal.SIGINT)

    result = fit_svbrdf(capture, make_renderer("mitsuba"), HybridConfig(width=8, iterations=1000),
                        report=interrupt, checkpoint=tmp_path / "c.safetensors")
    assert result.stopped == "interrupted" and result.trace[-1]["iteration"] < 30
    assert load_tensors(tmp_path / "c.safetensors")[1]["iteration"] == result.trace[-1]["iteration"]
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


def test_budget_in_seconds(capture):
    loop = loop_of(capture, DirectConfig(budget=1.0))
    # The last measurement may be a moment older than the end of the budget.
    assert loop.run() == "budget" and loop.seconds >= 1.0 >= loop.trace[-2]["seconds"]


@pytest.mark.parametrize("iterations", [10, 12])  # the last measurement is due there, or made at the end
def test_seconds_count_the_last_measurement(iterations, capture, monkeypatch):
    loop, looks = loop_of(capture, DirectConfig(iterations=iterations)), []
    look = loop._look
    monkeypatch.setattr("mitsvbrdf.fit.loop.time", SimpleNamespace(perf_counter=lambda: float(len(looks))))
    loop._look = lambda whole=False: (looks.append(whole), look(whole))[1]
    loop.run()
    assert loop.trace[-1]["seconds"] == loop.seconds == len(looks)


@pytest.mark.parametrize("method", ["hybrid", "direct", "gan"])
def test_step_sizes_are_cut_until_the_fit_stays_finite(method, capture):
    # Steps fail until the step size is below an eighth: it has to be cut four times, also when resumed off
    # the beat.
    loop = loop_of(capture, with_limits(SMALL[method], iterations=3))
    loop.iteration = 1
    step, cut, cuts = loop.method.step, loop.method.cut_step, []
    loop.method.cut_step = lambda: (cut(), cuts.append(1))
    loop.method.step = lambda p: step(p) if loop.method.pace < 1 / 8 else {"photometric": math.nan}
    loop.run()
    assert len(cuts) == len(loop.undone) == 4 and loop.method.pace == 1 / 16


def test_torchs_own_random_numbers_are_left_alone(capture):
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    fit_svbrdf(capture, ANALYTIC, HybridConfig(width=8, iterations=1))
    assert torch.equal(torch.rand(4), expected)


def test_no_step_is_made_along_a_gradient_that_is_not_finite():
    parameter = torch.zeros(3, requires_grad=True)
    optimizer = torch.optim.Adam([parameter])
    assert math.isnan(descend(torch.sqrt(parameter).sum(), optimizer))  # the value is 0, its slope infinite
    assert torch.equal(parameter.detach(), torch.zeros(3))
    assert descend((parameter - 1).square().sum(), optimizer) == 0 and (parameter > 0).all()


def test_a_fit_that_stays_broken_ends_with_one_error(capture):
    loop = loop_of(capture, DirectConfig(iterations=30))
    loop.method.step = lambda progress: {"photometric": math.nan}
    with pytest.raises(ConfigError, match="stays finite"):
        loop.run()


def test_pretrained_generator_is_taken_over(capture, tmp_path):
    renderer, path = make_renderer("mitsuba"), tmp_path / "g.safetensors"
    pretrain(capture, renderer, GanConfig(width=8, preset="paper-one-stage", iterations=3), path)
    config = GanConfig(width=8, preset="paper-two-stage", pretrained=str(path), iterations=1)
    method = make_method(FitTask(capture, renderer, config, torch.zeros(32, 32, 3)))
    saved = load_tensors(path)[0]
    for name, value in method.generator.state_dict().items():
        assert torch.equal(value, saved[f"method.generator.{name}"])
    assert [phase.photos for phase in method.phases] == [None]
    with pytest.raises(ConfigError, match="width 16"):
        make_method(FitTask(capture, renderer, with_limits(config, width=16), torch.zeros(32, 32, 3)))


def test_resume_refuses_another_fit(capture, tmp_path):
    path, renderer = tmp_path / "c.safetensors", ANALYTIC
    fit_svbrdf(capture, renderer, DirectConfig(iterations=2), checkpoint=path)
    darker = capture.photos.clone()
    darker[3] *= 0.5
    others = [(photos_of(make_material("tiles", 32)), {}, "photo 00, .* 5 more"), (capture.pick([0, 1]), {},
              "photo 02"), (dataclasses.replace(capture, photos=darker), {}, "photo 03"),
              (dataclasses.replace(capture, transfer="srgb"), {}, "--transfer"), (capture, {"seed": 1},
              "--seed"), (capture, {"smooth": 0.5}, "--smooth")]
    for shots, change, named in others:
        with pytest.raises(ConfigError, match=f"made with: {named}"):
            fit_svbrdf(shots, renderer, DirectConfig(iterations=4, **change), resume=path)
    fit_svbrdf(capture, renderer, DirectConfig(iterations=4), resume=path)
    with pytest.raises(ConfigError, match="Hybrid"):
        fit_svbrdf(capture, renderer, HybridConfig(iterations=4), resume=path)


@pytest.mark.parametrize("kind, settings, said", [
    (HierarchicalConfig, {"seed": "x"}, "seed"), (HybridConfig, {"budget": "10"}, "budget"),
    (HierarchicalConfig, {"fix": (1,)}, "fix"), (GanConfig, {"fix": 5}, "fix"),
    (GanConfig, {"preset": []}, "preset"), (DetailConfig, {"steps": "x"}, "steps"),
    (DirectConfig, {"budget": -1}, "> 0"), (DirectConfig, {"budget": 0}, "> 0"),
    (DirectConfig, {"iterations": 0}, "> 0"), (DirectConfig, {"budget": math.nan}, "> 0"),
    (HybridConfig, {"photometric": 0, "adversarial": 0}, "looks at the photos"),
    (DirectConfig, {"photometric": 0}, "looks at the photos"),
    (HybridConfig, {"grey_specular": True, "bsdf": "principled"}, "grey-specular"),
    (HybridConfig, {"grey_specular": True, "fix": ("specular=0.04",)}, "grey-specular"),
    (GanConfig, {"game": "rpgan"}, "relativistic"), (GanConfig, {"generator": "unet"}, "two-stream"),
    (GanConfig, {"adversarial": 0.0, "features": 0.0, "diffuse": 0.0, "smooth": 0.0}, "a loss"),
    (GanConfig, {"crop": 4}, "crop of 16"), (GanConfig, {"normal_roughness_steps": 5}, "two-stream"),
    (GanConfig, {"pictures": 0}, "pictures > 0"), (GanConfig, {"preset": "hours"}, "minutes"),
    (GanConfig, {"preset": "paper-two-stage", "generator": "all-photos", "normal_roughness_steps": 1},
     "--generator two-stream"), (GanConfig, {"preset": "paper-two-stage", "grow": True}, "growing"),
    (GanConfig, {"preset": "paper-one-stage", "flash_offset": True}, "--flash-offset"),
    (GanConfig, vars(GanConfig()) | {"preset": "paper-one-stage"}, "anew instead of replace")])
def test_wrong_settings_are_one_error(kind, settings, said):
    with pytest.raises(ConfigError, match=said):
        kind(**settings).check()


def test_presets_are_the_papers():
    one, two = GanConfig(preset="paper-one-stage"), GanConfig(preset="paper-two-stage")
    assert one.limited(64).iterations == 20_000 and two.limited(4096).iterations == 25_000
    assert dataclasses.replace(two, pretrained="x").limited(64).iterations == 15_000
    assert GanConfig().limited(64).budget == 300 and GanConfig().limited(4096).budget == 1200
    for paper in (one, two):
        assert (paper.width, paper.learning_rate, paper.discriminator_rate) == (64, 2e-5, 2e-5)
        assert (paper.normal_roughness_steps, paper.pictures, paper.game, paper.guess) == (5, 1, "bce", "min")
        assert paper.grey_specular and paper.falloff == "none" and paper.holds_views
        assert (paper.smooth, paper.adversarial, paper.begins) == (0, 1, "untrained")
        assert not any((paper.paired, paper.grow, paper.features, paper.crop, paper.flash_offset))
    assert [(round(p.share, 9), p.photos) for p in two.phases(256)] == [(0.4, 1), (0.6, None)]
    assert GanConfig(preset="paper-one-stage", width=8).width == 8  # what is given stays


def test_only_the_papers_first_stage_is_pretrained(capture, tmp_path):
    for wrong, said in ((GanConfig(), "preset minutes"),
                        (GanConfig(preset="paper-one-stage", learning_rate=-1.0), "learning_rate > 0"),
                        (GanConfig(preset="paper-two-stage", pretrained="a.pt"), "a.pt")):
        with pytest.raises(ConfigError, match=said):
            pretrain(capture, ANALYTIC, dataclasses.replace(wrong, iterations=1), tmp_path / "first.pt")


@pytest.mark.parametrize("n, config", [(1, HierarchicalConfig), (9, HierarchicalConfig), (9, DirectConfig)])
def test_a_capture_of_one_texel(n, config):
    texel = photos_of(flat(1, diffuse=0.3)).pick(range(n))
    assert fit_svbrdf(texel, ANALYTIC, config(iterations=6)).rerender_rmse < 0.01
