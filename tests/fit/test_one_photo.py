"""One photo of a material that repeats itself: the test of it, its look classes, and the fit."""

import math
from dataclasses import replace

import pytest
import torch

from mitsvbrdf.capture import Capture, read_capture
from mitsvbrdf.color import to_display
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.evaluate.placement import named_views
from mitsvbrdf.fit import DirectConfig, FitTask, GanConfig, HierarchicalConfig, fit_svbrdf, make_method
from mitsvbrdf.fit.diagnose import about_views, views_record
from mitsvbrdf.fit.look_classes import LookClasses, Pixels, Posterior, material
from mitsvbrdf.fit.one_photo import OnePhoto, nodes
from mitsvbrdf.fit.repeats import repeats, unlike
from mitsvbrdf.io.images import write_png
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.measure.metrics import map_rmse
from mitsvbrdf.render import make_renderer
from mitsvbrdf.synth import photograph
from mitsvbrdf.views import Views, default_views

VIEW = Views.of([[0.0, 0.0, 1.2]], [[0.05, 0.0, 1.2]], math.pi * 1.44)


def photo_of(diffuse, side=32):
    """A photo of a matt material, diffuse R x R."""
    maps = flat(side).maps | {"diffuse": diffuse[..., None].expand(-1, -1, 3).contiguous()}
    return photograph(SVBRDF("roughconductor", maps), VIEW, make_renderer("analytic"))


def photo_of_noise(side=32):
    """A photo of a material that repeats itself: random texels."""
    return photo_of(0.2 + 0.3 * torch.rand(side, side, generator=torch.Generator().manual_seed(0)), side)


def bumpy_metal(side):
    """A metal without a diffuse colour, whose normals are random."""
    slopes = 0.08 * torch.randn(side, side, 2, generator=torch.Generator().manual_seed(0))
    normal = torch.nn.functional.normalize(torch.nn.functional.pad(slopes, (0, 1), value=1.0), dim=-1)
    maps = flat(side, specular=0.35, roughness=0.28, diffuse=0.0).maps | {"normal": normal}
    return SVBRDF("roughconductor", maps)


def test_random_texels_repeat_and_a_ramp_does_not():
    found = repeats(photo_of_noise())
    # 64 ranks a block, each of variance 1/12: 1/64 of it lies between blocks by chance
    assert found.stationary and found.between == pytest.approx(1 / 64, abs=0.02)
    ramp = repeats(photo_of(torch.linspace(0.1, 0.6, 32).expand(32, 32)))
    assert not ramp.stationary and ramp.between > 0.5
    assert "not taken" in ramp.said() and "taken" in found.said()
    assert repeats(photo_of(torch.linspace(0.1, 0.6, 32).expand(32, 32)), asked=True).stationary


def test_a_material_of_one_look_is_met_where_the_flash_stands_aside():
    """The renderer is another implementation of the same model: what it renders is met."""
    maps = flat(16, specular=0.3, roughness=0.4, diffuse=0.2)
    dim = replace(VIEW, intensity=VIEW.intensity / 5)  # nothing is clipped
    photo = Capture(make_renderer("analytic").render(maps, dim), dim, "linear")
    assert photo.photos.max() < 0.9
    numbers = LookClasses.start(torch.full((5, 3), 0.2 ** (1 / 2.2)), 0.4, 0.3, [0.1] * 5)
    classes, pixels = LookClasses(numbers, dim, True), Pixels.of(photo)
    still = torch.zeros(len(pixels.at), 1000, 3)  # of so many, each stands for next to nothing but itself
    found = classes.posterior(pixels, still)
    # Schlick's F0 without its rise, and cosines to the half vector: 0.05 sides aside they differ by 1e-3
    assert (found.diffuse - 0.2).abs().max() < 4e-3
    numbers = LookClasses.start(torch.full((5, 3), 0.2 ** (1 / 2.2)), 0.5, 0.3, [0.1] * 5)
    other = LookClasses(numbers, dim, True)
    assert other.posterior(pixels, still).likely.mean() < found.likely.mean() - 1


def test_nodes_are_standard_normal_numbers():
    drawn = nodes(64, 64, 0)
    assert drawn.mean().abs() < 0.02 and drawn.std() == pytest.approx(1, abs=0.05)
    assert not torch.equal(drawn[0], drawn[1])


