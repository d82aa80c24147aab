"""The simulated phone's photos: vignetting, noise, exposure, spoiling, and the command."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from helpers.phones import SMALL
from helpers.rigs import lens_and_poses

from mitsvbrdf import cli, color, make_material
from mitsvbrdf.capture.align.sheet import Sheet
from mitsvbrdf.capture.lens import Lens, project
from mitsvbrdf.capture.photo import Photo
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.synth.phone import HandheldPhone, handheld_poses, shots
from mitsvbrdf.synth.photos import READ, SHOT, developed, handheld_photos, spoiled, write_handheld
from mitsvbrdf.synth.traced import HandheldRenderer


def test_vignetting_and_srgb_of_a_photo():
    lens = Lens((401, 301), 300.0, vignetting=(-0.3, 0.1))
    pixels = developed(np.full((301, 401, 3), 0.5, dtype=np.float32), lens, 0)

    def srgb(x):
        return round(255 * (1.055 * x ** (1 / 2.4) - 0.055))

    assert (pixels[150, 200] == srgb(0.5)).all()
    r2 = (200**2 + 150**2) / (200.5**2 + 150.5**2)
    assert (pixels[0, 0] == srgb(0.5 * (1 - 0.3 * r2 + 0.1 * r2**2))).all()


def test_noise_is_that_of_light_and_sensor():
    lens, light = Lens((400, 300), 300.0), 0.4
    pixels = developed(np.full((300, 400, 3), light, dtype=np.float32), lens, 4.0, seed=3)
    linear = color.decode(torch.from_numpy(pixels / 255.0), "srgb")
    # 360000 samples: the deviation is known to 0.12 %, rounding to 8 bits (0.0019 linear) adds 0.15 %.
    assert float(linear.std()) == pytest.approx(4 * math.sqrt(READ**2 + SHOT * light), rel=0.01)
    assert float(linear.mean()) == pytest.approx(light, rel=1e-3)


@pytest.mark.parametrize("sheet", [None, 18.0, 12.0])
def test_hands_keep_the_patch_in_the_photo(sheet):
    phone = HandheldPhone(sheet=sheet, seed=4)
    half = (Sheet(sheet).outer if sheet else 11.5) / 2
    square = np.array([[x, y, 0.0] for x in (-half, half) for y in (-half, half)])
    poses = handheld_poses(phone, 20)
    for pose in poses:
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
        seen = project(phone.lens, pose, square)
        assert seen.min() > 0 and (seen.max(axis=0) < phone.lens.size).all()
        assert math.degrees(math.acos(-pose.rotation[2, 2])) <= phone.tilt
        assert 1.8 < pose.position[2] / phone.patch < 2.6
    spread = np.ptp([pose.position[:2] for pose in poses], axis=0) / phone.patch
    assert (spread > 0.7).all()  # the nine-view grid spans 0.8


def test_the_sheets_tags_are_where_they_should_be():
    phone = HandheldPhone(megapixels=2.0, sheet=18.0, depth=0.5, grain=0, photos=1)
    photos, truth = handheld_photos(flat(8), phone, HandheldRenderer)
    (shot, pixels), = photos
    options = cv2.aruco.DetectorParameters()
    options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11),
                                       options)
    corners, ids, _ = detector.detectMarkers(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))
    found = {int(i): c.reshape(4, 2) for i, c in zip(np.asarray(ids).ravel(), corners)}
    assert sorted(found) == list(range(16)) and truth["depth_cm"] == 0.5 and truth["sheet_cm"] == 18.0
    errors = []
    for number, at in Sheet(18.0).corners.items():
        aim = project(phone.lens, shot.pose, at + (0, 0, 0.5))
        # detectors differ in the corner they begin with
        turned = [np.roll(found[number], k, axis=0) - aim for k in range(4)]
        errors.append(min(turned, key=lambda e: np.abs(e).max()))
    # Measured: RMS 0.25 pixels, mean 0.01; taken for a sheet at depth 0: RMS 7.6
    assert np.sqrt(np.square(errors).mean()) < 0.5 and np.abs(np.mean(errors, axis=(0, 1))).max() < 0.05


def test_the_exposure_suits_the_first_photo():
    """Of a dull sample its mean is 0.25, of a mirror-like one 2 % of the values are clipped."""
    phone = HandheldPhone(megapixels=0.1, photos=1, grain=0)

    def first(maps):
        (_, pixels), = handheld_photos(maps, phone, HandheldRenderer)[0]
        return pixels

    dull = first(flat(8, diffuse=0.5, specular=0.0))
    assert float(color.decode(torch.from_numpy(dull / 255.0), "srgb").mean()) == pytest.approx(0.25, rel=0.01)
    shiny = first(flat(8, diffuse=0.01, specular=0.5, roughness=0.4))
    assert (shiny == 255).mean() == pytest.approx(0.02, abs=0.001) and shiny.mean() < dull.mean()


@pytest.mark.slow
def test_spoiled_photos_are_what_they_are_called():
    kinds = ("blurred", "finger", "noflash", "duplicate", "rotated", "unrelated")
    phone = HandheldPhone(megapixels=0.1, photos=3, side=40.0)
    photos, truth = handheld_photos(flat(8, diffuse=0.5, specular=0.0), phone, HandheldRenderer, spoil=kinds)
    taken = {shot.name: (shot, pixels.astype(float)) for shot, pixels in photos}
    assert list(taken) == [f"IMG_{i:04d}.jpg" for i in range(1, 10)]
    assert truth["spoiled"] == dict(zip(list(taken)[3:], kinds))
    blurred, finger, noflash, duplicate, rotated, unrelated = list(taken.values())[3:]
    first = taken["IMG_0001.jpg"][1]
    assert blurred[1].mean() == pytest.approx(first.mean(), rel=0.2)  # nothing to blur here, see below
    height, width = first.shape[:2]
    left, right = finger[1][height // 2, width // 8], finger[1][height // 2, 7 * width // 8]
    assert left.max() < 70 and left[0] > 1.5 * left[2] and right.min() > 80
    # Light from everywhere and a diffuse sample of albedo 0.5: the same radiance 0.35 * 0.5 everywhere, 116
    # in 8 bits.
    lens = phone.lens
    middle = noflash[1][height // 2 - 9 : height // 2 + 9, width // 2 - 9 : width // 2 + 9]
    assert middle.mean() == pytest.approx(255 * (1.055 * 0.175 ** (1 / 2.4) - 0.055), abs=1)
    of = taken["IMG_0003.jpg"]
    assert of[0].pose is duplicate[0].pose and 0.5 < np.abs(of[1] - duplicate[1]).mean() < 4
    # Orientation 6 is shown turned clockwise: left as stored, where the world's y points, is up then.
    assert rotated[0].orientation == 6 and rotated[0].pose.rotation[0, 1] < -0.9
    assert np.linalg.norm(rotated[0].pose.flash(lens) - rotated[0].pose.position) == pytest.approx(
        math.hypot(1.5, 0.4))
    (red, _, blue), (same, _, as_well) = unrelated[1].mean(axis=(0, 1)), first.mean(axis=(0, 1))
    assert red > blue + 5 and abs(same - as_well) < 1  # brown instead of grey


def test_blur_blurs():
    picture = np.zeros((300, 400, 3), dtype=np.float32)
    picture[150, 200] = 1
    blurred = spoiled(picture, "blurred")
    assert blurred.sum() == pytest.approx(3, rel=1e-4) and blurred.max() < 0.1
    assert spoiled(picture, None) is picture


def test_a_seed_gives_the_same_photos_and_another_others():
    maps = make_material("leather", 32)

    def taken(seed):
        photos, truth = handheld_photos(maps, HandheldPhone(megapixels=0.05, photos=2, seed=seed),
                                        HandheldRenderer)
        return np.stack([pixels for _, pixels in photos]), truth["rig"]["poses"]

    (first, poses), (again, same), (other, elsewhere) = taken(5), taken(5), taken(6)
    assert np.array_equal(first, again) and poses == same
    assert not np.array_equal(first, other) and poses != elsewhere


@pytest.mark.parametrize("wrong, match", [
    ({"megapixels": 0}, "megapixels"), ({"megapixels": math.nan}, "megapixels"), ({"photos": 0}, "photos"),
    ({"sheet": 2.0}, "sheet"), ({"depth": -1.0}, "depth"), ({"side": 1.0}, "side"),
    ({"side": 8.0, "sheet": 18.0}, "hole"), ({"tilt": 0.0}, "tilt"), ({"grain": -1.0}, "grain"),
    ({"jpeg": 101}, "jpeg"), ({"focal_35mm": 0.0}, "focal")])
def test_phones_that_cannot_be(wrong, match):
    with pytest.raises(ConfigError, match=match):
        HandheldPhone(**wrong).check()


def test_a_phone_that_never_shows_the_patch_or_no_light_is_refused():
    with pytest.raises(ConfigError, match="can show the whole patch"):
        handheld_poses(HandheldPhone(centre=(2500.0, 0.0)), 1)
    for v1 in (-9.0, math.nan):
        with pytest.raises(ConfigError, match="light in the first photo"):
            handheld_photos(flat(8), replace(SMALL, vignetting=(v1, 0.0)), Grey)


@pytest.mark.parametrize("kinds", [("blurry",), ("finger", "finger")])
def test_spoiling_that_is_not_known(kinds):
    with pytest.raises(ConfigError, match="each once"):
        shots(SMALL, spoil=kinds)


def test_the_command_writes_photos_and_their_truth(tmp_path, capsys):
    raw = tmp_path / "raw"
    assert cli.main(["synth", "builtin:tiles", "--handheld", "-o", str(raw), "--megapixels", "0.1",
                     "--photos", "3", "--resolution", "32", "--spoil", "noflash", "--seed", "2"]) == 0
    assert sorted(p.name for p in raw.iterdir() if p.is_file()
                  and p.suffix) == [f"IMG_{i:04d}.jpg" for i in range(1, 5)]
    photo, dark = (Photo.open(raw / f"IMG_000{i}.jpg") for i in (1, 4))
    assert photo.size == HandheldPhone(megapixels=0.1).lens.size and photo.orientation == 1
    assert photo.exif["35 mm focal length"] == 26 and photo.exif["ISO"] == 100
    assert photo.exif["exposure time"] == pytest.approx(1 / 60) and photo.exif[
        "focal length"] == pytest.approx(5.8, abs=0.01)
    assert (photo.exif["flash"], dark.exif["flash"]) == ("fired", "off")
    truth = json.loads((raw / "truth" / "truth.json").read_text())
    assert truth["material"] == "tiles" and truth["sample_cm"] == 24.0 and truth["phone"]["seed"] == 2
    lens, poses = lens_and_poses(truth["rig"])
    assert list(poses) == [f"IMG_{i:04d}.jpg" for i in range(1, 5)] and lens.distortion == (0.06, -0.04)
    assert (raw / "truth" / "sample" / "normal.exr").is_file() and not (raw / "truth" / "maps").exists()
    pixels = photo.pixels()
    assert 60 < pixels.mean() < 160 and (pixels == 255).mean() < 0.05  # a photo that is well exposed


class Grey:
    """In the place of the traced scene: the same light everywhere."""

    def __init__(self, svbrdf, side, sheet, depth):
        pass

    def render(self, lens, pose, **light):
        return np.full((*lens.size[::-1], 3), 0.5, dtype=np.float32)


def test_true_maps_within_a_sheet_are_those_of_the_patch(tmp_path):
    """Of a ramp over 19 cm the patch of 11.52 cm in the middle: the known maps to hold a fit against."""
    side, phone = 190, replace(SMALL, megapixels=0.05, photos=1, sheet=18.0)
    at = (torch.arange(side) + 0.5) / side
    across, down = at.expand(side, side), at[:, None].expand(side, side)
    known = flat(side)
    known.maps["diffuse"], known.maps["roughness"] = torch.stack((across, down, across), dim=-1), down[...,
                                                                                                       None].clone()
    write_handheld(known, phone, Grey, tmp_path)
    found, whole = load_maps(tmp_path / "truth" / "maps"), load_maps(tmp_path / "truth" / "sample")
    assert (found.resolution, whole.resolution) == (115, 190)  # texels of one size
    share = 11.52 / 19
    want = 0.5 + share * ((torch.arange(115) + 0.5) / 115 - 0.5)
    # Halves in the files round by up to 0.00025, float32 places of texels do not count beside that
    assert float((found["diffuse"][..., 0] - want).abs().max()) < 5e-4
    assert float((found["diffuse"][..., 1] - want[:, None]).abs().max()) < 5e-4
    assert float((found["roughness"][..., 0] - want[:, None]).abs().max()) < 5e-4
    assert float((whole["diffuse"][..., 0] - across).abs().max()) < 5e-4


@pytest.mark.parametrize("arguments", [
    ["--sheet", "18"], ["--spoil", "finger"], ["--handheld", "--spoil", "nonsense"],
    ["--handheld", "--noise", "0.1", "--photos", "1", "--megapixels", "0.05"],
    ["--handheld", "--megapixels", "1000"], ["--handheld", "--seed", "-1"]])
def test_options_that_do_not_go_together(tmp_path, capsys, arguments):
    assert cli.main(["synth", "builtin:tiles", "-o", str(tmp_path / "out"), "--resolution", "16",
                     *arguments]) == 2
    assert capsys.readouterr().err.startswith("error: expected") and not (tmp_path / "out").exists()
