"""The fits: they find a known material, stay in range, resume bit by bit, survive Ctrl-C and steps that go wrong."""

import dataclasses
import json
import math
import os
import signal

import pytest
import torch

from mitsvbrdf import color
from mitsvbrdf.capture import Capture
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import DirectConfig, FitTask, GanConfig, HybridConfig, fit_svbrdf, losses, make_method, pretrain
from mitsvbrdf.fit.checkpoint import load_tensors
from mitsvbrdf.fit.generator.networks import AllPhotosGenerator, PatchDiscriminator, TwoStreamGenerator
from mitsvbrdf.fit.loop import Loop
from mitsvbrdf.fit.method import descend
from mitsvbrdf.fit.parameters import STREAMS, to_raw, to_svbrdf
from mitsvbrdf.fit.start import robust_start
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import CHANNELS, flat
from mitsvbrdf.measure.metrics import map_rmse
from mitsvbrdf.render import make_renderer
from mitsvbrdf.views import nine_view_grid

SMALL = {"hybrid": HybridConfig(width=8), "direct": DirectConfig(), "gan": GanConfig(width=8),
         "gan, two stages": GanConfig(width=8, preset="paper-two-stage")}


def photographed(material, views=None):
    """8-bit photos of a material from nine views."""
    views = views or nine_view_grid()
    photos = color.to_display(make_renderer("analytic").render(material, views))
    return Capture((photos * 255).round() / 255, views)


@pytest.fixture(scope="module")
def capture():
    return photographed(make_material("inlay", 32))


def with_limits(config, **limits):
    return type(config)(**{**vars(config), **limits})


@pytest.mark.parametrize("bsdf", CHANNELS)
def test_parameters_invert_and_stay_in_range(bsdf):
    material = flat(8, bsdf, roughness=0.3)
    back = to_svbrdf(bsdf, to_raw(material))
    for name in material.maps:
        assert torch.allclose(back[name], material[name], atol=2.5e-3), name  # 0 metallic is cut to 0.002
    wild = {name: 100 * torch.randn(c, 8, 8) for name, c in (STREAMS[bsdf][0] | STREAMS[bsdf][1]).items()}
    to_svbrdf(bsdf, wild).check()


def test_start_finds_a_uniform_material():
    # Every texel alike and flat: the search has to find roughness (on its grid) and specular level, the guess the rest.
    truth = flat(24, diffuse=0.3, specular=0.2, roughness=0.35)
    capture = photographed(truth)
    start = robust_start(capture, truth["diffuse"], "roughconductor")
    assert start["roughness"].mean().item() == pytest.approx(0.35)
    assert start["specular"].mean().item() == pytest.approx(0.2, abs=0.01)


def test_clipped_pixels_only_ask_for_at_least_their_value():
    photo = torch.tensor([1.0, 1.0, 0.5]).reshape(1, 1, 1, 3)
    rendered = torch.tensor([4.0, 0.5**2.2, 0.5**2.2]).reshape(1, 1, 1, 3).requires_grad_()
    loss = losses.photometric(rendered, photo, "gamma2.2")
    assert loss.item() == pytest.approx((0.5 + 5 * 0.5**2) / 3, abs=1e-5)  # only the second pixel is off, by 0.5
    (gradient,) = torch.autograd.grad(loss, rendered)
    assert gradient.flatten()[0] == 0 and gradient.flatten()[1] < 0


def test_adversarial_losses_are_cross_entropies():
    real, fake = torch.tensor([0.9, 0.6]), torch.tensor([0.2, 0.3])
    expected = -(math.log(0.9) + math.log(0.6) + math.log(0.8) + math.log(0.7)) / 4
    assert losses.discriminator(real, fake).item() == pytest.approx(expected, rel=1e-5)
    assert losses.adversarial(fake).item() == pytest.approx(-(math.log(0.2) + math.log(0.3)) / 2, rel=1e-5)


def test_input_and_rendering_of_the_gan_show_the_same_blend():
    # Were the generator right, its picture would be the input itself, for one photo and for blends of two.
    truth, views = make_material("inlay", 16), nine_view_grid()
    photos = color.to_display(make_renderer("analytic").render(truth, views))
    gan = make_method(FitTask(Capture(photos, views), make_renderer("analytic"), GanConfig(width=8), truth["diffuse"]))
    seen = set()
    for _ in range(20):
        photo, picked, weights = gan._draw_input()
        seen.add(len(picked))
        assert torch.allclose(gan._picture(truth, picked, weights), photo, atol=1e-4)
    assert seen == {1, 2}


