"""Flash, vignetting, exposures and power from shading, against photos made by the closed form; tolerances are
what was measured over ten seeds, and half as much again."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.variants import mostly_slow

from mitsvbrdf.capture import read_capture
from mitsvbrdf.capture.lens import Lens, Pose, on_plane, project
from mitsvbrdf.capture.light.samples import Samples, material_samples
from mitsvbrdf.capture.light.shading import shading_of_material, shading_of_paper, tint_of
from mitsvbrdf.capture.rig import Rig
from mitsvbrdf.errors import CaptureError
from mitsvbrdf.views import texel_positions

VIGNETTING = (-0.25, 0.05)
FLASH = {"cm": (1.3, -0.6, 0.0), "patch sides": (0.12, -0.05, 0.0)}
SIDE = 11.52  # cm
NOISE = 0.004  # of display values


def make_rig(unit, rng, count=9):
    size = SIDE if unit == "cm" else 1.0
    poses = {}
    for k in range(count):
        at = np.append(0.35 * rng.normal(size=2), 2.0 + 0.2 * rng.normal()) * size
        aim = np.append(0.1 * rng.normal(size=2), 0.0) * size
        poses[f"{k}.jpg"] = Pose.looking_at(at, aim, 1.5 * k)
    return Rig(Lens((192, 144), 144.0), poses, size, unit, "sheet" if unit == "cm" else "photos")


def true_lens(rig):
    return replace(rig.lens, flash=FLASH[rig.unit], vignetting=VIGNETTING)


def light(points, pixels, lens, pose, exposure):
    """exp(e) T cos / d^2, cos and d spelled out with the upright (0, 0, 1)."""
    ray = pose.position + pose.rotation.T @ np.array(lens.flash) - points
    distance = np.sqrt((ray**2).sum(axis=1))
    r2 = (((pixels - (np.array(lens.size) - 1) / 2) ** 2).sum(axis=1)
          / (lens.size[0] ** 2 + lens.size[1] ** 2) * 4)
    passed = 1 + VIGNETTING[0] * r2 + VIGNETTING[1] * r2**2
    return math.exp(exposure) * passed * (ray @ (0, 0, 1)) / distance**3


def shown(radiance, rng, noise=NOISE):
    return np.round(np.clip(radiance.clip(0, 1) ** (1 / 2.2) + noise * rng.normal(size=radiance.shape), 0,
                            1) * 255) / 255


def paper_photos(rig, intensity, exposures, rng):
    """White paper everywhere."""
    lens, (width, height) = true_lens(rig), rig.lens.size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(float)
    photos = {}
    for (name, pose), exposure in zip(rig.poses.items(), exposures):
        points = np.pad(on_plane(lens, pose, pixels), ((0, 0), (0, 1)))
        radiance = 0.8 / math.pi * light(points, pixels, lens, pose, exposure)[:, None] * intensity
        photos[name] = np.rint(shown(radiance, rng) * 255).astype(np.uint8).reshape(height, width, 3)
    return photos


def border(points):
    """A frame of paper around the patch."""
    far = np.abs(points).max(axis=1)
    return (far > 0.6 * SIDE) & (far < 0.8 * SIDE)


def material_photos(rig, exposures, rng, f0=0.0, alpha=0.15, side=48, intensity=0.9 * math.pi * 4, even=()):
    """Blocks of random albedo under one flat lobe; photos in ``even`` have no flash."""
    lens, points = true_lens(rig), texel_positions(side).numpy().reshape(-1, 3) * rig.size
    albedo = (0.05 + 0.5 * rng.random((side // 4, side // 4, 3))).repeat(4, 0).repeat(4, 1).reshape(-1, 3)
    photos = {}
    for (name, pose), exposure in zip(rig.poses.items(), exposures):
        rays = pose.flash(lens) - points, pose.position - points
        half = sum(r / np.linalg.norm(r, axis=1, keepdims=True) for r in rays)
        tan2 = (half[:, :2] ** 2).sum(axis=1) / half[:, 2] ** 2
        lobe = f0 / 4 * (alpha * (1 + tan2) / (tan2 + alpha**2)) ** 2
        got = light(points, project(lens, pose, points), lens, pose, exposure)[:, None]
        radiance = 0.6 * albedo if name in even else intensity * got * (albedo + lobe[:, None]) / math.pi
        photos[name] = shown(radiance, rng).reshape(side, side, 3)
    return photos


def found(shading):
    return np.array([*shading.lens.flash, *shading.lens.vignetting])


def expected(rig):
    return np.array([*FLASH[rig.unit], *VIGNETTING])


@pytest.mark.parametrize("case, kind", mostly_slow(
    [(case, kind) for case in ("brighter", "darker", "all") for kind in ("glossy", "paper")], "all"))
def test_exposures_that_were_not_locked(case, kind):
    rng = np.random.default_rng(2)
    rig, one = make_rig("cm", rng), np.eye(9)[4] * math.log(2)
    exposures = {"brighter": one, "darker": -one, "all": 0.4 * rng.normal(size=9)}[case]
    if kind == "paper":
        photos = paper_photos(rig, np.full(3, 0.5 * math.pi * 20**2), exposures, rng)
        shading = shading_of_paper(rig, photos, "gamma2.2", border)
    else:
        photos = material_photos(rig, exposures, rng, 0.04, intensity=0.3 * math.pi * (2 * SIDE)**2)
        shading = shading_of_material(rig, photos, "gamma2.2")
    error = np.array(list(shading.log_exposure.values())) - exposures
    error -= np.median(error)
    assert np.abs(error).max() < 0.02
    assert (np.abs(error) < 3 * np.array(list(shading.exposure_deviations.values()))).all()


def test_paper_tells_flash_power_vignetting_and_exposures():
    rng = np.random.default_rng(1)
    rig, exposures = make_rig("cm", rng), 0.03 * rng.normal(size=9)
    intensity = np.array([0.9, 1.0, 1.1]) * math.pi * 20**2
    shading = shading_of_paper(rig, paper_photos(rig, intensity, exposures, rng), "gamma2.2", border)
    errors = np.abs(found(shading) - expected(rig))
    assert (errors < (0.01, 0.01, 0.05, 0.005, 0.005)).all(), errors
    # The mean of nine exposures looks like power: 0.03 / 3 of it is theirs, and their sum with it is exact.
    power = np.log(np.array(shading.intensity) / intensity)
    assert np.abs(power + np.mean(list(shading.log_exposure.values())) - exposures.mean()).max() < 0.005
    assert np.std(list(shading.log_exposure.values()) - exposures) < 0.001
    assert max(shading.evenness.values()) < 0.02
    assert shading.lens.focal == rig.lens.focal and "albedo of 0.8" in shading.notes[0]


@pytest.mark.slow
def test_paper_in_photos_of_half_the_size():
    rng = np.random.default_rng(3)
    rig = make_rig("cm", rng)
    photos = paper_photos(rig, np.full(3, math.pi * 400), np.zeros(9), rng)
    half = {name: p.reshape(72, 2, 96, 2, 3).mean(axis=(1, 3)).round().astype(np.uint8)
            for name, p in photos.items()}
    shading = shading_of_paper(rig, half, "gamma2.2", border)
    np.testing.assert_allclose(shading.intensity, math.pi * 400, rtol=0.005)
    assert np.abs(found(shading) - expected(rig))[:2].max() < 0.02


def test_paper_tells_a_photo_without_flash():
    rng = np.random.default_rng(11)
    rig = make_rig("cm", rng)
    photos = paper_photos(rig, np.full(3, math.pi * 400), np.zeros(9), rng)
    pixels = np.stack(np.meshgrid(np.arange(192), np.arange(144)), axis=-1)
    room = 0.5 * true_lens(rig).transmission(pixels)[..., None] * np.ones(3)
    photos["4.jpg"] = np.rint(shown(room, rng) * 255).astype(np.uint8)
    shading = shading_of_paper(rig, photos, "gamma2.2", border)
    assert shading.evenness["4.jpg"] > 0.9 and any("4.jpg" in note for note in shading.notes)
    assert max(e for name, e in shading.evenness.items() if name != "4.jpg") < 0.05
    np.testing.assert_allclose(shading.intensity, math.pi * 400, rtol=0.01)
    assert np.abs(found(shading) - expected(rig))[:2].max() < 0.02


@pytest.mark.slow
def test_deviations_of_paper_are_the_size_of_its_errors():
    sizes = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        rig, exposures = make_rig("cm", rng, 5), 0.03 * rng.normal(size=5)
        shading = shading_of_paper(rig, paper_photos(rig, np.full(3, 1000.0), exposures, rng), "gamma2.2",
                                   border)
        deviations = np.array([shading.deviations[k] for k in ("flash_x", "flash_y", "flash_z", "v1", "v2")])
        sizes.append((found(shading) - expected(rig)) / deviations)
    size = np.sqrt(np.mean(np.square(sizes)))

    assert 0.5 < size < 1.8, size  # measured: 1.2


@pytest.mark.slow
@pytest.mark.parametrize("f0", [0.0, 0.04])
def test_material_tells_flash_vignetting_and_exposures(f0):
    rng = np.random.default_rng(4)
    rig, exposures = make_rig("patch sides", rng), 0.02 * rng.normal(size=9)
    photos = material_photos(rig, exposures, rng, f0)
    for photo in photos.values():  # dust and scratches that shine: one texel in fifty
        photo[rng.random(photo.shape[:2]) < 0.02] = 0.95
    shading = shading_of_material(rig, photos, "gamma2.2")
    errors = found(shading) - expected(rig)
    assert (np.abs(errors[:3]) < (0.003, 0.003, 0.01)).all(), errors
    # transmission; v1 and v2 can stand in for each other
    assert np.abs(errors[3:] @ [[0.4], [0.16]]) < 0.005, errors
    assert np.std(list(shading.log_exposure.values()) - exposures) < 0.002
    assert max(shading.evenness.values()) < 0.05
    assert 0.2 < shading.intensity[0] / (0.9 * math.pi * 4) < 4  # a guess, and its deviation says so
    assert 0.3 < shading.deviations["log_intensity"] < 1.2 and "how bright" in shading.notes[0]


@pytest.mark.slow
def test_photo_without_flash_is_told_and_does_not_count():
    rng = np.random.default_rng(5)
    rig = make_rig("patch sides", rng)
    photos = material_photos(rig, np.zeros(9), rng, 0.02, even=("3.jpg",))
    shading = shading_of_material(rig, photos, "gamma2.2")
    assert shading.evenness["3.jpg"] > 0.8
    assert max(e for name, e in shading.evenness.items() if name != "3.jpg") < 0.1
    assert np.abs(found(shading) - expected(rig))[:2].max() < 0.005
    assert any("3.jpg" in note for note in shading.notes)


def test_photos_that_are_all_without_flash_are_noted():
    rng = np.random.default_rng(4)
    rig = make_rig("patch sides", rng)
    shading = shading_of_material(rig, material_photos(rig, np.zeros(9), rng, even=tuple(rig.poses)),
                                  "gamma2.2")
    assert any("of 9 photos: where it comes from is a guess" in note for note in shading.notes)


def test_one_photo_tells_nothing_and_leaves_what_was_expected():
    rng = np.random.default_rng(6)
    rig = make_rig("patch sides", rng, 1)
    shading = shading_of_material(rig, material_photos(rig, [0.0], rng), "gamma2.2")
    assert np.abs(found(shading)).max() < 1e-6
    np.testing.assert_allclose([shading.deviations[k] for k in ("flash_x", "flash_y", "v1")], (0.1, 0.1, 0.3),
                               rtol=1e-3)
    assert shading.evenness == {"0.jpg": 0.0} and np.isfinite(shading.intensity).all()


@pytest.mark.slow
def test_photos_that_do_not_reach_the_whole_patch():
    rng = np.random.default_rng(7)
    rig = make_rig("patch sides", rng)
    photos = {name: p.astype(np.float32) for name, p in material_photos(rig, np.zeros(9), rng).items()}
    for photo in photos.values():
        photo[:, :8] = np.nan
    shading = shading_of_material(rig, photos, "gamma2.2")
    assert np.abs(found(shading) - expected(rig))[:2].max() < 0.003
    assert np.isfinite([*shading.intensity, *shading.deviations.values()]).all()


@pytest.mark.parametrize("value", [0.0, 1.0, math.nan])
def test_dark_or_clipped_photos_are_refused(value):
    rig = make_rig("patch sides", np.random.default_rng(8), 3)
    photos = {name: np.full((16, 16, 3), value) for name in rig.poses}
    with pytest.raises(CaptureError, match="neither clipped nor dark"):
        shading_of_material(rig, photos, "srgb")


def test_no_paper_is_refused():
    rig = make_rig("cm", np.random.default_rng(9), 3)
    photos = {name: np.full((144, 192, 3), 128, np.uint8) for name in rig.poses}
    with pytest.raises(CaptureError, match="white paper"):
        shading_of_paper(rig, photos, "srgb", lambda points: np.zeros(len(points), bool))


@pytest.mark.slow
def test_a_white_balance_that_drifts_is_the_light_s_colour_in_these_photos():
    """Factors of linear rgb, known, in three of nine photos of paper; the others keep theirs to the bit."""
    rng = np.random.default_rng(5)
    rig = make_rig("cm", rng)
    photos = paper_photos(rig, np.full(3, 600.0), np.zeros(9), rng)
    plain, drift = shading_of_paper(rig, photos, "gamma2.2", border), np.array([1.25, 1.0, 0.8])
    assert plain.tint == {} and not any("white balance" in note for note in plain.notes)
    for name in ("2.jpg", "5.jpg", "7.jpg"):
        photos[name] = np.rint(photos[name] * drift ** (1 / 2.2)).clip(0, 255).astype(np.uint8)
    found = shading_of_paper(rig, photos, "gamma2.2", border)
    assert set(found.tint) == {"2.jpg", "5.jpg", "7.jpg"}
    for factors in found.tint.values():
        np.testing.assert_allclose(factors / factors[1], drift, rtol=0.01)
    assert any("white balance differs in 2.jpg" in note for note in found.notes)
    np.testing.assert_allclose(found.intensity, plain.intensity, rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6, 7])
@pytest.mark.parametrize("f0", [0.04, 0.3])
def test_highlights_that_pale_are_no_white_balance_but_a_drift_is(seed, f0):
    """Coloured texels under a white lobe; without the spread over texels, seed 7 of 0.3 was off by 4 %."""
    rng = np.random.default_rng(seed)
    rig = make_rig("patch sides", rng)
    photos = material_photos(rig, np.zeros(9), rng, f0=f0, alpha=0.3)
    plain = shading_of_material(rig, photos, "gamma2.2")
    assert plain.tint == {} and not any("white balance" in note for note in plain.notes)
    if f0 == 0.04:
        for name in ("2.jpg", "5.jpg", "7.jpg"):
            photos[name] = (photos[name] * np.array([1.25, 1.0, 0.8]) ** (1 / 2.2)).clip(0, 1)
        (note,) = (n for n in shading_of_material(rig, photos, "gamma2.2").notes if "white balance" in n)
        assert all(name in note for name in ("2.jpg", "5.jpg", "7.jpg")) and note.count(".jpg") == 3


@pytest.mark.slow
def test_real_photos_in_one_white_balance_have_no_drift(data_folder):
    """Of eighteen materials; a drift put into three photos of two matt ones is found in these three alone."""
    rig = make_rig("patch sides", np.random.default_rng(0))

    def drifting(photos):
        seen = {name: material_samples(photo, rig.lens, pose, rig.size, "gamma2.2")
                for photo, (name, pose) in zip(photos, rig.poses.items())}
        return set(tint_of(Samples.of(rig, seen, "the material", glossy=True)))

    folders = sorted(path.parent for path in data_folder.glob("captures/*/capture.json"))
    for folder in folders:
        photos = read_capture(folder, resolution=256).photos.numpy()
        assert drifting(photos) == set(), folder.name
        if folder.name in ("stone-smalltile", "wall-plaster-green"):
            photos[[2, 5, 7]] = (photos[[2, 5, 7]] * np.float32((1.25, 1, 0.8)) ** (1 / 2.2)).clip(0, 1)
            assert drifting(photos) == {"2.jpg", "5.jpg", "7.jpg"}
    assert len(folders) == 18
