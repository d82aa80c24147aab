"""Known materials come back, and photos of a simulation are told from a phone's."""

import dataclasses

import pytest
import torch
from helpers import GRID, MITSUBA, photos_of
from helpers.hierarchical_fits import SIDE, left_alone
from helpers.variants import mostly_slow

from mitsvbrdf import color
from mitsvbrdf.capture import Capture
from mitsvbrdf.evaluate.photos import evaluate_fit
from mitsvbrdf.fit import DirectConfig, HierarchicalConfig, fit_svbrdf
from mitsvbrdf.fit.hierarchical import stages
from mitsvbrdf.fit.hierarchical.stages import Stage
from mitsvbrdf.material.made import MATERIALS, make_material
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.measure.metrics import map_rmse
from mitsvbrdf.views import Views


def flash_beside(offset):
    """Photos' true views: the flash so far (x, y) from where the grid says."""
    return Views.of(GRID.camera, GRID.light + torch.tensor([*offset, 0.0]), GRID.intensity)


# ---- known materials ----

# Mean map RMSE at 32 px, worst of seeds 0 to 9: inlay 0.0151, tiles 0.0104, leather 0.0041, plates 0.0161.
# From one start alone, seeds 1 to 5 and 7 of tiles ended at 0.026, and all of plates at 0.038, as the last
# bits decide. `direct` after 150 steps: 0.078, 0.067, 0.014, 0.046. A third more is allowed.
@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name, error", [
    ("inlay", 0.020), ("tiles", 0.014), ("leather", 0.0055), ("plates", 0.021)])
def test_known_materials_come_back(name, error, seed):
    truth = make_material(name, SIDE)
    capture = photos_of(truth)
    result = fit_svbrdf(capture, MITSUBA, HierarchicalConfig(seed=seed))
    assert isinstance(result.config, HierarchicalConfig) and result.stopped == "settled" and not result.undone
    mean = map_rmse(result.svbrdf, truth)["mean"]
    assert mean < error
    assert result.rerender_rmse < 0.0015  # of 8 bits: their rounding alone is 1 / 255 / sqrt(12) = 0.00113
    if name != "plates" and seed == 0:
        direct = fit_svbrdf(capture, MITSUBA, DirectConfig(iterations=60))
        assert mean < 0.5 * map_rmse(direct.svbrdf, truth)["mean"]


# Any level of F0 comes back, not the usual one alone. Where that counted for each texel instead of each basis
# material, the same ended at 0.0519, 0.0125 and 0.0381.
@pytest.mark.parametrize("name, f0, error", mostly_slow([
    ("plates", 0.3, 0.0165), ("leather", 0.1, 0.0040), ("tiles", 0.02, 0.0330)]))
def test_levels_that_are_not_the_usual_one_come_back(name, f0, error):
    made = make_material(name, SIDE)
    truth = SVBRDF(made.bsdf, {**made.maps, "specular": torch.full_like(made["specular"], f0)})
    assert map_rmse(fit_svbrdf(photos_of(truth), MITSUBA, HierarchicalConfig()).svbrdf, truth)["mean"] < error


def broad(name):
    """A material with one lobe that is as broad as its diffuse reflection."""
    made = make_material(name, SIDE)
    return SVBRDF(made.bsdf, {**made.maps, "roughness": torch.full_like(made["roughness"], 0.95),
                              "specular": torch.full_like(made["specular"], 0.04)})


@pytest.mark.slow
def test_a_broad_lobe_that_photos_leave_open_has_the_usual_level():
    # Measured: specular 0.0056, and 0.0535 where the usual level does not count; the mean 0.0125 and 0.031.
    truth = broad("leather")
    errors = map_rmse(fit_svbrdf(photos_of(truth, noise=0.003), MITSUBA, HierarchicalConfig()).svbrdf, truth)
    assert errors["specular"] < 0.012 and errors["mean"] < 0.02


@pytest.mark.slow
def test_a_broad_lobe_that_noise_hides_in_each_texel_is_found_in_all_of_them():
    # Measured 0.0285. From lobes of texels on their own alone, in this draw of four: 0.155, specular 0.18.
    truth, generator = broad("tiles"), torch.Generator().manual_seed(101)
    linear = photos_of(truth).linear
    noisy = linear + 0.003 * torch.randn(linear.shape, generator=generator)
    capture = Capture((color.to_display(noisy.clamp(0, 1)) * 255).round() / 255, GRID)
    assert map_rmse(fit_svbrdf(capture, MITSUBA, HierarchicalConfig()).svbrdf, truth)["mean"] < 0.04