def test_networks_have_the_papers_layers():
    def layers(module, kind):
        return sum(isinstance(m, kind) for m in module.modules())

    g = TwoStreamGenerator(width=8)
    assert layers(g.encoder, torch.nn.Conv2d) == 5
    assert (layers(g.normal_roughness, torch.nn.Conv2d), layers(g.normal_roughness, torch.nn.ConvTranspose2d)) == (1, 3)
    assert (layers(g.diffuse_specular, torch.nn.Conv2d), layers(g.diffuse_specular, torch.nn.ConvTranspose2d)) == (0, 3)
    assert layers(PatchDiscriminator(8), torch.nn.Conv2d) == 5
    assert g.encode(torch.rand(1, 3, 64, 64)).shape[-1] == 8
    probability = PatchDiscriminator(8)(torch.rand(1, 3, 64, 64))
    assert probability.shape[1] == 1 and probability.shape[2] > 1 and 0 < probability.min() and probability.max() < 1


def test_group_norm_with_one_channel_a_group_is_instance_norm():
    x = torch.randn(2, 6, 9, 9)
    assert torch.allclose(torch.nn.GroupNorm(6, 6)(x), torch.nn.InstanceNorm2d(6)(x), atol=1e-5)


@pytest.mark.parametrize("side", [8, 17, 40])
def test_any_size_comes_out_as_it_went_in(side):
    maps = TwoStreamGenerator(width=8)(torch.rand(1, 3, side, side))
    assert maps["normal"].shape == (2, side, side) and maps["diffuse"].shape == (3, side, side)
    changes = AllPhotosGenerator(5, width=8)(torch.rand(1, 5, side, side))
    assert changes["roughness"].shape == (1, side, side) and changes["roughness"].abs().max() == 0


@pytest.mark.parametrize("method", SMALL)
@pytest.mark.parametrize("bsdf", CHANNELS)
def test_every_method_through_mitsuba(method, bsdf, capture):
    result = fit_svbrdf(capture, make_renderer("mitsuba"), with_limits(SMALL[method], iterations=12, bsdf=bsdf))
    result.svbrdf.check()
    assert result.stopped == "iterations" and result.variant == "llvm_ad_rgb" and result.left_out
    assert [entry["iteration"] for entry in result.trace] == [0, 10, 12]
    assert all(math.isfinite(v) for entry in result.trace for v in entry.values())
    assert result.rerender_rmse == min(entry["rerender_rmse"] for entry in result.trace)
    assert "rerender_rmse" in result.trace[-1] and "diffuse" in result.trace[-1] or method == "direct"


def test_direct_recovers_what_its_photos_show():
    # A rough material with relief, seen from nine sides: 150 steps take the diffuse error to 0.02 and the normals' to 0.01
    # (measured 0.010 and 0.006); the start alone has 0.05 in the normals.
    truth = make_material("leather", 32)
    capture = photographed(truth)
    result = fit_svbrdf(capture, make_renderer("mitsuba"), DirectConfig(iterations=150))
    errors = map_rmse(result.svbrdf, truth)
    start = map_rmse(robust_start(capture, result.guess, "roughconductor"), truth)
    assert errors["diffuse"] < 0.02 and errors["normal"] < 0.02 and errors["normal"] < 0.5 * start["normal"]


def test_hybrid_improves_on_its_start(capture):
    result = fit_svbrdf(capture, make_renderer("mitsuba"), HybridConfig(width=8, iterations=60))
    assert result.rerender_rmse < 0.6 * result.trace[0]["rerender_rmse"]


@pytest.mark.slow
def test_hybrid_finds_the_flash_beside_the_lens():
    # The calibration claims light at the camera; the photos were lit from 0.1 patch sides to the left.
    views = nine_view_grid()
    lit = type(views)(views.camera, views.light + torch.tensor([-0.1, 0.0, 0.0]), views.intensity)
    truth = flat(32, diffuse=0.2, specular=0.3, roughness=0.3)
    photos = photographed(truth, lit).photos
    result = fit_svbrdf(Capture(photos, views), make_renderer("mitsuba"), HybridConfig(width=8, iterations=150))
    assert result.flash_offset[0] < -0.05 and abs(result.flash_offset[1]) < 0.03


