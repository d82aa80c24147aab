"""What to doubt of a fit."""

import dataclasses

import pytest
import torch
from helpers import ANALYTIC, GRID

from mitsvbrdf.fit import DirectConfig, HierarchicalConfig, fit_svbrdf
from mitsvbrdf.fit.warnings import fit_warnings
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.views import Views, coverage_angle, half_angles

SIDE = 16

@pytest.fixture(scope="module")
def fitted(leather):
    return fit_svbrdf(leather, ANALYTIC, DirectConfig(iterations=60))


def test_a_good_fit_raises_no_doubt(fitted):
    assert fitted.warnings == () and fitted.stopped == "iterations"


def test_a_photo_from_elsewhere_is_named(leather):
    wrong = GRID.camera.clone()
    wrong[4] = torch.tensor([1.2, -1.2, 3.5])
    result = fit_svbrdf(dataclasses.replace(leather, views=Views.of(wrong, intensity=GRID.intensity)),
                        ANALYTIC, DirectConfig(iterations=40))
    assert any(warning.startswith("photo 04 fits worse") for warning in result.warnings)


@pytest.mark.parametrize("change, words", [({"sample": 4.0}, "darker than the photos by 4x"),
    ({"sample": 0.25}, "brighter than the photos by 4x"),
    ({"rerender_rmse": 0.2}, "RMSE of 0.2 is high"), ({"stopped": "unstable"}, "ended early"),
    ({"undone": ({"iteration": 30, "reason": "flat not finite"},)}, "1 step undone; the first at iteration "
                                                                    "30: flat not"),
    ({"trace": [{"iteration": 0, "seconds": 0.0, "rerender_rmse": 0.1}]}, "no step was made")])
def test_each_doubt(change, words, fitted, leather):
    if "sample" in change:
        change = {"sample": fitted.rerendered / change["sample"]}
    (warning,) = fit_warnings(fitted.but(**change), leather)
    assert words in warning


@pytest.mark.parametrize("stopped, said", [("budget", 1), ("interrupted", 1), ("settled", 0)])
def test_a_fit_that_had_not_settled(stopped, said, fitted, leather):
    result = fitted.but(config=HierarchicalConfig(), stopped=stopped)
    assert sum("before it had settled" in warning for warning in fit_warnings(result, leather)) == said


# a map that was given is the caller's own
@pytest.mark.parametrize("fix, count", [((), 1), (("roughness=0.5",), 0)])
def test_roughness_that_lies_as_the_highlights_do(fix, count, fitted, leather):
    follows = 0.2 + coverage_angle(fitted.views, SIDE)[..., None].float()
    burnt = SVBRDF("roughconductor", dict(fitted.svbrdf.maps) | {"roughness": follows})
    found = fitted.but(svbrdf=burnt, config=dataclasses.replace(fitted.config, fix=fix))
    warnings = list(fit_warnings(found, leather))
    assert len(warnings) == count and all("100% of the variance of the roughness" in warning
                                          for warning in warnings)


@pytest.mark.parametrize("side, mirrored, said", [(64, False, True), (64, True, False), (32, False, False)])
def test_ovals_where_single_photos_had_their_highlights(side, mirrored, said, fitted, leather):
    # 32 x 32 texels are too few to tell; mirrored, the map has its ovals elsewhere.
    views = Views.of(torch.tensor([[0.3, 0.0, 2.0], [-0.15, 0.26, 2.0], [-0.15, -0.26, 2.0]],
                                  dtype=torch.float64))
    far = torch.tan(half_angles(views, side))
    ovals = torch.exp(-(far / 0.05).square() / 2).sum(dim=0)
    rough = 0.06 + 0.05 * (ovals.flip(1) if mirrored else ovals)[..., None].float()
    maps = dict(fitted.svbrdf.resized(side).maps) | {"roughness": rough}
    found = fitted.but(svbrdf=SVBRDF("roughconductor", maps), views=views)
    assert any("the roughness map has ovals" in warning for warning in fit_warnings(found, leather)) == said


