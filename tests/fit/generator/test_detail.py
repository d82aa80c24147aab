"""Plausible detail moves only what is unsure, and compares lights of the same half vectors."""

import dataclasses
import signal

import pytest
import torch
import torch.nn.functional as F
from helpers import ANALYTIC, GRID, photos_of

from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import HierarchicalConfig, fit_svbrdf, losses
from mitsvbrdf.fit.detail_config import DetailConfig
from mitsvbrdf.fit.generator import highlight_discriminator as judges
from mitsvbrdf.fit.generator.bounded import Bounded
from mitsvbrdf.fit.generator.detail import DetailTraining, why_not, with_detail
from mitsvbrdf.fit.generator.novel_lights import draw, novel_views
from mitsvbrdf.material.made import make_material
from mitsvbrdf.measure.metrics import photo_rmse
from mitsvbrdf.views import Views, geometry

QUICK = DetailConfig(steps=4, width=4, discriminator_width=8, worst=10.0)


@pytest.fixture(scope="module")
def capture():
    return photos_of(make_material("leather", 32)).pick((0, 1, 2, 3, 5))


@pytest.fixture(scope="module")
def result(capture):
    return fit_svbrdf(capture, ANALYTIC, HierarchicalConfig(iterations=12))


@pytest.mark.slow
def test_maps_keep_their_bits_and_certain_texels_stay(result, capture):
    before = {name: value.clone() for name, value in result.svbrdf.maps.items()}
    # The left half of every map is told to be certain.
    spreads = {name: value.clone() for name, value in result.deviations.items()}
    for value in spreads.values():
        value[:, :16], value[:, 16:] = 0.01, 0.2
    found = with_detail(result.but(deviations=spreads), capture, ANALYTIC, QUICK)
    assert found.detail.check() is found.detail
    for name, value in before.items():
        assert torch.equal(found.svbrdf[name], value)
        assert torch.equal(found.detail[name][:, :16], value[:, :16])
        assert not torch.equal(found.detail[name][:, 16:], value[:, 16:])


def test_photos_are_seen_through_the_curve_of_the_fit(result, capture):
    bent = result.but(transfer="gamma2.2, gamma 1.8000, shoulder 0.5000")
    found, plain = (with_detail(fit, capture, ANALYTIC, QUICK).detail for fit in (bent, result))
    told = with_detail(result, capture.through(bent.transfer), ANALYTIC, QUICK).detail
    assert not torch.equal(found["roughness"], plain["roughness"])
    assert not torch.equal(told["roughness"], found["roughness"])  # taken back, where the fit has none
    assert torch.equal(told["roughness"], plain["roughness"])


def test_no_texel_moves_by_more_than_its_bound(result, capture):
    found = with_detail(result, capture, ANALYTIC, dataclasses.replace(QUICK, learning_rate=1.0, worst=1e9))
    bound = QUICK.reach * (result.deviations["roughness"] - QUICK.certain).clamp_min(0)
    moved = (found.detail["roughness"] - found.svbrdf["roughness"]).abs()
    # The largest move is half of the largest bound.
    assert bool((moved <= bound + 1e-6).all()) and float(moved.max()) > 0.4 * float(bound.max())


def test_a_look_that_misses_the_photos_is_weakened(result, capture):
    # Without judges that hold it: a step size that goes anywhere.
    wild = dataclasses.replace(QUICK, learning_rate=1.0, photometric=0.0, diffuse=0.0, worst=1.2)
    found = with_detail(result, capture, ANALYTIC, wild)
    assert found.detail_record["share"] < 1 and found.detail_record[
        "rerender_rmse"] <= 1.2 * result.rerender_rmse
    images = ANALYTIC.render(found.detail, result.views)
    assert photo_rmse(images, capture.photos,
                      capture.transfer)[0] == pytest.approx(found.detail_record["rerender_rmse"], rel=1e-6)
    held = with_detail(result, capture, ANALYTIC, dataclasses.replace(wild, worst=1e-9))
    assert held.detail_record["share"] == 0 and all(torch.equal(held.detail[name], value)
                                             for name, value in result.svbrdf.maps.items())


def test_a_seed_decides_the_draw(result, capture):
    first, again = (with_detail(result, capture, ANALYTIC, QUICK).detail for _ in range(2))
    other = with_detail(result, capture, ANALYTIC, dataclasses.replace(QUICK, seed=1)).detail
    for name in first.maps:
        assert torch.equal(first[name], again[name])
    assert any(not torch.equal(first[name], other[name]) for name in first.maps)


