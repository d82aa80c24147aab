"""How far a fit says it may be off, against closed forms, float64 grids and the truth of made materials."""

import dataclasses
import math

import pytest
import torch
from helpers import ANALYTIC, GRID, TWIN, photos_of
from helpers.variants import mostly_slow

from mitsvbrdf import color
from mitsvbrdf.capture import Capture
from mitsvbrdf.fit import DirectConfig, FitTask, HierarchicalConfig, confidence, fit_svbrdf
from mitsvbrdf.fit.confidence import DETERMINED, UNKNOWN, deviations, of_texels, seen_by, shown_texels
from mitsvbrdf.fit.posterior import Mixture, OwnPhotos, masses, with_look_alikes
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF, flat, numbers_of
from mitsvbrdf.synth import photograph
from mitsvbrdf.views import Views

SIDE = 16


def stated(answer, photos, *fix, views=None, grey=False):
    task = FitTask(photos, ANALYTIC, DirectConfig(fix=fix, grey_specular=grey))
    return deviations(answer, views or photos.views, task)[0]


def test_deviation_of_a_matt_texel_in_closed_form():
    # Only diffuse unknown: a display value is u (E / pi)^(1/2.2) with u = rho^(1/2.2), E the irradiance. The
    # deviation of the best u is s (sum_k (E_k / pi)^(2/2.2))^-1/2. Measured: 1.01 times that in the median.
    truth, noise = flat(SIDE, diffuse=0.3, specular=0.0, roughness=1.0), 0.01
    images = color.to_display(TWIN.render(truth, GRID))
    images = images + noise * torch.randn(images.shape, generator=torch.Generator().manual_seed(0),
                                          dtype=torch.float64)
    slope = color.to_display(TWIN.render(flat(SIDE, diffuse=1.0, specular=0.0, roughness=1.0), GRID))
    best = (images * slope).sum(dim=0) / slope.square().sum(dim=0)
    answer = SVBRDF(truth.bsdf, {**truth.maps, "diffuse": color.decode(best).float()})
    found = stated(answer, Capture(images.float(), GRID), "normal=flat", "specular=0", "roughness=1")
    ratio = found["diffuse"] / (noise * slope.square().sum(dim=0) ** -0.5)
    assert 0.93 < float(ratio.median()) < 1.07
    # a texel's own noise of 9 values a channel is known to 14 %
    assert 0.7 < float(ratio.quantile(0.05)) and float(ratio.quantile(0.95)) < 1.4


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_roughness_and_specular_are_as_open_as_a_grid_of_both_says(noise):
    # The likelihood of 200 x 200 values of specular and roughness in float64: each roughness weighs as much
    # as its best specular (a profile), and 68 % of all lie within the deviation.
    rng = torch.Generator().manual_seed(1)
    truth = flat(SIDE, diffuse=0.1, specular=0.3, roughness=0.3)
    images = color.encode(TWIN.render(truth, GRID)).double()
    images += noise * torch.randn(images.shape, generator=rng, dtype=torch.float64)
    photos = images.clamp(0, 1).float()
    found = stated(truth, Capture(photos, GRID), "normal=flat", "diffuse=0.1", grey=True)
    steps = (torch.arange(200, dtype=torch.float64) + 0.5) / 200
    lobes = torch.stack([TWIN.render(flat(SIDE, diffuse=0.0, specular=1.0, roughness=float(r)), GRID)[..., 0]
                         for r in steps])  # camera and light coincide: what is shown is linear in F0
    matt = TWIN.render(flat(SIDE, diffuse=0.1, specular=0.0, roughness=0.3), GRID)[..., 0]
    for row, column in ((2, 3), (6, 9), (8, 8), (12, 12)):
        shown = color.encode(matt[:, row, column, None] + steps**2.2 * lobes[:, :, row, column, None])
        seen = photos[:, row, column].double()[:, None]  # N x 1 x 3
        miss = torch.where((seen >= color.CLIPPED) & (shown[..., None] > seen), 0.0, shown[..., None] - seen)
        logs = -miss.square().sum(dim=(1, 3)) / (2 * noise**2)  # roughness x specular
        likely = logs.softmax(dim=1) * (logs.amax(dim=1, keepdim=True) - logs.max()).exp()
        for name, at, axis in (("roughness", 0.3, 1), ("specular", 0.3 ** (1 / 2.2), 0)):
            mass = likely.sum(dim=axis)
            order = (steps - at).abs().argsort()
            inside = (mass[order].cumsum(0) / mass.sum() < 0.6827).sum()
            wanted = float((steps - at).abs()[order][inside])
            # Measured: 0.75 to 1.63; the noise of a texel's 27 values is known to 14 %.
            assert 0.6 < float(found[name][row, column, 0]) / min(wanted, UNKNOWN) < 1.9, (name, row, column)