@pytest.mark.slow
def test_the_fit_goes_on_from_its_state_bit_by_bit(monkeypatch):
    monkeypatch.setattr("mitsvbrdf.fit.one_photo.TRIED", 2)
    monkeypatch.setattr("mitsvbrdf.fit.one_photo.ITERATIONS", 2)
    task = FitTask(photo_of_noise(), make_renderer("analytic"), HierarchicalConfig())
    whole, parts = make_method(task), make_method(task)
    assert isinstance(whole, OnePhoto)
    for step in range(12):
        whole.step(0.0)
        parts.step(0.0)
        if step in (3, 6, 7, 9, 10):
            other = make_method(task)
            other.load_state(parts.state())
            parts = other
    assert torch.equal(whole.numbers, parts.numbers) and not whole.done
    for name, value in whole.estimate()[0].maps.items():
        assert torch.equal(value, parts.estimate()[0][name]) and torch.isfinite(value).all()


def test_the_start_that_is_likeliest_after_a_second_descent_is_taken(monkeypatch):
    costs = iter((5, 3, 4, 9, math.nan, 7, 6, 3, 2, 2.5, 0))  # starts 1, 2 and 0 descend once more
    monkeypatch.setattr(OnePhoto, "_descents", lambda *_: next(costs))
    method = make_method(FitTask(photo_of_noise(), make_renderer("analytic"), HierarchicalConfig()))
    starts = method.tried.clone()
    assert all(math.isfinite(method.step(0.0)["cost"]) for _ in range(11))  # else the loop takes all back
    assert torch.equal(method.numbers, starts[2]) and not torch.equal(starts[2], starts[1])


def test_asked_for_or_not_the_method_follows(tmp_path):
    photo, renderer = photo_of_noise(), make_renderer("analytic")
    assert not FitTask(photo, renderer, HierarchicalConfig(stationary=False)).repeats.stationary
    for asked in (None, False, True):
        task = FitTask(photo, renderer, HierarchicalConfig(calibrate=asked))
        assert make_method(task).held == (asked is not True, True)  # the light power stays as stated
    for config in (HierarchicalConfig(fix=("roughness=0.5",)), HierarchicalConfig(bsdf="principled")):
        assert FitTask(photo, renderer, config).repeats is None
        with pytest.raises(ConfigError, match="--stationary"):
            fit_svbrdf(photo, renderer, replace(config, stationary=True))


def test_gan_has_no_game_of_one_photo_and_ends_with_its_looks(monkeypatch):
    monkeypatch.setattr("mitsvbrdf.fit.one_photo.TRIED", 2)
    monkeypatch.setattr("mitsvbrdf.fit.one_photo.ITERATIONS", 2)
    photo, renderer = photo_of_noise(), make_renderer("mitsuba")
    looks, gan = (fit_svbrdf(photo, renderer, config(iterations=4))
                  for config in (HierarchicalConfig, GanConfig))
    assert all(torch.equal(value, gan.svbrdf[name]) for name, value in looks.svbrdf.maps.items())
    assert gan.record["repeats"] == looks.record["repeats"] and gan.method == "gan"
    assert any(each.what == "the game" for each in gan.omitted)


def test_a_photo_is_rendered_from_where_the_fit_found_the_camera(tmp_path):
    write_png(tmp_path / "a.png", photo_of(torch.rand(32, 32)).photo(0))
    fit = fit_svbrdf(read_capture(tmp_path / "a.png"), make_renderer("analytic"), DirectConfig(iterations=1))
    moved = fit.views.carried(torch.tensor([0.1, 0.0, 0.1]))
    assert torch.equal(named_views(str(tmp_path / "a.png"), "inverse-square", fit.but(views=moved))[1].camera,
                       moved.camera)
    assert "refined" in about_views(views_record(fit.known["shots"], moved, None, None, None))


@pytest.mark.parametrize("config", [HierarchicalConfig(stationary=True, iterations=1),
                                    HierarchicalConfig(stationary=False, iterations=1),
                                    DirectConfig(iterations=1)])
def test_what_one_photo_hardly_tells_is_said_once(config, monkeypatch):
    monkeypatch.setattr("mitsvbrdf.fit.one_photo.TRIED", 1)
    said = fit_svbrdf(photo_of_noise(), make_renderer("analytic"), config).warnings
    assert sum("one photo" in warning for warning in said) == 1


