"""Matte materials are told by their photos, and then fitted without a lobe."""

from dataclasses import replace

import pytest
import torch
from helpers import GRID, MITSUBA, photos_of
from helpers.hierarchical_fits import left_alone, saving_loop
from helpers.variants import mostly_slow

from mitsvbrdf.fit import FitTask, HierarchicalConfig, fit_svbrdf, make_method
from mitsvbrdf.fit.hierarchical import omitted, specular_test
from mitsvbrdf.fit.hierarchical.stages import ROUNDS, Stage
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF

SIDE = 16


def material(specular, roughness=None, name="leather", side=SIDE):
    """A made material with another lobe: a number, or a map, side x side x 1."""
    made = make_material(name, side)
    other = {"specular": specular} | ({} if roughness is None else {"roughness": roughness})
    return SVBRDF(made.bsdf, dict(made.maps) | {
        name: torch.as_tensor(value).expand_as(made[name]).contiguous() for name, value in other.items()})


def spot(value, size=1, side=SIDE):
    where = torch.zeros(side, side, 1)
    where[5:5 + size, 9:9 + size] = value
    return where


@pytest.fixture(scope="module")
def black():
    return photos_of(material(0.0))


@pytest.mark.parametrize("found", [
    material(spot(0.04), 0.3), *(pytest.param(each, marks=pytest.mark.slow) for each in (
        material(0.04, 0.9), material(spot(0.5), 0.15), material(spot(0.02, 3), 0.5)))])
def test_a_weak_lobe_and_one_texel_that_shines_are_no_matte_material(found):
    assert not left_alone(photos_of(found)).stages.matte


@pytest.mark.parametrize("specular, roughness", [
    (0.04, 0.9), (spot(0.04, side=32), 0.3), pytest.param(spot(0.5, side=32), 0.15, marks=pytest.mark.slow)])
# it is below: plates, 0.001
@pytest.mark.slow
def test_nor_are_they_in_noise_in_which_a_matte_material_is_told(specular, roughness):
    found = material(specular, roughness, "plates", 32)
    assert not left_alone(photos_of(found, noise=0.001), exact=True).stages.matte


@pytest.mark.parametrize("specular", mostly_slow([0.0, 0.04], 0.0))
def test_a_texel_clipped_in_every_photo_says_nothing(specular):
    # Nothing is left of it, so that a ratio of its errors is no number, nor then the sum over all texels.
    found = material(specular, 0.9)
    maps = dict(found.maps)
    maps["diffuse"] = maps["diffuse"] / 4
    maps["diffuse"][3, 4] = 1.0
    views = replace(GRID, intensity=GRID.intensity * 4)
    assert left_alone(photos_of(SVBRDF(found.bsdf, maps), views), exact=True).stages.matte == (specular == 0)


@pytest.mark.slow
@pytest.mark.parametrize("name, noise, side",
                         [("plates", 0.001, 32), pytest.param("leather", 0.0, 64, marks=pytest.mark.slow)])
def test_other_matte_materials_with_noise_and_larger(name, noise, side):
    assert left_alone(photos_of(material(0.0, name=name, side=side), noise=noise)).stages.matte


@pytest.mark.parametrize("settings", [{}, {"fix": ("normal=flat",)}, {"grey_specular": True},
                                      {"exact": True}])
def test_a_matte_material_is_fitted_without_a_lobe(settings):
    truth = material(0.0)
    if "fix" in settings:
        truth = SVBRDF(truth.bsdf, dict(truth.maps)
                       | {"normal": torch.tensor([0.0, 0.0, 1.0]).expand(SIDE, SIDE, 3)})
    method = left_alone(photos_of(truth), **settings)
    assert method.stages.matte and method.stages.stage == Stage.FINE
    assert {omitted.LOBE, omitted.MULTI_START, omitted.TIED} <= set(dict(method.omitted))
    method.step(0.0)
    found, _ = method.estimate()
    assert not found["specular"].any() and len(found["roughness"].unique()) == 1
    off = (found["diffuse"]**(1 / 2.2) - truth["diffuse"]**(1 / 2.2)).square().mean().sqrt()
    assert off < 0.005  # a step of 8 bits is 0.004