def test_views_of_every_kth_texel_show_what_these_texels_show():
    truth = make_material("plates", 30).to(torch.float64)
    views = Views.of([[0.1, 0.2, 1.5], [-0.4, 0.3, 1.2]], [[0.15, 0.2, 1.5], [-0.4, 0.2, 1.3]], math.pi)
    some = truth.map(lambda t: t[2::4, 2::4].contiguous())
    for falloff in ("inverse-square", "none"):
        each = dataclasses.replace(views, falloff=falloff)
        wanted = TWIN.render(truth, each)[:, 2::4, 2::4]
        found = TWIN.render(some, seen_by(each, 30, 4))
        assert (found - wanted).abs().max() < 1e-9 * wanted.abs().max(), falloff


def test_nodes_stand_for_the_integral_of_what_lies_between_them():
    places = torch.tensor([[0.1, 0.15, 0.3, 0.31, 0.7]])
    logs = torch.tensor([[-3.0, 0.0, -1.0, -1.0, -40.0]])
    fine = torch.linspace(0.1, 0.7, 200001, dtype=torch.float64)
    right = torch.searchsorted(places[0].double(), fine).clamp(1, 4)
    at = (fine - places[0, right - 1]) / (places[0, right] - places[0, right - 1])
    density = (logs[0, right - 1] * (1 - at) + logs[0, right] * at).exp()
    wanted = torch.zeros(5, dtype=torch.float64).index_add_(0, right, density * at)
    wanted.index_add_(0, right - 1, density * (1 - at))
    assert (masses(places, logs)[0] - wanted / wanted.sum()).abs().max() < 1e-4


@pytest.mark.parametrize("tau", [0.02, 0.1])
def test_look_alikes_are_known_as_in_a_normal_model(tau):
    # Half of 2,000 texels know their number to 0.05, half to nothing: with mean and deviation of them all
    # known, they are off by (1 / 0.05^2 + 1 / tau^2)^-1/2 and tau.
    rng = torch.Generator().manual_seed(0)
    truth = 0.4 + tau * torch.randn(2000, generator=rng)
    noise = torch.where(torch.arange(2000) % 2 == 0, 0.05, 0.29)
    x = torch.where(noise < 0.1, truth + noise * torch.randn(2000, generator=rng), 0.5)[:, None, None]
    own = Mixture(x, noise.square()[:, None, None, None], torch.ones(2000, 1))
    answer = torch.where(torch.arange(2000) < 1900, 0.4, 0.95)[:, None]
    every = with_look_alikes(own, torch.tensor([0]), torch.ones(2000, 1), 2000, answer)
    # Look-alikes contradict the last hundred answers: what their own photos leave open stays as it was.
    assert every.weight[1900:, 0].max() < 1e-3 and torch.equal(every.x[:, 1], x[:, 0])
    found, truth, noise = Mixture(*(part[:1900] for part in every)), truth[:1900], noise[:1900]
    mean = (found.weight * found.x[..., 0]).sum(dim=1)
    off = found.x[..., 0] - mean[:, None]
    variance = (found.weight * (found.covariance[..., 0, 0] + off.square())).sum(dim=1)
    for some, wanted in ((noise == 0.05, (0.05**-2 + tau**-2) ** -0.5), (noise > 0.05, tau)):
        error = (mean - truth)[some].square().mean().sqrt()
        assert 0.85 < float(error) / wanted < 1.25
        # Measured: 1.0 to 1.76, on the safe side: ten rounds do not end where a small tau is.
        assert 0.8 < float(variance[some].median().sqrt() / error) < 2


def test_two_thirds_of_the_truths_lie_within_the_deviation_of_what_explains_the_photos_best():
    truth = make_material("plates", 48)
    photos = photograph(truth, GRID, ANALYTIC, noise=0.003)
    own = OwnPhotos(truth, photos, ANALYTIC, {}, False)
    answer = own.solver.svbrdf(own.best)
    for name, value in stated(answer, photos).items():
        error = (numbers_of(name, answer[name]) - numbers_of(name, truth[name])).abs()
        assert 0.6 < float((error <= value).float().mean()) < 0.82, name  # measured 69 % to 77 %
        sure, off = of_texels(value) < DETERMINED, of_texels(error) > 3 * of_texels(value)
        assert float((sure & off).sum() / sure.sum()) < 0.02, name