@pytest.mark.slow
def test_known_material_at_more_than_the_coarse_size(two_stages, capture):
    result = fit_svbrdf(capture, MITSUBA)  # Measured 0.0043: no worse than without the coarse stage.
    assert result.svbrdf.resolution == SIDE and result.stopped == "settled"
    assert map_rmse(result.svbrdf, make_material("leather", SIDE))["mean"] < 0.006


# ---- which kind of photos ----

@pytest.mark.parametrize("name", mostly_slow(MATERIALS, "inlay"))
def test_photos_of_the_model_are_exact(name):
    # Measured 0.0002 to 0.0004, and 0.0020 with this much noise; the limit is 0.006.
    truth = make_material(name, SIDE)
    for noise in (0.0, 0.003):
        method = left_alone(photos_of(truth, noise=noise))
        assert method.stages.exact and method.stages.stage == Stage.MULTI_START and not method.stages.tied
        assert not method.corrections.may_move(method.stages.tied)
        # And the RMSE is that of rounding to 8 bits, 0.00113, or of the noise in dark photos.
        structure, rmse = method.stages.unexplained
        assert structure < 0.5 * stages.EXACT and 0.0009 < rmse < 0.02


def camera_elsewhere(material):
    camera = GRID.camera.clone()
    camera[3] += torch.tensor([0.4, 0.3, 0.0])
    return photos_of(material, Views.of(camera, intensity=GRID.intensity)).photos


def automatic_exposure(material):
    times = (0.1 * torch.randn(9, 1, 1, 1, generator=torch.Generator().manual_seed(0))).exp()
    return color.to_display(photos_of(material).linear * times)


def badly_aligned(material):
    """Each photo half a pixel off, every one in a direction of its own."""
    photos = photos_of(make_material("inlay", 4 * SIDE)).photos
    shifted = [photo.roll((2 * (i % 3 - 1), 2 * (i // 3 - 1)), (0, 1)) for i, photo in enumerate(photos)]
    return Capture(torch.stack(shifted), GRID).averaged(SIDE).photos


@pytest.mark.parametrize("wrong", [camera_elsewhere, automatic_exposure, badly_aligned])
def test_photos_that_do_not_follow_the_model_are_not(wrong):
    # Measured 0.041, 0.016, 0.023; the limit is 0.006. Nine photos of a texel do not show that its lobe is no
    # GGX (0.0007), nor how they encode light (0.0004), and a flash beside the lens looks like tilted normals
    # (0.0011).
    method = left_alone(Capture(wrong(make_material("inlay", SIDE)), GRID))
    assert not method.stages.exact and method.stages.stage == Stage.TOGETHER and method.stages.tied
    assert method.corrections.may_move(method.stages.tied)
    assert method.stages.unexplained[0] > 2 * stages.EXACT


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tiles", "inlay", "leather"])
def test_flash_beside_the_lens_is_found(name, phone):
    # Measured (-0.061, 0.020), (-0.041, 0.014) and (-0.047, -0.013): tilted normals keep a part. Off by 0.05
    # to 0.08 of 0.11.
    offset = torch.tensor([-0.1, 0.05])
    shots = dataclasses.replace(photos_of(make_material(name, SIDE), flash_beside(offset)), views=GRID)
    result = fit_svbrdf(shots, MITSUBA)
    found = torch.tensor(result.flash_offset)
    assert found[0] < -0.035 and (found - offset).norm() < 0.85 * offset.norm()
    fixed = fit_svbrdf(shots, MITSUBA, HierarchicalConfig(flash_offset=False, calibrate=False))
    assert fixed.flash_offset is None and torch.equal(fixed.views.light, shots.views.light)
    assert result.rerender_rmse < fixed.rerender_rmse
    assert fixed.calibrated_rmse is None  # it moved no view
    stated = evaluate_fit(result, shots)["calibrated"]["rerender_rmse"]
    assert result.calibrated_rmse == pytest.approx(stated, rel=1e-5)
