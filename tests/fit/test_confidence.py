"""How sure a fit is, against closed forms and reverse mode."""

import dataclasses
import math

import pytest
import torch
from helpers import ANALYTIC, GRID, TWIN, photos_of

from mitsvbrdf import color
from mitsvbrdf.capture import Capture
from mitsvbrdf.fit import DirectConfig, FitTask, fit_svbrdf
from mitsvbrdf.fit.confidence import UNKNOWN, confidence, deviations, jacobian, map_of, numbers_of
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.render import make_renderer
from mitsvbrdf.synth import photograph
from mitsvbrdf.views import Views

SIDE = 16

@pytest.mark.parametrize("bsdf", ["roughconductor", "principled"])
def test_slopes_are_those_of_reverse_mode(bsdf):
    # Measured: 1.5e-7. Every texel's slopes at once, under random weights of its display values.
    made, views = make_material("plates", SIDE).to(torch.float64), GRID
    if bsdf == "principled":
        made = SVBRDF(bsdf, {"base_color": made["diffuse"] + 0.05, "metallic": made["roughness"] / 2,
                             "roughness": made["roughness"], "normal": made["normal"]})
    numbers = {name: numbers_of(name, value) for name, value in made.maps.items()}
    slopes = jacobian(made, numbers, views, "srgb")
    leaves = {name: value.clone().requires_grad_() for name, value in numbers.items()}
    shown = color.encode(make_renderer("analytic64").render(
        SVBRDF(bsdf, {name: map_of(name, value) for name, value in leaves.items()}), views), "srgb")
    weights = torch.randn(shown.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    wanted = torch.cat([g.flatten(0, 1) for g in torch.autograd.grad(shown, list(leaves.values()), weights)],
                       dim=1)
    found = (slopes * weights.permute(1, 2, 0, 3).reshape(SIDE**2, -1, 1)).sum(dim=1)
    assert (found - wanted).norm() < 1e-6 * wanted.norm()


def test_deviation_of_a_matt_texel_in_closed_form():
    # Only diffuse unknown: a display value is u (E / pi)^(1/2.2) with u = rho^(1/2.2), E the irradiance, so
    # the deviation is (sum_k (E_k / pi)^(2/2.2) / s^2 + 12)^-1/2. Photos are off by 0.02 everywhere; of 27
    # values the fit took out 3.
    views, truth = GRID, flat(SIDE, diffuse=0.3, specular=0.0, roughness=1.0)
    images = ANALYTIC.render(truth, views)
    capture = Capture(color.to_display(images) + 0.02, views)
    config = DirectConfig(fix=("normal=flat", "specular=0", "roughness=1"))
    found = deviations(truth, views, images, FitTask(capture, ANALYTIC, config))["diffuse"][3, 5, 1]
    texel = torch.tensor([(5 + 0.5) / SIDE - 0.5, 0.5 - (3 + 0.5) / SIDE, 0.0], dtype=torch.float64)
    to_light = views.light - texel
    lit = views.intensity[:, 0] * to_light[:, 2] / to_light.norm(dim=1) ** 3 / math.pi
    wanted = ((lit ** (2 / 2.2)).sum() / (0.02**2 * (27 + 3) / 27) + 12) ** -0.5
    assert float(found) == pytest.approx(float(wanted), rel=1e-3)


def test_only_texels_that_saw_the_highlight_know_their_roughness():
    # Lights over the left edge: their highlights lie there, and the right half sees only the diffuse colour.
    views = Views.of([[-0.5, 0.0, 1.5], [-0.45, 0.1, 1.5], [-0.4, -0.1, 1.5]], intensity=math.pi * 2.25)
    truth = flat(SIDE, diffuse=0.2, specular=0.04, roughness=0.3)
    images = ANALYTIC.render(truth, views)
    photos = photograph(truth, views, ANALYTIC, noise=0.01)
    found = deviations(truth, views, images, FitTask(photos, ANALYTIC, DirectConfig(fix=("normal=flat",))))
    roughness = found["roughness"][..., 0]
    # measured 0.06, and 0.28 or more
    assert roughness[4:12, :4].median() < 0.1 and roughness[:, -4:].min() > 0.2
    assert (roughness <= UNKNOWN).all()


def test_a_lobe_that_no_photo_met_may_be_any_that_looks_like_the_diffuse_colour():
    # Where no photo shows its highlight, a mirror makes the photos of a matt surface that is a little darker:
    # measured, they change by 0.6 of the noise (median) from roughness 0.06 to 0.92 and diffuse 0.35 to
    # 0.335. Lobes in between would be seen, so curvature alone states a deviation of 0.03.
    views, truth = GRID, flat(SIDE, diffuse=0.35, specular=0.04, roughness=0.06)
    images = ANALYTIC.render(truth, views)
    found = deviations(truth, views, images, FitTask(photograph(truth, views, ANALYTIC, 0.003), ANALYTIC,
                                                     DirectConfig()))
    dull = images.amax(dim=(0, 3)) < 0.5
    assert found["roughness"][dull].median() > 0.2  # measured 0.29
    assert found["diffuse"][dull].median() < 0.02  # measured 0.005


@pytest.mark.parametrize("noise", [0.01, 0.02, 0.04])
def test_how_far_roughness_may_be_off_is_that_of_the_whole_posterior(noise):
    # The numbers d, s and the roughness r of a texel explain its photos with probability exp(-sum of squares
    # / 2 noise^2), and colours have a prior around those found; the mean square of r - r found is summed over
    # a grid of all three. Where camera and light coincide radiance is d^2.2 a + s^2.2 b(r), with a and b
    # rendered.
    views, found = GRID, {"diffuse": 0.35, "specular": 0.04, "roughness": 0.06}
    truth = flat(SIDE, **found)
    images = TWIN.render(truth, views)
    photos = Capture((color.to_display(images) + noise).float(), views)
    sure = deviations(truth, views, images,
                      FitTask(photos, ANALYTIC, DirectConfig(fix=("normal=flat",))))["roughness"]
    scale = noise * ((27 + 7) / 27) ** 0.5

    def lit(**maps):
        return TWIN.render(flat(SIDE, **({"diffuse": 0.0, "specular": 0.0, "roughness": 0.5} | maps)),
                           views)[..., 0]

    widths = (torch.arange(100, dtype=torch.float64) + 0.5) / 100
    lobes = torch.stack([lit(specular=1.0, roughness=float(width)) for width in widths])
    diffuse, colours = lit(diffuse=1.0), (torch.arange(100, dtype=torch.float64) + 0.5) / 100
    known = {name: found[name] ** (1 / 2.2) for name in ("diffuse", "specular")}
    prior = [-((colours - value) / UNKNOWN).square() / 2 for value in known.values()]
    for row, column in ((0, 0), (3, 5), (8, 8), (12, 2)):
        d, s, b = (colours**2.2)[:, None, None], (colours**2.2)[:, None], lobes[:, :, row, column]
        a, goal = diffuse[:, row, column], color.to_display(images[:, row, column, 0])
        logs = torch.stack([-(color.to_display(d * a + s * each) - goal).square().sum(dim=-1) / (2 * scale**2)
                            for each in b])
        logs += prior[0][:, None] + prior[1]
        of_width = 3 * logs.flatten(1).logsumexp(dim=1)  # three channels alike, each with colours of its own
        wanted = (of_width.softmax(dim=0) * (widths - found["roughness"]).square()).sum().sqrt()
        # Measured: 0.36, 0.59 and 1.16 in the middle, where the highlight was met; elsewhere all is open,
        # 0.97 to 1.
        assert 1 / 3 < float(sure[row, column, 0] / wanted.clamp_max(UNKNOWN)) < 1.3


def test_a_lobe_whose_highlights_were_met_is_no_other():
    views, truth = GRID, flat(SIDE, diffuse=0.2, specular=0.04, roughness=0.3)
    photos = photograph(truth, views, ANALYTIC, noise=0.003)
    found = deviations(truth, views, ANALYTIC.render(truth, views), FitTask(photos, ANALYTIC, DirectConfig()))
    assert found["roughness"].median() < 0.05  # measured 0.02


@pytest.mark.parametrize("name", ["diffuse", "specular"])
def test_a_colour_near_zero_is_known_to_be_dark_as_it_is_counted(name):
    # Its number u stands for u^2.2, which is what photos show: g u^2.2 in linear radiance. Where u = 0 the
    # deviation is the u at which that reaches what the noise hides, however flat u^2.2 is there: (s /
    # g)^(1/2.2) for linear photos with noise s and g the root of the sum of squares over photos. Solved with
    # the prior for u here, by bisection.
    views, noise = GRID, 1e-3
    truth = flat(SIDE, **{"diffuse": 0.2, "specular": 0.04, "roughness": 0.9, name: 0.0})
    images = ANALYTIC.render(truth, views)
    capture = Capture(images + noise, views, "linear")
    fixed = {"diffuse": "diffuse=0.2", "specular": "specular=0.04"}
    fixed.pop(name)
    config = DirectConfig(fix=("normal=flat", "roughness=0.9", *fixed.values()))
    found = deviations(truth, views, images, FitTask(capture, ANALYTIC, config))[name][8, 8, 0]
    one = (ANALYTIC.render(flat(SIDE, **{"diffuse": 0.2, "specular": 0.04, "roughness": 0.9, name: 1.0}),
                           views) - images)
    strength = one[:, 8, 8, 0].double().square().sum() / (noise**2 * (27 + 3) / 27)
    low, high = 0.0, UNKNOWN
    for _ in range(60):
        u = (low + high) / 2
        low, high = (u, high) if (float(strength) * (u ** 2.2 / u) ** 2 + 12) ** -0.5 > u else (low, u)
    assert float(found) == pytest.approx(u, rel=0.02)
    assert u < 0.1


def test_clipped_pixels_say_nothing():
    views, truth = GRID, flat(SIDE, diffuse=0.3)
    images = ANALYTIC.render(truth, views)
    capture = photos_of(truth, views)
    blind = Capture(torch.ones_like(capture.photos), views)
    for name, value in deviations(truth, views, images, FitTask(blind, ANALYTIC, DirectConfig())).items():
        assert torch.allclose(value, torch.tensor(UNKNOWN)), name
    half = dataclasses.replace(capture, photos=capture.photos.clone())
    half.photos[:, :, : SIDE // 2] = 1.0
    found = deviations(truth, views, images, FitTask(half, ANALYTIC, DirectConfig()))["diffuse"].mean(dim=-1)
    assert found[:, : SIDE // 2].min() > 5 * found[:, SIDE // 2:].max()


def test_the_deviation_predicts_where_the_error_is():
    # Spearman's rank correlation over texels. Measured: 0.73 (diffuse), 0.85, 0.79, 0.83.
    truth = make_material("plates", SIDE)
    result = fit_svbrdf(photos_of(truth), ANALYTIC, DirectConfig(iterations=150))
    for name, spread in result.deviations.items():
        error = (numbers_of(name, result.svbrdf[name])
                 - numbers_of(name, truth[name])).square().mean(dim=-1).flatten()
        ranks = torch.stack([x.argsort().argsort().double() for x in (error,
                                                                      spread.square().mean(dim=-1).flatten())])
        assert torch.corrcoef(ranks)[0, 1] > 0.5, name
        # And its size, over that of the error. Measured: 0.48, 1.0, 0.56, 0.56.
        assert 1 / 3 < float(spread.square().mean(dim=-1).sqrt().mean() / error.sqrt().mean()) < 3, name


def test_one_photo_determines_less_than_nine(leather):
    results = [fit_svbrdf(c, ANALYTIC, DirectConfig(iterations=40)) for c in (leather, leather.pick([0]))]
    nine, one = (confidence(r.deviations) for r in results)
    for name in ("specular", "roughness", "normal"):
        assert nine[name]["determined_share"] > 0.9 and one[name]["determined_share"] < 0.1, name
        assert one[name]["median_sd"] > 3 * nine[name]["median_sd"]


def test_large_maps_are_looked_at_small():
    truth, views = make_material("leather", 80), GRID.pick([0, 1])
    images = ANALYTIC.render(truth, views)
    found = deviations(truth, views, images, FitTask(photos_of(truth, views), ANALYTIC,
                                                     DirectConfig(grey_specular=True)))
    assert {name: tuple(value.shape) for name, value in found.items()} == {
        "diffuse": (64, 64, 3), "specular": (64, 64, 1), "roughness": (64, 64, 1), "normal": (64, 64, 2)}