@pytest.mark.parametrize("method", SMALL)
def test_resume_is_bit_equal(method, capture, tmp_path):
    renderer, config = make_renderer("mitsuba"), with_limits(SMALL[method], iterations=24)
    whole = fit_svbrdf(capture, renderer, config)

    class Stop(Exception):
        pass

    def crash(entry, share):
        if entry["iteration"] == 20:
            raise Stop

    # A run that dies at iteration 20 with its last checkpoint from iteration 13, and one that goes on from there.
    method = make_method(FitTask(capture, renderer, config, whole.guess))
    loop = Loop(method, capture, renderer, config, tmp_path / "c.safetensors")
    step = loop.method.step

    def saving_step(progress):
        if loop.iteration == 13:
            loop.save()
        return step(progress)

    loop.method.step, loop.report = saving_step, crash
    with pytest.raises(Stop):
        loop.run()
    resumed = fit_svbrdf(capture, renderer, config, resume=tmp_path / "c.safetensors")
    for name, value in whole.svbrdf.maps.items():
        assert torch.equal(value, resumed.svbrdf[name]), name
    assert [e["rerender_rmse"] for e in whole.trace] == [e["rerender_rmse"] for e in resumed.trace]


def test_ctrl_c_keeps_the_best_result(capture, tmp_path):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job has it ignored

    def interrupt(entry, share):
        if entry["iteration"] == 10:
            os.kill(os.getpid(), signal.SIGINT)

    result = fit_svbrdf(capture, make_renderer("mitsuba"), HybridConfig(width=8, iterations=1000), report=interrupt,
                        checkpoint=tmp_path / "c.safetensors")
    assert result.stopped == "interrupted" and result.trace[-1]["iteration"] < 30
    assert load_tensors(tmp_path / "c.safetensors")[1]["iteration"] == result.trace[-1]["iteration"]
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


def test_budget_in_seconds(capture):
    renderer, config = make_renderer("analytic"), DirectConfig(budget=1.0)
    loop = Loop(make_method(FitTask(capture, renderer, config, torch.full((32, 32, 3), 0.3))), capture, renderer, config)
    # The last measurement may be a moment older than the end of the budget.
    assert loop.run() == "budget" and loop.seconds >= 1.0 >= loop.trace[-2]["seconds"]


def test_a_step_that_goes_wrong_is_undone(capture):
    renderer, config = make_renderer("analytic"), DirectConfig(iterations=30)
    loop = Loop(make_method(FitTask(capture, renderer, config, torch.full((32, 32, 3), 0.3))), capture, renderer, config)
    step, failures = loop.method.step, iter([True])

    def poisoned(progress):
        if loop.iteration == 15 and next(failures, False):
            loop.method.raw["diffuse"].data.fill_(float("nan"))
            return step(progress)
        return step(progress)

    loop.method.step, peak = poisoned, loop.method.peak
    loop.run()
    assert len(loop.undone) == 1 and loop.iteration == 30 and loop.method.peak == peak / 2
    loop.best[1].check()


@pytest.mark.parametrize("method", ["hybrid", "direct", "gan"])
def test_step_sizes_are_cut_until_the_fit_stays_finite(method, capture):
    # Steps fail until the step size is below an eighth: it has to be cut four times, also when resumed off the beat.
    renderer, config = make_renderer("analytic"), with_limits(SMALL[method], iterations=3)
    loop = Loop(make_method(FitTask(capture, renderer, config, torch.full((32, 32, 3), 0.3))), capture, renderer, config)
    loop.iteration = 1
    step, cut, cuts = loop.method.step, loop.method.cut_step, []
    loop.method.cut_step = lambda: (cut(), cuts.append(1))
    sizes = {"hybrid": lambda m: m.peaks[0], "direct": lambda m: m.peak, "gan": lambda m: m.learning_rate}[method]
    first = sizes(loop.method)
    loop.method.step = lambda p: step(p) if sizes(loop.method) < first / 8 else {"photometric": math.nan}
    loop.run()
    assert len(cuts) == len(loop.undone) == 4 and sizes(loop.method) == first / 16


