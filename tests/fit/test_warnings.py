"""What to doubt of a fit."""

import dataclasses

import pytest
import torch
from helpers import ANALYTIC, GRID

from mitsvbrdf.fit import DirectConfig, fit_svbrdf
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
