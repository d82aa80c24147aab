"""The Z-test against its own statistics, mpmath, and Mitsuba's noise."""

import math

import mpmath
import numpy as np
import pytest
import torch
from helpers import GRID

from mitsvbrdf.errors import ConfigError, MapsError
from mitsvbrdf.export.mitsuba import write_scene
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import flat
from mitsvbrdf.measure.z_test import _normal_score
from mitsvbrdf.testing import z_test


def noisy(seed, bias=1.0, side=16, passes=16, bright=1.0):
    """Passes of a picture with normal noise, and what it should be: 5 % noise in their mean."""
    g = torch.Generator().manual_seed(seed)
    truth = torch.rand(side, side, 3, generator=g, dtype=torch.float64) + 0.5
    noise = 0.05 * passes**0.5 * torch.randn(passes, side, side, 3, generator=g, dtype=torch.float64)
    noise[:, 0, 0] *= bright
    return bias * (truth + noise), truth


# one noisy texel alone decides over the mean: of 8 passes it has 7 degrees of freedom
@pytest.mark.parametrize("count, bright", [(16, 1.0), (1, 1.0), (8, 1e3)])
def test_noise_alone_fails_as_often_as_stated(count, bright):
    failed = biased = 0
    for seed in range(300):
        passes, truth = noisy(seed, side=8, passes=count, bright=bright)
        spread = torch.full_like(truth, 0.05**2) if count == 1 else passes
        found = z_test(passes.mean(dim=0), spread, truth, significance=0.1)
        failed += not found.passed
        biased += bool((found.bias.abs() > found.bias_limit).any())
    # 30 and 15 expected; the binomial distribution leaves these ranges once in 600 times
    assert 15 <= failed <= 48 and 5 <= biased <= 28


def test_a_bias_of_two_percent_hides_in_each_pixel_but_not_in_all():
    for seed in range(50):
        passes, truth = noisy(seed, bias=1.02)
        found = z_test(passes.mean(dim=0), passes, truth)
        assert not found.passed and (found.bias > found.bias_limit).all()
        assert found.outside <= 2 / truth.numel()


def test_one_wrong_pixel_is_found_unless_outliers_are_allowed():
    passes, truth = noisy(0)
    passes[:, 3, 4] += 1.0
    found = z_test(passes.mean(dim=0), passes, truth)
    assert found.outside == 3 / truth.numel() and not found.passed
    assert not z_test(passes.mean(dim=0), passes, truth, outliers=2 / truth.numel()).passed
    assert z_test(passes.mean(dim=0), passes, truth, outliers=3 / truth.numel()).passed


def test_noise_of_the_reference_counts_too():
    image, truth = noisy(1, passes=1)
    other, _ = noisy(2, passes=1)
    variance = torch.full_like(truth, 0.05**2)
    off = noisy(1)[1] + (other[0] - noisy(2)[1]) * 3  # noise three times as strong
    assert not z_test(image[0], variance, off).passed
    assert z_test(image[0], variance, off, reference_variance=9 * variance).passed


@pytest.mark.parametrize("significance", [0.02, 1e-16])
def test_limits_and_scores_against_mpmath(significance):
    found = z_test(torch.zeros(5, 7, 3), torch.ones(5, 7, 3), torch.zeros(5, 7, 3), significance=significance)
    for limit, count in ((found.z_limit, 105), (found.bias_limit, 3)):
        fails = -mpmath.expm1(2 * count * mpmath.log1p(-mpmath.erfc(limit / mpmath.sqrt(2))))
        assert float(fails / significance) == pytest.approx(1, rel=1e-9)
    for degrees, t in ((7, 4.0), (15, 6.0), (63, 6.0)):
        score = float(_normal_score(torch.tensor(-t, dtype=torch.float64), torch.tensor(degrees)))
        tail = mpmath.betainc(degrees / 2, 0.5, 0, degrees / (degrees + t**2), regularized=True)
        assert score < 0 and float(mpmath.erfc(-score / mpmath.sqrt(2)) / tail) == pytest.approx(1, rel=1e-9)