@pytest.mark.parametrize("settings", [{"fix": ("roughness=0.5",)}, {"fix": ("specular=0.04",)},
    *(pytest.param(each, marks=pytest.mark.slow) for each in ({"bsdf": "principled"}, {"exact": False}))])
def test_who_is_not_asked(settings, black):
    method = left_alone(black, **settings)
    assert not method.stages.matte
    assert (omitted.LOBE in dict(omitted.decided_later(method.task))) is False


@pytest.mark.slow
def test_photos_that_cannot_tell(black):
    assert not left_alone(black.pick(black.index[:1])).stages.matte
    assert not left_alone(replace(black, photos=torch.ones_like(black.photos)), exact=True).stages.matte


def test_a_free_stage_that_was_cut_short_decides_nothing(black):
    method = make_method(FitTask(black, MITSUBA, HierarchicalConfig(exact=True)))
    method.step(0.0)
    method.step(0.9)
    assert method.stages.stage == Stage.MULTI_START and not method.stages.matte


@pytest.mark.slow
def test_it_resumes_to_the_bit_and_goes_back(black, tmp_path):
    first = ROUNDS[Stage.ALONE]
    config = HierarchicalConfig(iterations=100)
    loop, before = saving_loop(black, config, tmp_path)
    loop.run()
    whole, _ = loop.method.estimate()
    assert loop.method.stages.matte and not whole["specular"].any()
    for at in (first, first + 2):
        resumed = fit_svbrdf(black, MITSUBA, config, resume=tmp_path / f"{at}.safetensors").svbrdf
        assert all(torch.equal(whole[name], resumed[name]) for name in whole.maps)
    loop.method.load_state(before[first][1])  # a bad step is taken back to before it was decided
    assert not loop.method.stages.matte and loop.method.answer.x.shape[0] == len(
        loop.method.prior.unknowns.names) == 9
    loop.method.step(0.0)
    assert loop.method.stages.matte


@pytest.mark.slow
def test_a_spot_between_the_texels_of_the_first_stage_is_seen(monkeypatch):
    monkeypatch.setattr("mitsvbrdf.fit.hierarchical.scales.COARSE", SIDE)
    where = torch.zeros(2 * SIDE, 2 * SIDE, 1)
    where[8, 10] = 0.04  # of 2 x 2 texels the first stage looks at one, whose row and column are odd
    shots = photos_of(material(where, 0.3, side=2 * SIDE))
    assert torch.equal(shots.sampled(SIDE).photos, shots.photos[:, 1::2, 1::2])
    assert not left_alone(shots).stages.matte
    assert left_alone(photos_of(material(0.0, side=2 * SIDE))).stages.matte


def test_blocks_are_sums_over_all_sizes():
    plane = torch.arange(36.0).reshape(6, 6)
    sums = [each for (each,) in specular_test.blocks(plane)]
    assert [len(each) for each in sums] == [6, 3, 2, 1]
    assert torch.equal(sums[0], plane.double()) and float(sums[-1]) == float(plane.sum())
    assert float(sums[1][1, 2]) == float(plane[2:4, 4:6].sum()) and float(sums[2][1, 1]) == float(plane[4:,
                                                                                                        4:].sum())


def test_noise_rarely_needs_a_lobe_and_one_texel_is_found():
    draw = torch.Generator().manual_seed(0)
    alarms = 0
    for _ in range(40):
        saved, rest = (torch.randn(count, SIDE, SIDE, generator=draw).double().square().sum(dim=0)
                       for count in (4, 18))
        values = torch.full((SIDE, SIDE), 27.0).double()
        alarms += specular_test.needed(saved + rest, rest, values, 5, 9)
        saved[3, 4] += 40 * rest[3, 4]
        assert specular_test.needed(saved + rest, rest, values, 5, 9)
    assert alarms <= 6  # 2 are expected; more than 6 come once in 200 times
