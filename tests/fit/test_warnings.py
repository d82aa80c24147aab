"""What to doubt of a fit."""

import dataclasses

import pytest
import torch
from helpers import ANALYTIC, GRID

from mitsvbrdf.capture import Capture
from mitsvbrdf.fit import DirectConfig, GanConfig, HybridConfig, fit_svbrdf
from mitsvbrdf.fit.warnings import fit_warnings
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.views import Views, coverage_angle

SIDE = 16

@pytest.fixture(scope="module")
def fitted(leather):
    return fit_svbrdf(leather, ANALYTIC, DirectConfig(iterations=60))


def test_a_good_fit_raises_no_doubt(fitted):
    assert fitted.warnings == () and fitted.stopped == "iterations"


def test_a_photo_from_elsewhere_is_named(leather):
    views = GRID
    wrong = views.camera.clone()
    wrong[4] = torch.tensor([1.2, -1.2, 3.5])
    result = fit_svbrdf(dataclasses.replace(leather, views=Views.of(wrong, intensity=views.intensity)), ANALYTIC,
                        DirectConfig(iterations=40))
    assert any(warning.startswith("photo 04 fits worse") for warning in result.warnings)


@pytest.mark.parametrize("change, words", [
    ({"rerendered": 4.0}, "darker than the photos by 4x"), ({"rerendered": 0.25}, "brighter than the photos by 4x"),
    ({"rerender_rmse": 0.2}, "only met to 0.2"), ({"stopped": "unstable"}, "ended early"),
    ({"undone": ({"iteration": 30, "reason": "flat not finite"},)}, "1 step undone; the first at iteration 30: flat not"),
    ({"trace": [{"iteration": 0, "seconds": 0.0, "rerender_rmse": 0.1}]}, "no step was made"),
    ({"restarts": ({"iteration": 50, "reason": "x"},) * 2}, "diverged and went back to its lowest loss 2 times"),
])
def test_each_doubt(change, words, fitted, leather):
    if "rerendered" in change:
        change = {"rerendered": fitted.rerendered / change["rerendered"]}
    (warning,) = fit_warnings(dataclasses.replace(fitted, **change), leather)
    assert words in warning


@pytest.mark.parametrize("fix, count", [((), 1), (("roughness=0.5",), 0)])  # a map that was given is the caller's own
def test_roughness_that_lies_as_the_highlights_do(fix, count, fitted, leather):
    follows = 0.2 + coverage_angle(fitted.views, SIDE)[..., None].float()
    burnt = SVBRDF("roughconductor", dict(fitted.svbrdf.maps) | {"roughness": follows})
    found = dataclasses.replace(fitted, svbrdf=burnt, config=dataclasses.replace(fitted.config, fix=fix))
    warnings = list(fit_warnings(found, leather))
    assert len(warnings) == count and all("100% of the roughness map lies as" in warning for warning in warnings)


def test_dark_photos(fitted, leather):
    dark = dataclasses.replace(leather, photos=leather.photos * 0.05)
    assert any("nearly black" in warning for warning in fit_warnings(fitted, dark))


def played(fitted, config, losses):
    trace = [{"iteration": 10 * n, "seconds": 1.0 * n, "rerender_rmse": 0.05} | ({"discriminator": loss} if n else {})
             for n, loss in enumerate([0.0, *losses])]
    return dataclasses.replace(fitted, config=config, trace=trace)


@pytest.mark.parametrize("config, words", [
    (GanConfig(), "(its loss in the end 0.004; 0.69 is a guess), so it hardly helped: lower --discriminator-rate, now 0.001"),
    (GanConfig(game="bce"), "0.69 is a guess"), (GanConfig(game="hinge"), "0.004; 1 is a guess"),
    (HybridConfig(), "lower --adversarial")])
def test_a_discriminator_that_is_sure(config, words, fitted, leather):
    (warning,) = fit_warnings(played(fitted, config, [0.6] * 8 + [0.004] * 2), leather)
    assert words in warning
    # An ordinary end, one sure moment in the last fifth, sure only earlier, too few measurements.
    for losses in ([0.6] * 8 + [0.05] * 2, [0.6] * 8 + [0.001, 0.1, 0.1], [0.004] * 8 + [0.6] * 2, [0.004] * 4):
        assert not list(fit_warnings(played(fitted, config, losses), leather))


@pytest.mark.parametrize("game", ["bce", "hinge", "relativistic"])
def test_games_that_are_lost_and_games_that_are_not(game, leather):
    # Photos of noise, which no generator that stands still comes near: measured losses
    # of 0.001 to 0.005, or 0 (hinge). A fair game at the start: 0.69, or 1.
    noise = torch.rand(leather.photos.shape, generator=torch.Generator().manual_seed(0))
    config = GanConfig(game=game, paired=False, width=4, pictures=2, discriminator_rate=0.02, iterations=80)
    lost = fit_svbrdf(Capture(noise, GRID), ANALYTIC, dataclasses.replace(config, learning_rate=1e-9))
    fair = fit_svbrdf(leather, ANALYTIC, dataclasses.replace(config, discriminator_rate=1e-3))
    said = [any("almost surely" in warning for warning in result.warnings) for result in (lost, fair)]
    assert said == [True, False]