def test_metal_whose_answer_lies_elsewhere_in_the_valley_is_not_determined():
    # The tail of GGX shows F0 alpha^2: half the F0 with a wider lobe makes nearly the same photos. Area
    # averages stated 0.011 for an error of 0.26.
    truth = make_material("inlay", 64)
    photos, metal = photograph(truth, GRID, ANALYTIC, noise=0.003), truth["specular"].mean(dim=-1) > 0.4
    maps = {"specular": truth["specular"] / 2, "roughness": truth["roughness"] * 2**0.25}
    answer = SVBRDF(truth.bsdf, {**truth.maps, **{
        name: torch.where(metal[..., None], value, truth[name]) for name, value in maps.items()}})
    found = stated(answer, photos)["specular"]
    error = of_texels(color.encode(answer["specular"]) - color.encode(truth["specular"]))[metal]
    spread = of_texels(found)[metal]
    assert float((error / spread).median()) < 1.3  # measured 1.0; of averages, 20
    assert float((error > 3 * spread).float().mean()) < 0.02  # measured 0 %
    assert float((spread < DETERMINED).float().mean()) < 0.05  # measured 0 %


def test_an_answer_that_the_photos_refuse_is_not_determined():
    truth = flat(SIDE, diffuse=0.3, specular=0.04, roughness=0.4)
    truth["normal"][8:] = torch.tensor([5.0, 0.0, 1.0]) / 26**0.5  # steep ones are determined too
    photos = photograph(truth, GRID, ANALYTIC, noise=0.003)
    answer = SVBRDF(truth.bsdf, {**truth.maps, "diffuse": truth["diffuse"].clone()})
    answer["diffuse"][:, 8:] *= 1.3
    task = FitTask(photos, ANALYTIC, HierarchicalConfig())
    # by their own photos, and with look-alikes: all texels are of one basis material
    for found in deviations(answer, photos.views, task, torch.zeros(1, 5)):
        assert len(found) == 4 and of_texels(found["normal"])[8:, :8].median() < DETERMINED / 3
        for value in found.values():
            assert of_texels(value)[:, 8:].min() >= DETERMINED


def test_only_texels_that_saw_the_highlight_know_their_roughness():
    # Lights over the left edge: their highlights lie there, and the right half sees only the diffuse colour.
    views = Views.of([[-0.5, 0.0, 1.5], [-0.45, 0.1, 1.5], [-0.4, -0.1, 1.5]], intensity=math.pi * 2.25)
    truth = flat(SIDE, diffuse=0.2, specular=0.04, roughness=0.3)
    found = stated(truth, photograph(truth, views, ANALYTIC, noise=0.01), "normal=flat")["roughness"][..., 0]
    # measured 0.06, and 0.2 or more
    assert found[4:12, :4].median() < 0.12 and found[:, -4:].median() > 0.17
    assert (found <= UNKNOWN).all()


def test_a_lobe_that_no_photo_met_may_be_any_that_looks_like_the_diffuse_colour():
    # Where no photo shows its highlight, a mirror makes the photos of a matt surface that is a little darker:
    # measured, they change by 0.6 of the noise (median) from roughness 0.06 to 0.92 and diffuse 0.35 to
    # 0.335. Lobes in between would be seen.
    truth = flat(SIDE, diffuse=0.35, specular=0.04, roughness=0.06)
    found = stated(truth, photograph(truth, GRID, ANALYTIC, 0.003))
    dull = ANALYTIC.render(truth, GRID).amax(dim=(0, 3)) < 0.5
    assert found["roughness"][dull].median() > 0.1
    assert found["diffuse"][dull].median() < 0.03


def test_a_colour_near_zero_is_known_to_be_dark_as_it_is_counted():
    # Its number u stands for u^2.2. Where u = 0 is the answer, 68 % of a half-normal distribution lie below
    # 0.99 s / g in linear light, s the noise of linear photos and g the root of the sum of squares over
    # photos; the deviation is its number. Nothing below it is known, which a slope at 0 does not see.
    noise, truth = 1e-3, flat(SIDE, diffuse=0.0, specular=0.04, roughness=0.9)
    images = TWIN.render(truth, GRID)
    photos = images + noise * torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    found = stated(truth, Capture(photos.float().clamp_min(0), GRID, "linear"), "normal=flat",
                   "specular=0.04", "roughness=0.9")["diffuse"]
    one = TWIN.render(flat(SIDE, diffuse=1.0, specular=0.04, roughness=0.9), GRID) - images
    wanted = (0.99 * noise / one.square().sum(dim=0).sqrt()) ** (1 / 2.2)
    assert 0.85 < float((found / wanted).median()) < 1.2
    assert wanted.max() < 0.1


