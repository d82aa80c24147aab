"""What masked pixels show does not count: fits, errors and deviations are those of any other values there."""

from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, MITSUBA, photos_of
from helpers.hierarchical_fits import method_of, reached

from mitsvbrdf.calibrate.estimate import estimate_views, why_not
from mitsvbrdf.calibrate.readings import Reading, doubts, mean_radiance
from mitsvbrdf.calibrate.refine import Priors, refine_views
from mitsvbrdf.capture import guess_diffuse
from mitsvbrdf.color import decode, to_display
from mitsvbrdf.fit import DirectConfig, FitTask, GanConfig, HierarchicalConfig, HybridConfig, fit_svbrdf
from mitsvbrdf.fit.checkpoint import fingerprints
from mitsvbrdf.fit.confidence import deviations
from mitsvbrdf.fit.direct import Direct
from mitsvbrdf.fit.generator.hybrid import Hybrid
from mitsvbrdf.fit.generator.pictures import PictureSource
from mitsvbrdf.fit.hierarchical import Hierarchical
from mitsvbrdf.fit.hierarchical.stages import Stage, unexplained
from mitsvbrdf.material.made import make_material
from mitsvbrdf.measure.rerender import rerender
from mitsvbrdf.report.fit_page import check_photos

SIDE = 16


@pytest.fixture(scope="module")
def made():
    return make_material("tiles", SIDE)


@pytest.fixture(scope="module")
def shots(made):
    """The same photos with two makes of what a mask hides: the first rows of three photos."""
    capture = photos_of(made)
    measured = torch.ones(capture.photos.shape[:3], dtype=torch.bool)
    measured[[0, 3, 6], :5] = False
    return [replace(capture, photos=torch.where(measured[..., None], capture.photos, value),
                    measured=measured) for value in (0.1, 0.9)]


def test_errors_and_deviations(made, shots):
    views = shots[0].views
    first, second = ((*rerender(ANALYTIC, made, views, each),
                      unexplained(made, views, each, ANALYTIC).tolist()) for each in shots)
    assert first[1:] == second[1:] and first[1] < 0.5 / 255
    off = (to_display(ANALYTIC.render(made, views), shots[0].transfer) + 0.0083).clamp(0, 1).float()
    one = unexplained(made, views, replace(shots[0], photos=off), ANALYTIC)  # one error at all usable pixels
    assert torch.allclose(one, torch.tensor(0.0083), rtol=1e-3)
    nothing = replace(shots[0], measured=torch.zeros_like(shots[0].measured))
    assert unexplained(made, views, nothing, ANALYTIC).tolist() == [0, 0]
    first, second = (deviations(made, views, FitTask(each, ANALYTIC, HierarchicalConfig()))[0]
                     for each in shots)
    assert first and all(torch.equal(first[name], second[name]) for name in first)


def test_views_and_doubts(made, shots):
    found = [refine_views(made, each.views, each, Priors()).views for each in shots]
    found += [estimate_views(replace(each, calibration="none")).views for each in shots]
    for one, other in (found[:2], found[2:]):
        assert torch.equal(one.camera, other.camera) and torch.equal(one.intensity, other.intensity)
    assert len({doubts(Reading("left-up").of(each)).said for each in shots}) == 1


def test_means_are_those_of_measured_pixels():
    """Of a leaf cut out of its photos, and where masks are strewn over them; too few tell nothing."""
    measured = torch.rand(9, 16, 16, generator=torch.Generator().manual_seed(0)) > 0.2
    measured[:, :8] = False
    shots = replace(photos_of(make_material("tiles", 16)), photos=0.5 * measured[..., None].float().expand(
        9, 16, 16, 3), measured=measured, calibration="none")
    light, known = mean_radiance(shots, 4)
    assert torch.equal(known, torch.tensor([False, False, True, True])[:, None].expand(9, 4, 4))
    assert torch.allclose(light[known], decode(torch.tensor(0.5), shots.transfer).double())
    assert why_not(shots) == "the photos are all alike"  # and not too dark


def test_a_photo_that_is_masked_whole_tells_nothing_of_its_view(made, shots):
    hidden = shots[0].measured.clone()
    hidden[4] = False
    priors = Priors(common_flash=(0.0, 0.0))
    found = refine_views(made, shots[0].views, replace(shots[0], measured=hidden), priors)
    wanted = torch.tensor([*priors.camera, *priors.flash, priors.exposure], dtype=torch.float64)
    assert torch.allclose(found.deviation[4], wanted, rtol=1e-6) and found.change[4].abs().max() < 1e-9
    assert (found.deviation[0] < 0.9 * wanted).any()