def test_the_look_starts_as_the_maps(result, capture):
    bounded = Bounded.of(result.svbrdf, result.views, result.deviations, QUICK.reach, QUICK.certain)
    start = DetailTraining(bounded, capture, ANALYTIC, QUICK).material()
    for name, value in result.svbrdf.maps.items():
        # There and back through the numbers that deviations are stated in, float32; a slope of 1e-3 near the
        # upright z = 1.
        assert torch.allclose(start[name], value, atol=2e-5)


def test_ctrl_c_leaves_the_look_out_and_the_fit_as_it_was(result, capture):
    def stop(text, share):
        signal.raise_signal(signal.SIGINT)

    steps = []
    assert with_detail(result, capture, ANALYTIC, QUICK, lambda text,
                    share: (steps.append(share), stop(text, share))) is result
    assert len(steps) == 1 and result.detail is None and result.detail_record is None


def test_what_cannot_be_finished_says_why(result, capture):
    assert why_not(result) is None
    still = result.but(views=Views.of([[0.0, 0.0, 2.0]] * len(capture)))
    for spoilt, why in ((result.but(stopped="interrupted"), "interrupted"),
                        (still, "one view"), (result.but(deviations={}), "need Mitsuba"),
                        (result.but(svbrdf=result.svbrdf.resized(6)), "fewer than 7 texels")):
        assert why in why_not(spoilt) and with_detail(spoilt, capture, ANALYTIC, QUICK) is spoilt
    assert why_not(still.but(record=result.record | {"repeats": {"stationary": True}})) is None
    with pytest.raises(ConfigError, match="steps"):
        with_detail(result, capture, ANALYTIC, DetailConfig(steps=0))


@pytest.mark.parametrize("falloff, photos", [("inverse-square", 9), ("none", 9), ("inverse-square", 1)])
def test_a_moved_light_shows_elsewhere_what_its_photo_shows(falloff, photos):
    # A material that is the same everywhere: crops of renderings under the moved light and under the photo's
    # are one picture.
    views = dataclasses.replace(GRID.pick(range(photos)), falloff=falloff)
    material = make_material("leather", 32).map(lambda value: value[:1, :1].expand_as(value).contiguous())
    random, carried = torch.Generator().manual_seed(0), set()
    for _ in range(12):
        light = draw(views, torch.zeros(32, 32, 3), 12, 4, random)
        moved = novel_views(views, [light], 32)
        new, old = ANALYTIC.render(material, moved)[0], ANALYTIC.render(material,
                                                                        views.pick([light.photo]))[0]
        assert torch.allclose(light.under_it(new, 12), light.in_photo(old, 12), rtol=1e-4)
        half = [geometry(each, 32)[1][0] for each in (moved, views.pick([light.photo]))]
        assert torch.allclose(light.under_it(half[0], 12), light.in_photo(half[1], 12), atol=1e-6)
        carried.add((light.down, light.right))
    assert len(carried) > 6


def test_patch_distance_is_the_sorted_difference_of_projected_patches():
    random = torch.Generator().manual_seed(6)
    rendered, photos = torch.rand(2, 1, 19, 19, 3, generator=random)
    angle = torch.rand(1, 19, 19, generator=random)
    found = judges.patch_distance(rendered, photos, angle, torch.Generator().manual_seed(0), bins=1)
    size, step = judges.PATCH, judges.STRIDE
    directions = torch.randn(size * size * 3, 64, generator=torch.Generator().manual_seed(0))
    directions = directions / directions.norm(dim=0)
    flat = [F.unfold(x.movedim(-1, 1), size, stride=step)[0].T @ directions for x in (rendered, photos)]
    truth = (flat[0].sort(dim=0).values - flat[1].sort(dim=0).values).abs().mean()
    assert float(found) == pytest.approx(float(truth), rel=1e-5)


def test_the_discriminator_sees_levels_and_learns_what_is_told():
    torch.manual_seed(0)
    judge = judges.HighlightDiscriminator(8, 8)
    bright, dark = torch.full((1, 8, 32, 32), 0.5), torch.full((1, 8, 32, 32), -0.5)
    bright, dark = (x + 0.05 * torch.randn(1, 8, 32, 32) for x in (bright, dark))
    optimizer = torch.optim.Adam(judge.parameters(), lr=1e-2)
    before = float(losses.discriminator(judge(bright), judge(dark), "relativistic").detach())
    for _ in range(30):
        optimizer.zero_grad()
        loss = losses.discriminator(judge(bright), judge(dark), "relativistic")
        loss.backward()
        optimizer.step()
    assert float(loss.detach()) < 0.3 * before