def test_dark_photos(fitted, leather):
    dark = dataclasses.replace(leather, photos=leather.photos * 0.05)
    assert any("nearly black" in warning for warning in fit_warnings(fitted, dark))


def with_maps(fitted, fix=(), spread=None, **values):
    """The fit with constant maps, and a standard deviation of specular for each texel."""
    maps = {name: torch.full_like(fitted.svbrdf[name], value) for name, value in values.items()}
    spread = torch.full((SIDE, SIDE, 3), 0.2) if spread is None else spread
    return fitted.but(svbrdf=SVBRDF("roughconductor", dict(fitted.svbrdf.maps) | maps),
                               deviations=dict(fitted.deviations) | {"specular": spread},
                               config=dataclasses.replace(fitted.config, fix=fix))


@pytest.mark.parametrize("rows, columns, place", [(slice(0, 16), slice(0, 16), "where none is yet"),
    (slice(0, 16), slice(3, 16), "at the right of the patch"),
    (slice(0, 12), slice(0, 12), "at the top left of the patch"),
    (slice(4, 16), slice(0, 16), "at the bottom of the patch")])
def test_a_strong_specular_that_hardly_anything_determines(rows, columns, place, fitted, leather):
    spread = torch.full((SIDE, SIDE, 3), 0.01)
    spread[rows, columns] = 0.2
    share = 1 - (rows.stop - rows.start) * (columns.stop - columns.start) / SIDE**2
    (said,) = [warning for warning in fit_warnings(with_maps(
        fitted, spread=spread, diffuse=0.2, specular=0.28), leather) if warning.startswith("median specular")]
    assert f"of 0.28, {share:.0%} of it determined" in said and f"highlight {place}," in said


# what is usual, determined or given
@pytest.mark.parametrize("fix, sd, maps", [((), 0.01, (0.2, 0.28)), ((), 0.2, (0.2, 0.05)),
    (("specular=0.28",), 0.2, (0.2, 0.28)), ((), 0.01, (0.6, 0.3)), (("diffuse=0.8",), 0.01, (0.8, 0.3)),
    (("diffuse=1",), 0.2, (1.0, 0.04)), (("base_color=1",), 0.2, (1.0, 0.04))])
def test_no_doubt(fix, sd, maps, fitted, leather):
    found = with_maps(fitted, fix, torch.full((SIDE, SIDE, 3), sd), diffuse=maps[0], specular=maps[1])
    assert not list(fit_warnings(found, leather))


@pytest.mark.parametrize("specular, sure, said", [(0.005, True, 1), (0.005, False, 0), (0.02, True, 0),
                                                  (0.0, True, 0)])
# a matte material has none
def test_a_specular_below_that_of_any_material(specular, sure, said, fitted, leather):
    found = with_maps(fitted, spread=torch.full((SIDE, SIDE, 3), 0.001 if sure else 0.2), specular=specular)
    assert sum("light may be weaker" in warning for warning in fit_warnings(found, leather)) == said


def test_texels_that_reflect_more_than_arrives(fitted, leather):
    assert sum("100% of the texels reflect more than arrives" in warning for warning in fit_warnings(
        with_maps(fitted, diffuse=0.8, specular=0.3), leather)) == 1


def test_photos_that_are_the_same_picture(fitted, leather):
    copied = leather.photos.clone()
    copied[6] = copied[2] + 0.5 / 255  # written anew, say
    copied[7] = copied[2]
    said = [warning.split(" are the same picture")[0] for warning in
            fit_warnings(fitted, dataclasses.replace(leather, photos=copied)) if "same picture" in warning]
    assert said == ["photos 02 and 06", "photos 02 and 07"]
    assert not any("same picture" in warning for warning in fit_warnings(fitted, leather))
