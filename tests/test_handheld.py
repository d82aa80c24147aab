"""The simulated phone: its pictures, its lens, and what a capture made of them is told about the truth."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from mitsvbrdf import cli, color, make_material, make_renderer
from mitsvbrdf.capture import Capture, write_capture
from mitsvbrdf.capture.align.sheet import Sheet
from mitsvbrdf.capture.lens import Lens, Pose, on_plane, project
from mitsvbrdf.capture.photo import Photo
from mitsvbrdf.capture.rectify import rectified
from mitsvbrdf.capture.rig import Rig, rig_from_json, rig_to_json
from mitsvbrdf.errors import CaptureError, ConfigError
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.synth import traced
from mitsvbrdf.synth.against_truth import PIXELS, compare_with_truth
from mitsvbrdf.synth.phone import HandheldPhone, handheld_poses, shots
from mitsvbrdf.synth.photos import READ, SHOT, developed, handheld_photos
from mitsvbrdf.synth.traced import HandheldRenderer
from mitsvbrdf.synth.truth import Similarity, Truth, rig_of, similarity, true_capture, truth_maps
from mitsvbrdf.views import Views

SMALL = HandheldPhone(megapixels=0.2, jpeg=0)
DOWN = np.diag([1.0, -1.0, -1.0])


def frontal(side: float, resolution: int, position, flash) -> tuple[Lens, Pose]:
    """A camera that looks straight down and whose pixels are the texels of a sample."""
    focal = resolution * position[2] / side
    centre = tuple((resolution - 1) / 2 + focal / position[2] * np.array((position[0], -position[1])))
    return Lens((resolution, resolution), focal, centre, flash=flash), Pose(np.array(position), DOWN)


@pytest.mark.parametrize("material", ["inlay", "principled"])
def test_the_scene_is_the_analytic_renderers(material):
    """Pixels that are texels, camera and flash apart: no resampling is left between the two."""
    maps = make_material("inlay", 48)
    if material == "principled":
        base = {"base_color": maps["diffuse"], "metallic": 1 - maps["roughness"]}
        maps = type(maps)("principled", base | {name: maps[name] for name in ("roughness", "normal")})
    lens, pose = frontal(12.0, 48, (1.5, -2.0, 23.0), (1.5, 0.4, -0.2))
    np.testing.assert_allclose(pose.flash(lens), (3.0, -2.4, 23.2))
    seen = HandheldRenderer(maps, 12.0, samples=1).render(lens, pose, intensity=700.0)
    views = Views.of([pose.position.tolist()], [pose.flash(lens).tolist()], 700.0, size=12.0)
    truth = make_renderer("analytic64").render(maps, views)[0].numpy()
    # Measured: 3.6e-6 of the brightest, 1.8e-6 of the mean
    assert np.abs(seen - truth).max() < 2e-5 * truth.max() and np.abs(seen - truth).mean() < 1e-5 * truth.mean()


def test_rays_go_where_the_lens_says():
    """Diffuse dots, tilted, turned and distorted, in closed form: tents of the map's texels under cos / d^2."""
    maps, side, power = flat(64, diffuse=0.0, specular=0.0), 20.0, 1000.0
    at = [(5, 7), (60, 4), (31, 33), (8, 58), (50, 55)]
    for row, column in at:
        maps["diffuse"][row, column] = 1.0
    lens = Lens((400, 300), 250.0, (203.0, 146.0), (0.2, -0.1), flash=(1.0, 0.0, 0.0))
    pose = Pose.looking_at((3.0, -4.0, 22.0), (0.5, 0.3, 0), 0.4)
    seen = HandheldRenderer(maps, side, samples=1).render(lens, pose, intensity=power)[..., 0]
    pixels = np.stack(np.meshgrid(np.arange(400.0), np.arange(300.0)), axis=-1).reshape(-1, 2)
    points = np.column_stack((on_plane(lens, pose, pixels), np.zeros(len(pixels))))
    np.testing.assert_allclose(project(lens, pose, points), pixels, atol=1e-9)
    texels = np.array([((c + 0.5) / 64 - 0.5, 0.5 - (r + 0.5) / 64) for r, c in at]) * side
    tents = sum(np.prod(np.clip(1 - np.abs(points[:, :2] - texel) * 64 / side, 0, None), axis=1) for texel in texels)
    light = pose.flash(lens) - points
    truth = (tents / np.pi * power * light[:, 2] / np.linalg.norm(light, axis=1) ** 3).reshape(300, 400)
    dots = truth > 0
    assert dots.sum() > 250  # pixels
    # Measured: 1.2e-5 of the brightest; a hundredth of a pixel is 2e-3
    assert np.abs(seen - truth)[dots].max() < 1e-4 * truth.max()