def test_a_usual_f0_is_surer_beforehand_and_those_of_metals_are_alike():
    looks = torch.full((5, 3), 0.3)
    usual, odd, dull, bright = (float(LookClasses(LookClasses.start(looks, 0.4, f0, [0.1] * 5), VIEW,
                                                  True).prior()) for f0 in (0.04, 0.12, 0.4, 0.8))
    assert usual > odd + 5 and dull > odd + 5 and dull == pytest.approx(bright, abs=0.01)


def test_texels_that_are_alike_everywhere_are_even_however_few_are_drawn(monkeypatch):
    classes = LookClasses(LookClasses.start(torch.full((5, 3), 0.3), 0.4, 0.04, [0.1] * 5), VIEW, True)
    random, found = torch.Generator().manual_seed(0), []
    for _ in range(50):
        texels, at = (torch.randn(512, size, generator=random) for size in (10, 2))
        monkeypatch.setattr(LookClasses, "texels", staticmethod(lambda *_, texels=texels: texels))
        uneven, chance = classes.uneven(None, at)
        found.append(float(uneven - chance))
    assert abs(sum(found) / 50) < 0.015  # its deviation is 0.004; means of rings alone differ by 0.16
    monkeypatch.setattr(LookClasses, "texels", staticmethod(lambda *_: texels + at.norm(dim=1)[:, None]))
    assert classes.uneven(None, at)[0] > 1


@pytest.mark.slow
def test_a_metal_of_which_one_photo_is_clipped_stays_black():
    """The tail of its highlight tells its level; a diffuse colour explains that nearly as well."""
    truth = bumpy_metal(48)
    photo = photograph(truth, VIEW, make_renderer("analytic"))
    assert (photo.photos == 1).float().mean() > 0.01
    config = HierarchicalConfig(stationary=True, budget=1200)  # so that a busy machine tries all starts
    found = map_rmse(fit_svbrdf(photo, make_renderer("analytic"), config).svbrdf, truth)
    # measured with three seeds: 0.017 to 0.024 and 0.009 to 0.033; without metals for a start 0.091 and 0.199
    assert found["diffuse"] < 0.06 and found["specular"] < 0.05


@pytest.mark.parametrize("power", [0.5, 1.0, 3.0])
def test_the_likelihood_is_a_density_of_what_the_photo_shows(power):
    """So that no light is likelier for making what is shown a small share of it; a matt texel's is normal."""
    lit = replace(VIEW, intensity=VIEW.intensity * power)
    pixels = Pixels.of(photo_of(torch.rand(8, 8, generator=torch.Generator().manual_seed(0)), 8))
    classes = LookClasses(LookClasses.start(torch.full((5, 3), 0.5), 0.4, 1e-6, [0.1] * 5), lit, True)
    found = classes.posterior(pixels, torch.zeros(64, 1, 3)).likely[:, 0, 0]
    half, white = (value.double() for value in classes.lit(pixels.at))
    cosine = (1 / (1 + half.square().sum(dim=1, keepdim=True)).sqrt())
    mean, along = white * cosine * 0.5**2.2, white * cosine * 0.5**2.2 * float(classes.lightness[0])
    tint = white * cosine * 2.2 * float(classes.tint[0]) * 0.5**1.2
    spread = torch.diag_embed(tint**2 + pixels.noise.double() ** 2) + along[:, :, None] * along[:, None]
    exact = torch.distributions.MultivariateNormal(mean, spread).log_prob(pixels.shown.double())
    exact = exact + 1.5 * math.log(2 * math.pi) - math.log(5)
    torch.testing.assert_close(found.double(), exact, rtol=2e-3, atol=0.02)


@pytest.mark.parametrize("misses, taken", [((0.3, 0.1, 0.2), 1), ((0.3, 0.2, 0.1), 2),
                                           ((0.3, 0.16, 0.16), 0)])
def test_lobes_are_as_wide_as_the_photo_asks_for(misses, taken, monkeypatch):
    told = iter(misses)
    monkeypatch.setattr("mitsvbrdf.fit.one_photo.unlike", lambda *_: next(told))
    method = make_method(FitTask(photo_of_noise(8), make_renderer("analytic"),
                                 HierarchicalConfig(stationary=True)))
    method.done_steps = 10**6
    texels, lost = torch.full((64, 10), 0.5), torch.full((64,), 0.01)
    found = method._widened(texels, lost, VIEW)["roughness"]
    assert torch.equal(found, material(texels, taken * lost, 8)["roughness"])