def test_clipped_pixels_say_that_it_is_bright_and_no_more():
    truth = flat(SIDE, diffuse=0.3)
    capture = photos_of(truth, GRID)
    half = dataclasses.replace(capture, photos=capture.photos.clone())
    half.photos[:, :, : SIDE // 2] = 1.0
    found = stated(truth, half)["diffuse"].mean(dim=-1)
    assert found[:, : SIDE // 2].min() > 5 * found[:, SIDE // 2:].max()


@pytest.mark.slow
def test_one_photo_determines_less_than_nine(leather):
    results = [fit_svbrdf(c, ANALYTIC, DirectConfig(iterations=40)) for c in (leather, leather.pick([0]))]
    nine, one = (confidence.confidence(r.deviations, {}, shown_texels(leather)) for r in results)
    for name in ("specular", "roughness", "normal"):
        assert nine[name]["determined_share"] > one[name]["determined_share"] + 0.2, name


def test_texels_under_a_mask_are_not_counted():
    capture = photos_of(flat(SIDE, diffuse=0.3), GRID)
    hidden = capture.but(measured=torch.ones(len(capture), SIDE, SIDE, dtype=torch.bool))
    hidden.measured[:, : SIDE * 3 // 4] = False
    hidden.measured[0, 0, 0] = True  # one photo shows it
    shown = shown_texels(hidden)
    assert int(shown.sum()) == SIDE * (SIDE // 4) + 1 and bool(shown_texels(capture).all())
    spread = {"diffuse": torch.where(shown, 0.01, 0.2887)[..., None]}
    assert confidence.confidence(spread, {}, shown)["diffuse"] == pytest.approx(
        {"median_sd": 0.01, "determined_share": 1.0})


@pytest.mark.parametrize("hidden, noisier", [(True, 1.0), (False, 1.4)])
def test_texels_between_those_whose_valley_is_followed_have_their_own_deviation(hidden, noisier):
    # Only diffuse unknown, as above. Every other column, of those that are not followed, shows in two photos
    # alone, or has more noise. Medians over the closed form: 0.94 to 0.99.
    side, noise = 80, torch.full((80, 1), 0.01)
    noise[::2] *= noisier
    truth = flat(side, diffuse=0.3, specular=0.0, roughness=1.0)
    rng = torch.Generator().manual_seed(0)
    slope = color.to_display(TWIN.render(flat(side, diffuse=1.0, specular=0.0, roughness=1.0), GRID))
    images = color.to_display(TWIN.render(truth, GRID))
    images = images + noise * torch.randn(images.shape, generator=rng, dtype=torch.float64)
    measured = torch.ones(images.shape[:-1], dtype=torch.bool)
    measured[2:, :, ::2] = not hidden
    seen = measured[..., None]
    best = (seen * images * slope).sum(dim=0) / (seen * slope.square()).sum(dim=0)
    answer = SVBRDF(truth.bsdf, {**truth.maps, "diffuse": color.decode(best).float()})
    found = stated(answer, Capture(images.float(), GRID, measured=measured), "normal=flat", "specular=0",
                   "roughness=1")["diffuse"]
    ratio = found / (noise * (seen * slope.square()).sum(dim=0) ** -0.5)
    for columns in (ratio[:, 1::2], ratio[:, ::2]):
        assert 0.9 < float(columns.median()) < 1.15


@pytest.mark.slow
def test_every_texel_of_large_maps_is_about_as_open_as_if_its_valley_were_followed(monkeypatch):
    # Ratios of both: median 1.00, 5 % below 0.59 to 0.70.
    truth = make_material("inlay", 80)
    photos = photos_of(truth, GRID)
    found = stated(truth, photos, grey=True)
    monkeypatch.setattr("mitsvbrdf.fit.confidence.GRID", 80)
    for name, followed in stated(truth, photos, grey=True).items():
        ratio = found[name] / followed
        assert 0.9 < float(ratio.median()) < 1.15, name
        assert float(ratio.quantile(0.05)) > 0.5, name


@pytest.mark.parametrize("side", mostly_slow([16, 80], 16))  # each texel's valley is followed, and some
def test_a_texel_that_no_photo_shows_is_as_open_as_its_range(side):
    truth = make_material("inlay", side)
    hidden = torch.zeros(9, side, side, dtype=torch.bool)
    hidden[:, 3:9, 3:9] = True
    shots = photos_of(truth, GRID)
    found = stated(truth, Capture(shots.photos, GRID, shots.transfer, measured=~hidden), grey=True)
    for value in found.values():
        assert (value[4:8, 4:8] > 0.9999 * UNKNOWN).all() and float(value[10:].median()) < UNKNOWN / 2
    nearly = torch.zeros_like(hidden)
    nearly[:, 0, 0] = True
    assert (stated(truth, Capture(shots.photos, GRID, shots.transfer, measured=nearly))["normal"][1:]
            > 0.9999 * UNKNOWN).all()