def test_blocks_of_rows_leave_no_seam(monkeypatch):
    maps = make_material("leather", 32)
    lens, pose = SMALL.lens, Pose.looking_at((1, 2, 25), (0, 0, 0), 0.1)
    whole = HandheldRenderer(maps, 24.0, samples=1).render(lens, pose, intensity=500.0)
    monkeypatch.setattr(traced, "MOST_RAYS", 37 * lens.size[0])
    blocks = HandheldRenderer(maps, 24.0, samples=1).render(lens, pose, intensity=500.0)
    # Positions on the film are float32, rounded otherwise in a block: 1e-4 of a pixel, so 1e-4 or so of an edge.
    assert np.abs(blocks - whole).max() < 2e-3 and np.abs(blocks - whole).mean() < 1e-6


def test_a_photo_rectified_shows_what_the_analytic_renderer_says():
    """Distortion, tilt, turn, flash, vignetting and sRGB, there and back."""
    maps, phone = make_material("leather", 8).resized(128), HandheldPhone(megapixels=1.0, side=12.0, grain=0)
    lens, pose = phone.lens, Pose.looking_at((2.0, -3.0, 20.0), (0.3, 0.4, 0), 0.2)
    power = 600.0
    pixels = developed(HandheldRenderer(maps, 12.0).render(lens, pose, intensity=power), lens, 0)
    points = np.array([[x, y, 0.0] for y in (np.arange(64)[::-1] - 31.5) for x in (np.arange(64) - 31.5)]) * 12.0 / 64
    transmission = lens.transmission(project(lens, pose, points)).reshape(64, 64, 1)
    seen = color.decode(torch.from_numpy(rectified(pixels, lens, pose, 12.0, 64)), "srgb").numpy() / transmission
    views = Views.of([pose.position.tolist()], [pose.flash(lens).tolist()], power, size=12.0)
    truth = make_renderer("analytic64").render(maps, views)[0].numpy().clip(0, 1).reshape(64, 2, 64, 2, 3).mean(axis=(1, 3))
    inner = slice(1, -1)  # the outermost texels have the table beside them
    error = np.sqrt(np.square(seen - truth)[inner, inner].mean()) / truth.mean()
    assert error < 0.01  # measured: 0.0032, of 8 bits; with the vignetting of the photo left in 0.2