@pytest.mark.parametrize("falloff", ["inverse-square", "none"])
def test_the_views_found_give_the_light_of_the_classes(falloff):
    photo = photo_of_noise(8).but(views=replace(default_views(1), falloff=falloff), calibration="none")
    method = make_method(FitTask(photo, make_renderer("analytic"), HierarchicalConfig(stationary=True)))
    method.done_steps = 10**6
    with torch.no_grad():
        method.numbers += 0.2  # so that the place and the power of the flash change
    half, white = LookClasses(method.numbers.detach(), method.views, False).lit(method.pixels.at)
    found = LookClasses(method.numbers.detach(), method.estimate()[1], True).lit(method.pixels.at)
    torch.testing.assert_close((half, white), found)


@pytest.mark.slow
def test_place_and_height_of_the_flash_come_from_the_photo():
    random = 0.2 + 0.3 * torch.rand(64, 64, generator=torch.Generator().manual_seed(0))
    maps = dict(flat(64, roughness=0.4).maps) | {"diffuse": random[..., None].expand(-1, -1, 3).contiguous()}
    seen = Views.of([[0.12, -0.08, 0.7]], intensity=math.pi * 0.6)
    shot = photograph(SVBRDF("roughconductor", maps), seen, make_renderer("analytic"))
    alone = Capture(shot.photos, default_views(1), "gamma2.2", calibration="none")
    assert repeats(alone).stationary and not repeats(alone.but(calibration="given")).stationary
    found = fit_svbrdf(alone, make_renderer("analytic"), HierarchicalConfig()).views.camera[0]
    assert (found - seen.camera[0]).abs().max() < 0.05  # begins 0.17 too high, above the middle


def test_maps_laid_elsewhere_are_compared_with_the_photo():
    """Equal texels give the photo again; of half the albedo, each pixel is 0.5^(1/2.2) of it."""
    renderer = make_renderer("analytic")
    grey, dim = (flat(32, specular=0.0, diffuse=level) for level in (0.4, 0.2))
    photo = Capture(to_display(renderer.render(grey, VIEW), "gamma2.2"), VIEW, "gamma2.2")
    assert unlike(grey, VIEW, photo, renderer) < 1e-6
    less = (1 - 0.5 ** (1 / 2.2)) * float(photo.photos.square().mean().sqrt())
    assert unlike(dim, VIEW, photo, renderer) == pytest.approx(less, rel=1e-4)


def test_lobes_take_the_slopes_that_means_lack():
    """Of a pixel that tells nothing, they are those of its class; a lobe of alpha 0.09 and they make 0.17."""
    classes = LookClasses(LookClasses.start(torch.full((5, 3), 0.5), 0.3, 0.04, [0.1] * 5), VIEW, True)
    slopes = 0.1 * nodes(4, 64, 0)[:, None, :, :2].expand(4, 5, 64, 2)
    found = Posterior(torch.zeros(4, 5, 64), slopes, torch.full((4, 5, 64), 0.3), torch.zeros(4, 5, 64, 3))
    lost = classes.lost(found)
    assert lost == pytest.approx(torch.full((4,), 0.01), rel=0.1)
    roughness = material(classes.texels(found, classes.specular), lost, 2)["roughness"]
    assert roughness.square() == pytest.approx(torch.full((2, 2, 1), (0.09**2 + 0.02) ** 0.5), rel=0.05)


def test_few_nodes_tell_the_likelihood_of_a_narrow_lobe():
    """Many nodes are the integral, whatever a node stands for."""
    pixels = Pixels.of(photograph(bumpy_metal(16), VIEW, make_renderer("analytic")))
    classes = LookClasses(LookClasses.start(torch.full((5, 3), 0.002), 0.28, 0.35, [0.08] * 5), VIEW, True)
    few, many = (float(classes.posterior(pixels, nodes(len(pixels.at), count, 0)).likely.flatten(1)
                       .logsumexp(1).mean()) for count in (16, 2048))
    assert few == pytest.approx(many, abs=0.3)  # .13; 4 where a node stands for itself alone


def test_light_without_a_channel_is_no_look(monkeypatch):
    monkeypatch.setattr("mitsvbrdf.fit.one_photo.TRIED", 1)
    red = replace(VIEW, intensity=VIEW.intensity * torch.tensor([1.0, 0.0, 0.0]))
    photo = photograph(flat(8, diffuse=0.3), red, make_renderer("analytic"))
    fitted = fit_svbrdf(photo, make_renderer("analytic"), HierarchicalConfig(stationary=True, iterations=8))
    assert fitted.rerender_rmse < 0.05 and not fitted.record.get("undone")