@pytest.mark.slow
def test_cross_validation_of_masked_photos_whose_side_is_no_multiple_of_64():
    shots = photos_of(make_material("tiles", 66))
    method = method_of(replace(shots, measured=shots.photos[..., 0] < 0.9), exact=False)
    assert reached(Stage.FINE, method).stages.detail > 0


def test_rounds_of_the_fit(shots):
    """From one start: what masks hide shapes the start alone, through the guess."""
    methods = [Hierarchical(FitTask(each, MITSUBA, HierarchicalConfig())) for each in shots]
    start = methods[0].answer
    for method in methods:
        method.answer = start
        method.solve()
    assert torch.equal(*(method.answer.x for method in methods))
    assert not torch.equal(methods[0].answer.x, start.x)


@pytest.mark.parametrize("config", [
    DirectConfig(iterations=3), HybridConfig(iterations=3, width=8, adversarial=0.1),
    GanConfig(iterations=2, width=8)], ids=lambda config: type(config).__name__)
def test_maps_of_the_other_methods(shots, config):
    found = [fit_svbrdf(each, ANALYTIC, config) for each in (*shots, replace(shots[0], measured=None))]
    check_photos(found[0], shots[1])
    first, second, unmasked = (each.svbrdf for each in found)
    assert all(torch.equal(first[name], second[name]) for name in first.maps)
    assert not any(torch.equal(first[name], unmasked[name]) for name in ("diffuse", "roughness"))


@pytest.mark.parametrize("kind, config", [(Direct, DirectConfig()), (Hybrid, HybridConfig(adversarial=0))])
def test_a_step_whatever_a_mask_hides(shots, kind, config):
    """From one start, and with one input of the network."""
    methods = [kind(FitTask(each, ANALYTIC, config, torch.full((SIDE, SIDE, 3), 0.3))) for each in shots]
    methods[1].condition = getattr(methods[0], "condition", None)
    start = methods[0].estimate()[0]
    first, second = (method.step(0.5) and method.estimate()[0] for method in methods)
    assert all(torch.equal(first[name], second[name]) for name in first.maps)
    assert not torch.equal(first["diffuse"], start["diffuse"])


def test_a_discriminator_sees_no_difference_from_the_truth(made, shots):
    """The same photos without a mask have one."""
    rendered = ANALYTIC.render(made, shots[1].views)
    for capture, masked in (shots[1], True), (replace(shots[1], measured=None), False):
        for photo, some in enumerate((~shots[1].measured).any(dim=(1, 2)).tolist()):
            pictures = PictureSource(capture).whole(photo)
            beside = (pictures.of(rendered[[photo]]) - pictures.shown).abs().max()
            assert (beside < 0.51 / 255) == (masked or not some)  # photos of 8 bits


def test_a_guess_without_a_photo_that_is_masked_whole(shots):
    hidden = shots[0].measured.clone()
    hidden[4] = False
    first = guess_diffuse(replace(shots[1], measured=hidden))
    second = guess_diffuse(shots[1].pick([n for n in range(len(hidden)) if n != 4]))
    # float32 sums of nine terms and of eight, after eight steps: 4e-4; with photo 4: 0.0094
    assert (first - second).abs().max() < 1e-3 < (guess_diffuse(shots[1]) - second).abs().max()


def test_another_mask_is_another_capture(shots):
    first = replace(shots[0], measured=None)
    told = [fingerprints(HierarchicalConfig(), each, ANALYTIC, {}) for each in (first, shots[0])]
    assert [told[0][name] != told[1][name] for name in told[0]] == [name[:6] == "photo " for name in told[0]]


def test_masks_go_with_their_photos(shots):
    capture = shots[0]
    halves = capture.averaged(SIDE // 2).measured[[0, 1]]
    assert halves.tolist() == [[[row > 2] * 8 for row in range(8)], [[True] * 8] * 8]  # the sixth row is half
    assert capture.sampled(SIDE // 2).measured[0, :, 0].tolist() == [row > 1 for row in range(8)]
    assert torch.equal(capture.pick([3, 1]).measured, capture.measured[[3, 1]])