def test_the_flash_moves_the_highlight_and_turns_with_the_phone():
    """On a mirror-like sample it is halfway between the feet of camera and flash, both at one height."""
    maps = flat(8, diffuse=0.0, specular=0.5, roughness=0.1)
    scene = HandheldRenderer(maps, 24.0)
    lens = Lens((400, 300), 300.0, distortion=(0.06, -0.04), flash=(3.0, 1.0, 0.0))
    for turn in (0.0, math.pi / 2):
        pose = Pose.looking_at((1.0, 2.0, 20.0), (1.0, 2.0, 0.0), turn)
        seen = scene.render(lens, pose, intensity=1000.0)[..., 0]
        weight = np.where(seen > seen.max() / 2, seen, 0)
        row, column = (np.indices(seen.shape) * weight).sum(axis=(1, 2)) / weight.sum()
        halfway = (pose.position + pose.flash(lens))[:2] / 2
        # Measured: 0.009 cm; the highlight is 0.2 cm wide
        np.testing.assert_allclose(on_plane(lens, pose, np.array([[column, row]]))[0], halfway, atol=0.02)
    np.testing.assert_allclose(halfway, (0.5, 0.5), atol=1e-9)  # turned: what was right is down, what was down is left


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
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), options)
    corners, ids, _ = detector.detectMarkers(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))
    found = {int(i): c.reshape(4, 2) for i, c in zip(np.asarray(ids).ravel(), corners)}
    assert sorted(found) == list(range(16)) and truth["depth_cm"] == 0.5 and truth["sheet_cm"] == 18.0
    errors = []
    for number, at in Sheet(18.0).corners.items():
        aim = project(phone.lens, shot.pose, at + (0, 0, 0.5))
        turned = [np.roll(found[number], k, axis=0) - aim for k in range(4)]  # detectors differ in the corner they begin with
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