def test_what_is_exactly_equal_or_not_a_number():
    one, nothing = torch.ones(4, 4, 3, requires_grad=True), torch.zeros(4, 4, 3)
    assert z_test(one, nothing, one * (1 + 1e-6)).passed  # no noise, and no more than rounding apart
    assert not z_test(one, nothing, one * 1.001).passed
    assert z_test(nothing, nothing, nothing).passed and not z_test(one, nothing, nothing).passed
    found = z_test(torch.where(torch.arange(48).reshape(4, 4, 3) == 7, torch.nan, one), one, one)
    assert not found.passed and found.outside == 1 / 48


@pytest.mark.parametrize("value, spread, known", [
    (0, (5, 4, 3), ()), (0, (7, 4, 4, 3), ()), (1, (16, 4, 4, 3), ()), (0, (16, 5, 7, 3), ()),
    (0, (4, 4, 3), (9, 4, 4, 3))])
def test_pictures_that_do_not_belong_together(value, spread, known):
    with pytest.raises(MapsError):
        z_test(torch.full((4, 4, 3), value), torch.zeros(spread), torch.zeros(4, 4, 3),
               reference_variance=torch.zeros(known))


@pytest.mark.parametrize("bad", [-1e-9, math.nan, math.inf])
def test_numbers_that_are_no_variance_or_share(bad):
    one = torch.ones(4, 4, 3)
    spoilt = torch.where(torch.arange(48).reshape(4, 4, 3) == 7, bad, one)
    for given in ({"variance_or_passes": spoilt}, {"reference_variance": bad},
                  {"reference_variance": spoilt}, {"outliers": bad}, {"outliers": 1.0}):
        with pytest.raises((MapsError, ConfigError), match="finite and not below 0|outliers from 0"):
            z_test(one, reference=one, **{"variance_or_passes": one} | given)


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    """Passes of a path-traced preview: a material as we export it, under any light; passes x R x R x 3."""
    from mitsvbrdf.render.llvm import mitsuba_module

    mi = mitsuba_module()

    def trace(maps, light, passes, spp, first_seed=0):
        folder = tmp_path_factory.mktemp("scene")
        write_scene(folder, maps, GRID)
        resolution, at = maps.resolution, mi.ScalarTransform4f()
        film = {"type": "hdrfilm", "width": resolution, "height": resolution, "pixel_format": "rgb",
                "component_format": "float32", "rfilter": {"type": "box"}}
        scene = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 3}, "sensor": {
            "type": "perspective", "fov": 28.0, "to_world": at.look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
            "film": film, "sampler": {"type": "independent"}}, "light": light(mi, at),
                              "patch": {"type": "rectangle", "to_world": at.scale(0.5),
                                        "bsdf": mi.load_file(str(folder / "scene.xml")).shapes()[0].bsdf()}})
        return torch.stack([torch.from_numpy(np.array(mi.render(scene, spp=spp, seed=first_seed + k)))
                            for k in range(passes)])

    return trace


def lamp(mi, at):
    place = at.look_at([0.4, 0.3, 1.0], [0, 0, 0], [0, 1, 0]) @ at.scale(0.25)
    return {"type": "rectangle", "to_world": place,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5.0}}}


def test_a_diffuse_patch_under_a_white_sky_has_the_radiance_of_its_albedo(traced, two_threads):
    white_sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    passes = traced(flat(16, diffuse=0.6, specular=0.0), lambda *_: white_sky, passes=16, spp=4)
    albedo = torch.full((16, 16, 3), 0.6)
    assert z_test(passes.mean(dim=0), passes, albedo).passed
    assert not z_test(1.02 * passes.mean(dim=0), 1.02 * passes, albedo).passed


@pytest.mark.slow
def test_a_patch_under_an_area_light_is_what_many_samples_make_of_it(traced, two_threads):
    # Measured over 200 seeds: 1 % of the previews fail as they are, and all when 2 % brighter.
    leather = make_material("leather", 24)
    passes, many = traced(leather, lamp, passes=16, spp=4), traced(leather, lamp, passes=16, spp=512,
                                                                   first_seed=100)
    reference, variance = many.mean(dim=0), many.var(dim=0) / 16
    assert z_test(passes.mean(dim=0), passes, reference, reference_variance=variance).passed
    assert not z_test(1.02 * passes.mean(dim=0), 1.02 * passes, reference, reference_variance=variance).passed