def test_torchs_own_random_numbers_are_left_alone(capture):
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    fit_svbrdf(capture, make_renderer("analytic"), HybridConfig(width=8, iterations=1))
    assert torch.equal(torch.rand(4), expected)


def test_no_step_is_made_along_a_gradient_that_is_not_finite():
    parameter = torch.zeros(3, requires_grad=True)
    optimizer = torch.optim.Adam([parameter])
    assert math.isnan(descend(torch.sqrt(parameter).sum(), optimizer))  # the value is 0, its slope infinite
    assert torch.equal(parameter.detach(), torch.zeros(3))
    assert descend((parameter - 1).square().sum(), optimizer) == 0 and (parameter > 0).all()


def test_a_fit_that_stays_broken_ends_with_one_error(capture):
    renderer, config = make_renderer("analytic"), DirectConfig(iterations=30)
    loop = Loop(make_method(FitTask(capture, renderer, config, torch.full((32, 32, 3), 0.3))), capture, renderer, config)
    loop.method.step = lambda progress: {"photometric": math.nan}
    with pytest.raises(ConfigError, match="stays finite"):
        loop.run()


def test_pretrained_generator_is_taken_over(capture, tmp_path):
    renderer, path = make_renderer("mitsuba"), tmp_path / "g.safetensors"
    pretrain(capture, renderer, GanConfig(width=8, iterations=3), path)
    config = GanConfig(width=8, preset="paper-two-stage", pretrained=str(path), iterations=1)
    method = make_method(FitTask(capture, renderer, config, torch.zeros(32, 32, 3)))
    saved = load_tensors(path)[0]
    for name, value in method.generator.state_dict().items():
        assert torch.equal(value, saved[f"method.generator.{name}"])
    assert method.stage == 2
    with pytest.raises(ConfigError, match="width 16"):
        make_method(FitTask(capture, renderer, with_limits(config, width=16), torch.zeros(32, 32, 3)))


def test_checkpoints_hold_tensors_only(capture, tmp_path):
    path = tmp_path / "c.safetensors"
    fit_svbrdf(capture, make_renderer("analytic"), DirectConfig(iterations=2), checkpoint=path)
    raw = path.read_bytes()
    header = json.loads(raw[8:8 + int.from_bytes(raw[:8], "little")])  # the whole format: a JSON header and raw numbers
    assert all(set(v) == {"dtype", "shape", "data_offsets"} for k, v in header.items() if k != "__metadata__")
    for bad in (b"", b"not a checkpoint", raw[:100]):
        path.write_bytes(bad)
        with pytest.raises(ConfigError, match="checkpoint"):
            load_tensors(path)


def test_resume_refuses_another_fit(capture, tmp_path):
    path, renderer = tmp_path / "c.safetensors", make_renderer("analytic")
    fit_svbrdf(capture, renderer, DirectConfig(iterations=2), checkpoint=path)
    others = [(photographed(make_material("tiles", 32)), {}), (capture.pick([1, 0, *range(2, 9)]), {}),
              (capture.pick([0, 1]), {}), (dataclasses.replace(capture, transfer="srgb"), {}), (capture, {"seed": 1}),
              (capture, {"smooth": 0.5})]
    for shots, change in others:
        with pytest.raises(ConfigError, match="resume with the same"):
            fit_svbrdf(shots, renderer, DirectConfig(iterations=4, **change), resume=path)
    fit_svbrdf(capture, renderer, DirectConfig(iterations=4), resume=path)
    with pytest.raises(ConfigError, match="Hybrid"):
        fit_svbrdf(capture, renderer, HybridConfig(iterations=4), resume=path)


@pytest.mark.parametrize("wrong", [{"budget": -1.0}, {"iterations": 0}, {"budget": float("nan")}])
def test_limits_are_checked(wrong):
    with pytest.raises(ConfigError, match="> 0"):
        DirectConfig(**wrong).check()


def test_presets_are_the_papers():
    assert GanConfig().limited().iterations == 20_000
    assert GanConfig(preset="paper-two-stage").limited().iterations == 25_000
    assert GanConfig(preset="paper-two-stage", pretrained="x").limited().iterations == 15_000
    assert (GanConfig().learning_rate, GanConfig().normal_roughness_steps) == (2e-5, 5)