def test_spoiled_photos_are_what_they_are_called():
    kinds = ("blurred", "finger", "noflash", "duplicate", "rotated", "unrelated")
    phone = HandheldPhone(megapixels=0.1, photos=3, side=40.0)
    photos, truth = handheld_photos(flat(8, diffuse=0.5, specular=0.0), phone, HandheldRenderer, spoil=kinds)
    taken = {shot.name: (shot, pixels.astype(float)) for shot, pixels in photos}
    assert list(taken) == [f"IMG_{i:04d}.jpg" for i in range(1, 10)]
    assert [truth["spoiled"][name]["kind"] for name in list(taken)[3:]] == list(kinds)
    assert [kind["kind"] for kind in truth["spoiled"].values() if kind["usable"]] == ["rotated"]
    blurred, finger, noflash, duplicate, rotated, unrelated = list(taken.values())[3:]
    first = taken["IMG_0001.jpg"][1]
    assert blurred[1].mean() == pytest.approx(first.mean(), rel=0.2)  # this sample has nothing to blur, see below
    height, width = first.shape[:2]
    left, right = finger[1][height // 2, width // 8], finger[1][height // 2, 7 * width // 8]
    assert left.max() < 70 and left[0] > 1.5 * left[2] and right.min() > 80
    # Light from everywhere and a diffuse sample of albedo 0.5: the same radiance 0.35 * 0.5 everywhere, 116 in 8 bits.
    lens = phone.lens
    middle = noflash[1][height // 2 - 9 : height // 2 + 9, width // 2 - 9 : width // 2 + 9]
    assert middle.mean() == pytest.approx(255 * (1.055 * 0.175 ** (1 / 2.4) - 0.055), abs=1)
    of = taken[truth["spoiled"][duplicate[0].name]["of"]]
    assert of[0].pose is duplicate[0].pose and 0.5 < np.abs(of[1] - duplicate[1]).mean() < 4
    # Orientation 6 is shown turned clockwise: left as stored, where the world's y points, is up then.
    assert rotated[0].orientation == 6 and rotated[0].pose.rotation[0, 1] < -0.9
    assert np.linalg.norm(rotated[0].pose.flash(lens) - rotated[0].pose.position) == pytest.approx(math.hypot(1.5, 0.4))
    (red, _, blue), (same, _, as_well) = unrelated[1].mean(axis=(0, 1)), first.mean(axis=(0, 1))
    assert red > blue + 5 and abs(same - as_well) < 1  # brown instead of grey


def test_blur_blurs():
    from mitsvbrdf.synth.photos import spoiled
    picture = np.zeros((300, 400, 3), dtype=np.float32)
    picture[150, 200] = 1
    blurred = spoiled(picture, "blurred")
    assert blurred.sum() == pytest.approx(3, rel=1e-4) and blurred.max() < 0.1
    assert spoiled(picture, None) is picture


def test_a_seed_gives_the_same_photos_and_another_others():
    maps = make_material("leather", 32)

    def taken(seed):
        photos, truth = handheld_photos(maps, HandheldPhone(megapixels=0.05, photos=2, seed=seed), HandheldRenderer)
        return np.stack([pixels for _, pixels in photos]), truth["rig"]["poses"]

    (first, poses), (again, same), (other, elsewhere) = taken(5), taken(5), taken(6)
    assert np.array_equal(first, again) and poses == same
    assert not np.array_equal(first, other) and poses != elsewhere


@pytest.mark.parametrize("wrong, match", [
    ({"megapixels": 0}, "megapixels"), ({"megapixels": math.nan}, "megapixels"), ({"photos": 0}, "photos"),
    ({"sheet": 2.0}, "sheet"), ({"depth": -1.0}, "depth"), ({"side": 1.0}, "side"), ({"side": 8.0, "sheet": 18.0}, "hole"),
    ({"tilt": 0.0}, "tilt"), ({"grain": -1.0}, "grain"), ({"jpeg": 101}, "JPEG"), ({"focal_35mm": 0.0}, "focal")])
def test_phones_that_cannot_be(wrong, match):
    with pytest.raises(ConfigError, match=match):
        HandheldPhone(**wrong).check()


@pytest.mark.parametrize("kinds", [("blurry",), ("finger", "finger")])
def test_spoiling_that_is_not_known(kinds):
    with pytest.raises(ConfigError, match="each once"):
        shots(SMALL, spoil=kinds)


def test_the_command_writes_photos_and_their_truth(tmp_path, capsys):
    raw = tmp_path / "raw"
    assert cli.main(["synth", "builtin:tiles", "--handheld", "-o", str(raw), "--megapixels", "0.1", "--photos", "3",
                     "--resolution", "32", "--spoil", "noflash", "--seed", "2"]) == 0
    assert sorted(p.name for p in raw.iterdir() if p.is_file() and p.suffix) == [f"IMG_{i:04d}.jpg" for i in range(1, 5)]
    photo, dark = (Photo.open(raw / f"IMG_000{i}.jpg") for i in (1, 4))
    assert photo.size == HandheldPhone(megapixels=0.1).lens.size and photo.orientation == 1
    assert photo.exif["35 mm focal length"] == 26 and photo.exif["ISO"] == 100
    assert photo.exif["exposure time"] == pytest.approx(1 / 60) and photo.exif["focal length"] == pytest.approx(5.8, abs=0.01)
    assert (photo.exif["flash"], dark.exif["flash"]) == ("fired", "off")
    truth = json.loads((raw / "truth" / "truth.json").read_text())
    assert truth["material"] == "tiles" and truth["sample_cm"] == 24.0 and truth["phone"]["seed"] == 2
    rig = rig_from_json(truth["rig"])
    assert list(rig.poses) == [f"IMG_{i:04d}.jpg" for i in range(1, 5)] and rig.lens.distortion == (0.06, -0.04)
    assert (raw / "truth" / "maps" / "normal.exr").is_file()
    pixels = photo.pixels()
    assert 60 < pixels.mean() < 160 and (pixels == 255).mean() < 0.05  # a photo that is well exposed


@pytest.mark.parametrize("arguments", [
    ["--sheet", "18"], ["--spoil", "finger"], ["--handheld", "--noise", "0.1", "--photos", "1", "--megapixels", "0.05"],
    ["--handheld", "--spoil", "nonsense"], ["--handheld", "--megapixels", "1000"], ["--handheld", "--seed", "-1"]])
def test_options_that_do_not_go_together(tmp_path, capsys, arguments):
    assert cli.main(["synth", "builtin:tiles", "-o", str(tmp_path / "out"), "--resolution", "16", *arguments]) == 2
    assert capsys.readouterr().err.startswith("error: expected") and not (tmp_path / "out").exists()


def test_a_rig_survives_json():
    lens = Lens((4032, 3024), 3000.5, (2010.0, 1500.25), (0.06, -0.04), (-0.25, 0.05), (1.5, 0.4, 0.0))
    poses = {"IMG_0001.jpg": Pose.looking_at((3, -2, 25), (0.4, 0.1, 0), 0.2), "b.png": Pose.looking_at((0, 1, 30), (0, 0, 0))}
    rig = Rig(lens, poses, 11.52, "cm", "sheet", {"b.png": 0.25}, {"c.jpg": "blurred"})
    back = rig_from_json(json.loads(json.dumps(rig_to_json(rig))))
    assert (back.lens, back.size, back.unit, back.source) == (rig.lens, rig.size, rig.unit, rig.source)
    assert (back.errors, back.left_out, list(back.poses)) == (rig.errors, rig.left_out, list(rig.poses))
    for name, pose in poses.items():
        np.testing.assert_array_equal(back.poses[name].position, pose.position)
        np.testing.assert_array_equal(back.poses[name].rotation, pose.rotation)


@pytest.mark.parametrize("wrong", [{}, {"lens": {"size": [4, 3], "focal": 2, "aperture": 1}, "poses": {}},
                                   {"lens": {"size": [4, 3], "focal": 2}, "poses": {"a": {"position": [1, 2]}}}])
def test_a_rig_that_is_none_says_so(wrong):
    with pytest.raises(CaptureError, match="a rig of lens and poses"):
        rig_from_json(wrong)


# What a capture is told about the truth.

MOVED = Similarity(12.0, 0.3, (0.7, -0.4))


@pytest.fixture
def truth(tmp_path):
    """Nine photos, a duplicate of the third and a blurred one, of smooth maps of 64 texels on 24 cm."""
    phone = HandheldPhone(megapixels=1.0)
    plan = shots(phone, spoil=("duplicate", "blurred"))
    rig = Rig(phone.lens, {shot.name: shot.pose for shot in plan}, phone.patch, "cm", "photos")
    save_maps(make_material("inlay", 16).resized(64), tmp_path / "truth" / "maps")
    odd = {shot.name: {"kind": shot.kind, "usable": False} | ({"of": shot.of} if shot.of else {}) for shot in plan if shot.kind}
    (tmp_path / "truth" / "truth.json").write_text(json.dumps(
        {"rig": rig_to_json(rig), "intensity": [1500.0] * 3, "sample_cm": 24.0, "spoiled": odd}))
    return Truth.read(tmp_path)


def sheets(truth) -> Rig:
    """The good photos exactly as they were, as a sheet would say it."""
    poses = dict(list(truth.rig.poses.items())[:9])
    left_out = {"IMG_0010.jpg": "as IMG_0003.jpg", "IMG_0011.jpg": "blurred"}
    return replace(truth.rig, poses=poses, source="sheet", left_out=left_out)


def moved(rig: Rig, by: Similarity = MOVED) -> Rig:
    """The same rig in a world of its own, as photos without a sheet would give it."""
    poses = {name: Pose(by.back(pose.position), pose.rotation @ by.turn) for name, pose in rig.poses.items()}
    lens = replace(rig.lens, flash=tuple(np.array(rig.lens.flash) / by.scale))
    return Rig(lens, poses, 0.95, "patch sides", "photos", {}, rig.left_out)


@pytest.mark.parametrize("world", [lambda rig: rig, moved])
def test_an_exact_rig_has_no_errors(truth, world):
    found = compare_with_truth(world(sheets(truth)), truth)
    for value in (found["cameras"]["worst"], found["cameras_by_patch"]["worst"], found["lights"]["worst"],
                  found["rectification"]["worst"], found["lens"]["pixels"], *found["lens"]["flash"],
                  found["lens"]["vignetting"], found["lens"]["focal"] - 1):
        assert abs(value) < 1e-9
    placed = found["similarity"]
    want = MOVED if world is moved else Similarity()
    np.testing.assert_allclose([placed["scale"], math.radians(placed["degrees"]), *placed["shift"]],
                               [want.scale, want.angle, *want.shift], atol=1e-9)
    assert found["photos"]["wrongly_used"] == {} and found["photos"]["wrongly_left_out"] == {}
    assert found["photos"]["rightly_left_out"]["IMG_0011.jpg"] == {"kind": "blurred", "reason": "blurred"}
    json.dumps(found, allow_nan=False)


def test_a_camera_in_a_wrong_place(truth):
    """1 % of its distance aside, found with a sheet: its light too, and its photo is rectified that far off."""
    rig, name = sheets(truth), "IMG_0004.jpg"
    pose = rig.poses[name]
    step = 0.01 * np.linalg.norm(pose.position)
    rig.poses[name] = Pose(pose.position + (step, 0, 0), pose.rotation)
    found = compare_with_truth(rig, truth)
    assert found["cameras"]["photos"][name] == pytest.approx(0.01) == found["cameras"]["worst"]
    assert found["cameras"]["rms"] == pytest.approx(0.01 / 3)
    light = np.linalg.norm(pose.flash(rig.lens))
    assert found["lights"]["photos"][name] == pytest.approx(step / light)
    pixels = step * PIXELS / rig.size
    rectification = found["rectification"]
    assert rectification["photos"][name] == pytest.approx(pixels) == rectification["worst"]
    assert rectification["rms"] == pytest.approx(pixels / 3) == rectification["mutual"] and rectification["common"] < 1e-9
    placed = similarity(moved(rig), truth)  # one wrong photo of nine moves no median
    np.testing.assert_allclose([placed.scale, placed.angle, *placed.shift], [MOVED.scale, MOVED.angle, *MOVED.shift], atol=1e-9)


def test_a_patch_that_all_photos_deform(truth):
    """All cameras shifted: of a sheet's rig an error common to all, without a sheet none at all."""
    rig = sheets(truth)
    poses = {name: Pose(pose.position + (0.1, -0.2, 0), pose.rotation) for name, pose in rig.poses.items()}
    shifted = replace(rig, poses=poses)
    found = compare_with_truth(shifted, truth)["rectification"]
    pixels = math.hypot(0.1, 0.2) * PIXELS / rig.size
    assert found["common"] == pytest.approx(pixels) == found["rms"] and found["mutual"] < 1e-9
    free = compare_with_truth(moved(shifted), truth)
    assert free["rectification"]["worst"] < 1e-9 and free["cameras"]["worst"] < 1e-9


def test_errors_of_the_lens(truth):
    rig = moved(sheets(truth))
    lens = replace(rig.lens, focal=rig.lens.focal * 1.02, vignetting=(0.0, 0.0), flash=(0.0, 0.0, 0.0))
    found = compare_with_truth(replace(rig, lens=lens), truth)["lens"]
    assert found["focal"] == pytest.approx(1.02) and found["distortion"] == [0.0, 0.0]
    assert found["flash"] == pytest.approx([-1.5, -0.4, 0.0])
    # At the corner r = 1 nearly: 1 - 0.25 + 0.05.
    assert found["vignetting"] == pytest.approx(0.2, abs=1e-3)
    size = np.array(rig.lens.size)
    columns, rows = np.meshgrid(*(np.linspace(0, side - 1, 33) for side in size))
    from_middle = np.hypot(columns - rig.lens.middle[0], rows - rig.lens.middle[1])
    assert found["pixels"] == pytest.approx(0.02 * np.sqrt(np.square(from_middle).mean()))


def test_which_photos_were_chosen(truth):
    rig = sheets(truth)
    poses = dict(rig.poses) | {name: truth.rig.poses[name] for name in ("IMG_0010.jpg", "IMG_0011.jpg")}
    both = compare_with_truth(replace(rig, poses=poses), truth)["photos"]
    assert both["wrongly_used"] == {"IMG_0010.jpg": "duplicate", "IMG_0011.jpg": "blurred"}
    del poses["IMG_0011.jpg"], poses["IMG_0003.jpg"], poses["IMG_0001.jpg"]  # one of two alike will do
    rig = replace(rig, poses=poses, left_out={"IMG_0003.jpg": "twice", "IMG_0001.jpg": "dark"})
    one = compare_with_truth(rig, truth)["photos"]
    assert one["wrongly_used"] == {} and one["wrongly_left_out"] == {"IMG_0001.jpg": "dark"}
    assert one["rightly_left_out"]["IMG_0003.jpg"] == {"kind": "duplicate", "reason": "twice"}


def test_maps_of_just_the_patch(truth):
    """A patch of half the sample, turned by a quarter: a cut of the maps, turned, and their normals with it."""
    quarter = Similarity(12.0, math.pi / 2, (3.0, 0.0))
    rig = replace(moved(sheets(truth), quarter), size=1.0)
    found = truth_maps(truth, rig, 32)
    whole = make_material("inlay", 16).resized(64)
    # x of the rig's world is y of the true one, and its y is -x: 12 cm around (3, 0) are columns 24 to 56 of 64.
    for name in ("diffuse", "specular", "roughness"):
        cut = torch.rot90(whole[name][16:48, 24:56], -1)
        # Measured: at most 0.0018, of bilinear reading twice a texel; the other way round 0.04 to 0.18
        assert float((found[name] - cut).abs().mean()) < 0.004 < float((found[name] - torch.rot90(cut, 2)).abs().mean())
    unturned = torch.rot90(whole["normal"][16:48, 24:56], -1)
    turned = torch.stack((unturned[..., 1], -unturned[..., 0], unturned[..., 2]), dim=-1)
    # Measured: 0.0005; as they were 0.023, turned the other way 0.035
    assert float((found["normal"] - turned).abs().mean()) < 0.002 < float((found["normal"] - unturned).abs().mean())
    assert float((found["normal"].norm(dim=-1) - 1).abs().max()) < 1e-6


def test_a_capture_with_the_true_views(truth, tmp_path):
    """The written views are wrong by a known amount: the comparison says it, and the true ones take their place."""
    rig = moved(sheets(truth))
    camera = np.stack([pose.position for pose in rig.poses.values()])
    light = np.stack([pose.flash(rig.lens) for pose in rig.poses.values()])
    power = 1500.0 / MOVED.scale**2
    views = Views.of(camera * (1, 1, 1.1), camera, [[1.2 * power] * 3] * 9, size=rig.size)
    write_capture(Capture(torch.rand(9, 16, 16, 3), views, "srgb", calibration="photos"), tmp_path / "made")
    path = tmp_path / "made" / "capture.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"rig": rig_to_json(rig)}))
    assert rig_of(path.parent).poses.keys() == rig.poses.keys()
    found = compare_with_truth(path.parent, truth)
    assert found["power"]["ratio"] == pytest.approx(1.2) and found["power"]["spread"] < 1e-9
    shot = true_capture(path.parent, truth, index=[0, 5])
    assert shot.calibration == "given" and shot.transfer == "srgb" and len(shot) == 2
    true = shot.views.in_patch_sides()
    np.testing.assert_allclose(true.camera, camera[[0, 5]] / rig.size, atol=1e-9)
    np.testing.assert_allclose(true.light, light[[0, 5]] / rig.size, atol=1e-9)
    np.testing.assert_allclose(true.intensity, power / rig.size**2, rtol=1e-9)


def test_truths_that_do_not_belong(truth, tmp_path):
    rig = sheets(truth)
    with pytest.raises(CaptureError, match="photos of"):
        compare_with_truth(replace(rig, lens=replace(rig.lens, size=(40, 30))), truth)
    with pytest.raises(CaptureError, match="photos that the truth tells of"):
        compare_with_truth(replace(rig, poses={"other.jpg": rig.poses["IMG_0001.jpg"]}), truth)
    with pytest.raises(CaptureError, match=r"truth\.json"):
        Truth.read(tmp_path / "nothing")
    with pytest.raises(CaptureError, match="capture.json with a rig"):
        rig_of(tmp_path)
    assert similarity(rig, truth) == Similarity()
