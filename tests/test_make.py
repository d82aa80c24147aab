"""From raw photos to a capture: with a sheet and without, and what is left out."""

from __future__ import annotations

import html
import json
import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from mitsvbrdf import cli
from mitsvbrdf.capture import read_capture
from mitsvbrdf.capture.align.sheet import Sheet
from mitsvbrdf.capture.lens import Lens, Pose, on_plane, project
from mitsvbrdf.capture.make import make_capture, refuse_tags
from mitsvbrdf.capture.photo import Photo, photos_in
from mitsvbrdf.capture.rectify import filled, without_vignetting
from mitsvbrdf.capture.rig import Rig, rig_from_json
from mitsvbrdf.errors import CaptureError, ConfigError

SHEET = Sheet(18.0)
LENS = Lens((1200, 900), 900.0, distortion=(0.03, -0.02), vignetting=(-0.2, 0.0), flash=(1.4, 0.3, 0.0))
PLACES = [(0.5, -1), (4.5, -3.5), (-4, 4), (-4.5, -4), (4, 4.5), (0.5, -5), (-1, 5)]
POWER = 1500.0  # of the flash: white paper below it has a radiance of 0.7 or so


def material(seed=0, side=1200):
    """Coloured noise of several scales, albedo."""
    rng = np.random.default_rng(seed)
    out = np.zeros((side, side, 3), np.float32)
    for blur, weight in ((1.5, 0.3), (4, 0.35), (10, 0.4), (40, 0.4)):
        layer = cv2.GaussianBlur(rng.standard_normal((side, side)).astype(np.float32), (0, 0), blur)
        out += weight * (layer / layer.std())[..., None]
    return np.clip(0.25 * np.array((1.3, 1.0, 0.7)) * np.exp(0.45 * out), 0.02, 0.9).astype(np.float32)


def ground(with_sheet=True, seed=0):
    """Albedo of what lies on the table, and whether it is material: rows from the top, and its side in cm."""
    side = SHEET.outer if with_sheet else 24.0
    inside = material(seed)
    if not with_sheet:
        return np.dstack((inside, np.ones(inside.shape[:2], np.float32))), side
    printed, hole = SHEET.picture(1200 / side)
    printed, hole = printed[:1200, :1200], hole[:1200, :1200]
    paper = np.repeat(0.8 * np.maximum(printed[..., None] / 255, 0.03), 3, axis=2).astype(np.float32)
    inside, paper = (cv2.resize(image, hole.shape[::-1]) for image in (inside, paper))
    return np.dstack((np.where(hole[..., None], inside, paper), hole)).astype(np.float32), side


def taken(what, lens, pose, flash=True, seed=0):
    """What the phone stores, H x W x 3 linear radiance: flash or an even light, vignetting, a highlight on the material."""
    albedo, side = what
    pixels = np.stack(np.meshgrid(np.arange(lens.size[0]), np.arange(lens.size[1])), axis=-1).reshape(-1, 2)
    at = on_plane(lens, pose, pixels)
    texels = ((np.stack((at[:, 0], -at[:, 1]), axis=1) / side + 0.5) * len(albedo) - 0.5).astype(np.float32)
    seen = cv2.remap(albedo, texels.reshape(lens.size[1], lens.size[0], 2), None, cv2.INTER_LINEAR,
                     borderMode=cv2.BORDER_CONSTANT, borderValue=(0.1, 0.1, 0.1, 0)).reshape(-1, 4)
    light = np.full(len(at), 1.2)
    gloss = np.zeros(len(at))
    if flash:
        points = np.column_stack((at, np.zeros(len(at))))
        ray, eye = pose.flash(lens) - points, pose.position - points
        distance = np.linalg.norm(ray, axis=1)
        light = POWER * ray[:, 2] / distance**3
        half = ray / distance[:, None] + eye / np.linalg.norm(eye, axis=1, keepdims=True)
        gloss = 0.3 * np.exp(-np.square(half[:, :2]).sum(axis=1) / half[:, 2] ** 2 / 0.006) * seen[:, 3]
    out = (seen[:, :3] / math.pi + gloss[:, None]) * (light * lens.transmission(pixels))[:, None]
    out = out.reshape(lens.size[1], lens.size[0], 3)
    return out + 0.002 * np.random.default_rng(seed).standard_normal(out.shape)


def stored(path, linear, flash=1, iso=100):
    """A JPEG with sRGB values and EXIF."""
    linear = np.clip(linear, 0, 1)
    display = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    exif = Image.Exif()
    focal = LENS.focal / math.hypot(*LENS.size) * math.hypot(36, 24)
    exif.get_ifd(0x8769).update({34855: iso, 41989: round(focal)} | ({} if flash is None else {37385: flash}))
    Image.fromarray((display * 255).round().astype(np.uint8)).save(path, quality=95, subsampling=0, exif=exif)


def poses(scale=1.0, height=24.0):
    turns = np.radians([0, 4, -6, 90, 3, -3, 180])  # a phone held upright, and one upside down, are as good
    return {f"IMG_{i}.jpg": Pose.looking_at((x * scale, y * scale, height), (0.3 * x, 0.3 * y, 0), turn)
            for i, ((x, y), turn) in enumerate(zip(PLACES, turns))}


@pytest.fixture(scope="module")
def truth():
    return poses()


@pytest.fixture(scope="module")
def made(truth, tmp_path_factory):
    """Seven good photos on a sheet and nine bad ones through the command: the folder, and what it printed."""
    raw, out = tmp_path_factory.mktemp("raw"), tmp_path_factory.mktemp("made") / "out"
    what = ground()
    for i, (name, pose) in enumerate(truth.items()):
        stored(raw / name, taken(what, LENS, pose, seed=i))
    aside = Pose.looking_at((2.5, 1, 25), (0, 0, 0), 0.1)
    photo = taken(what, LENS, aside, seed=10)
    stored(raw / "blurred.jpg", cv2.GaussianBlur(photo, (0, 0), 8))
    rows, columns = np.mgrid[:900, :1200]
    mask = cv2.GaussianBlur(((columns - 250) ** 2 + (rows - 450) ** 2 < 370**2).astype(np.float32), (0, 0), 10)[..., None]
    stored(raw / "finger.jpg", photo * (1 - mask) + mask * np.array((0.06, 0.012, 0.01)))
    stored(raw / "dark.jpg", taken(what, LENS, aside, flash=False, seed=12), flash=0x10)
    stored(raw / "room.jpg", taken(what, LENS, Pose.looking_at((-2.5, 1, 25), (0, 0, 0)), flash=False, seed=13), flash=None)
    stored(raw / "two.jpg", taken(what, LENS, truth["IMG_1.jpg"], seed=14))
    stored(raw / "other.jpg", taken(ground(False, seed=5), LENS, aside, seed=15))
    stored(raw / "size.jpg", photo[:, :1000])
    stored(raw / "turned.jpg", np.rot90(photo))
    stored(raw / "aside.jpg", taken(what, LENS, Pose.looking_at((6, 0, 20), (9, 0, 0)), seed=16))
    (raw / "notes.txt").write_text("no photo")
    assert cli.main(["capture", str(raw), "-o", str(out), "--sheet", "18", "--resolution", "256"]) == 0
    return raw, out


def test_right_photos_are_used_and_wrong_ones_named_with_the_reason(made):
    raw, out = made
    rows = {row["name"]: row for row in json.loads((out / "quality.json").read_text())["photos"]}
    assert [name for name, row in rows.items() if row["used"]] == [f"IMG_{i}.jpg" for i in range(7)]
    expected = {"blurred": "blurred: 0.", "finger": "covered: ", "dark": "without flash .says its EXIF",
                "room": "does not fall off", "two": "the same photo as IMG_1.jpg", "other": "of 16 tags seen",
                "aside": "partly outside: it shows only 7.%", "size": "1000 x 900 pixels, the others have 1200 x 900: cropped",
                "turned": "900 x 1200 pixels.*: its pixels were turned when it was stored"}
    for name, word in expected.items():
        assert re.search(word, rows[f"{name}.jpg"]["reason"]), (name, rows[f"{name}.jpg"]["reason"])
    assert len(rows) == 16
    at = (np.stack(np.meshgrid(*[(np.arange(200) + 0.5) / 200 - 0.5] * 2), axis=-1).reshape(-1, 2)) * 0.64 * 18
    seen = project(LENS, Pose.looking_at((6, 0, 20), (9, 0, 0)), np.column_stack((at, np.zeros(len(at)))))
    inside = ((seen > -0.5) & (seen < np.array(LENS.size) - 0.5)).all(axis=1)
    assert rows["aside.jpg"]["overlap"] == pytest.approx(inside.mean(), abs=0.01)  # a texel in 256 along one edge is 0.004


def test_the_capture_is_where_the_phone_was(made, truth):
    capture = read_capture(made[1])
    assert (capture.calibration, capture.transfer, len(capture), capture.resolution) == ("sheet", "srgb", 7, 256)
    assert capture.views.size == pytest.approx(0.64 * 18)
    camera = np.stack([pose.position for pose in truth.values()])
    light = np.stack([pose.flash(LENS) for pose in truth.values()])
    # Measured, in cm at 24 cm: cameras 0.005, lights 0.036; the bar is 0.5 % of the distance, 0.12.
    assert np.abs(capture.views.camera.numpy() - camera).max() < 0.06
    assert np.abs(capture.views.light.numpy() - light).max() < 0.12
    assert capture.views.intensity.numpy() == pytest.approx(np.full((7, 3), POWER), rel=0.02)  # measured 0.4 %
    # A texel's radiance over its irradiance is its albedo: of the photo with the least gloss there, within noise and JPEG.
    albedo = cv2.resize(ground()[0][..., :3], (1200, 1200))
    low, high = (int(1200 * (0.5 + s * 0.32 * 18 / SHEET.outer)) for s in (-1, 1))
    expected = cv2.resize(albedo[low:high, low:high], (16, 16), interpolation=cv2.INTER_AREA)
    seen = np.min([_albedo(photo, view) for photo, view in zip(capture.linear, capture.views)], axis=0)
    assert np.median(np.abs(seen / expected - 1)) < 0.015  # measured 0.004


def _albedo(photo, view):
    at = (np.mgrid[:16, :16] + 0.5) / 16 - 0.5
    points = np.stack((at[1], -at[0], np.zeros((16, 16))), axis=-1) * 0.64 * 18
    ray = np.array(view.light) - points
    falloff = view.intensity[0] * ray[..., 2] / np.linalg.norm(ray, axis=-1) ** 3 / math.pi
    return cv2.resize(photo.numpy(), (16, 16), interpolation=cv2.INTER_AREA) / falloff[..., None]


def test_what_capture_json_says(made, truth):
    stated = json.loads((made[1] / "capture.json").read_text())
    assert {"camera_pos", "light_pos", "light_pow", "im_size", "idx", "target_dir"} <= set(stated)  # svbrdf-diff-renderer's
    assert (stated["unit"], stated["calibration"], stated["photos"]) == ("cm", "sheet", list(truth))
    assert len(stated["left_out"]) == 9 and stated["uncertainty"]["flash_x"] < 0.1
    rig = rig_from_json(stated["rig"])
    pixel = project(rig.lens, rig.poses["IMG_3.jpg"], np.zeros((1, 3)))
    assert pixel == pytest.approx(project(LENS, truth["IMG_3.jpg"], np.zeros((1, 3))), abs=0.1)  # measured 0.01
    assert rig.lens.vignetting[0] == pytest.approx(-0.2, abs=0.02)  # measured -0.204


def test_quality_page_and_pictures(made):
    out = made[1]
    record, page = json.loads((out / "quality.json").read_text()), html.unescape((out / "quality.html").read_text())
    for row in record["photos"]:
        assert row["name"] in page and (row["used"] or row["reason"].split(" (")[0] in page)
    assert page.count("<img") == 16 and "http://" not in page.replace("http://www.w3.org", "") and len(page) < 2e6
    assert {"reading", "rectifying", "flash", "quality", "tags"} <= set(record["seconds"])
    assert 0.3 < record["coverage"]["share"] <= 1 and (record["stand"] is None or record["stand"]["words"] in page)
    assert cv2.imread(str(out / "contact.jpg")).shape[1] == 1680
    assert any("flash differs" in warning for warning in record["warnings"])


def test_formats_page_names_every_key(made):
    page = (Path(__file__).parents[1] / "docs/formats.md").read_text()
    stated, record = (json.loads((made[1] / name).read_text()) for name in ("capture.json", "quality.json"))
    for key in [*stated, *stated["rig"]["lens"], *stated["uncertainty"], *record, *record["photos"][0], *record["coverage"]]:
        assert f"`{key}`" in page, key


def test_page_in_a_browser(made):
    import browser

    with browser.opened(made[1] / "quality.html", width=390, scheme="dark", phone=True) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.locator("circle.camera").count() == 7


def test_mistakes_on_the_command_line(made, truth, tmp_path, capsys):
    raw, out = made

    def said(*arguments):
        assert cli.main(["capture", *map(str, arguments)]) == 2
        return capsys.readouterr().err

    assert "16 tags in " in (text := said(raw, "-o", tmp_path / "a")) and "--sheet" in text
    assert "which has results" in said(raw, "-o", out, "--sheet", 18)
    assert "an output folder of its own" in said(raw, "-o", raw, "--sheet", 18)
    assert "a capture already" in said(out, "-o", tmp_path / "a")
    assert "--sheet CM beside --depth" in said(raw, "-o", tmp_path / "a", "--depth", 1)
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "none in" in said(empty, "-o", tmp_path / "a")
    for name in ("1.jpg", "2.jpg"):
        Image.fromarray(np.zeros((60, 80, 3), np.uint8)).save(empty / name)
    assert "3 photos or more" in said(empty, "-o", tmp_path / "a")
    Image.fromarray(np.zeros((60, 80, 3), np.uint8)).save(empty / "3.jpg")
    text = said(empty, "-o", tmp_path / "a", "--sheet", 18)
    assert "show the sheet, got 0 of 3" in text and "none of 16 tags" in text
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)).save(empty / "4.jpg")
    (empty / "4.jpg").write_bytes((empty / "4.jpg").read_bytes()[:3000])  # cut off while it was copied
    assert "4.jpg: image file is truncated" in said(empty, "-o", tmp_path / "a")
    (empty / "5.dng").touch()
    assert "photos of one kind" in said(empty, "-o", tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_options_out_of_range(made):
    photos = [Photo.open(path) for path in photos_in(made[0])][:3]
    for wrong in ({"resolution": 4}, {"sheet_cm": -1.0}, {"sheet_cm": math.nan}, {"reference": "last"},
                  *({"sheet_cm": 18.0, "depth_cm": depth} for depth in (math.nan, math.inf, 18.0, -1000.0))):
        with pytest.raises(ConfigError):
            make_capture(photos, **wrong)


def test_too_few_are_left(made):
    """Two good ones, and one that is not: the error names it and the reason."""
    photos = [Photo.open(made[0] / name) for name in ("IMG_0.jpg", "IMG_1.jpg", "IMG_2.jpg", "size.jpg", "two.jpg")]
    with pytest.raises(CaptureError, match="size.jpg: 1000 x 900"):
        make_capture(photos[1:4], 18.0)
    with pytest.raises(CaptureError, match="two.jpg: the same photo as IMG_1.jpg"):
        make_capture([photos[0], photos[1], photos[4]], 18.0, resolution=64)


def test_vignetting_is_undone_in_linear_light():
    """A lens as dark as 0.75 in the corners before a grey wall; what is clipped stays clipped."""
    lens, pose = Lens((1200, 900), 900.0, vignetting=(-0.3, 0.05)), Pose.looking_at((3, 1, 12), (1, 0, 0))
    rig = Rig(lens, {"a": pose}, 10.0, "cm", "sheet")
    at = np.stack(np.meshgrid((np.arange(32) + 0.5) / 32 - 0.5, 0.5 - (np.arange(32) + 0.5) / 32), axis=-1) * 10
    passed = lens.transmission(project(lens, pose, np.dstack((at, np.zeros((32, 32)))).reshape(-1, 3))).reshape(32, 32, 1)
    assert passed.min() < 0.9
    display = ((0.4 * passed) ** (1 / 2.2)).astype(np.float32).repeat(3, axis=2)
    display[0, 0], display[5, 5] = 1.0, np.nan
    out = without_vignetting(display, rig, "a", "gamma2.2")
    assert (out[0, 0] == 1).all() and np.isnan(out[5, 5]).all()
    out[0, 0] = out[5, 5] = 0.4 ** (1 / 2.2)
    assert np.abs(out - 0.4 ** (1 / 2.2)).max() < 2e-6  # float32 there and back


def test_what_a_photo_does_not_reach_is_taken_from_the_others():
    photos = np.stack([np.full((2, 2, 3), value, np.float32) for value in (0.2, 0.4, 0.9)])
    photos[0, 0, 0], photos[:, 1, 1] = np.nan, np.nan
    found = filled(list(photos)).numpy()
    assert found[0, 0, 0] == pytest.approx(0.65) and (found[:, 1, 1] == 0).all()
    untouched = np.isfinite(photos)
    assert np.array_equal(found[untouched], photos[untouched])


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Six photos without a sheet, of 600 x 450 pixels, from places that show the patch more largely."""
    raw, lens = tmp_path_factory.mktemp("plain"), Lens((600, 450), 450.0, flash=(1.4, 0.3, 0.0))
    what = ground(False)
    for i, (name, pose) in enumerate(list(poses(height=20.0).items())[:6]):
        stored(raw / name, taken(what, lens, Pose(pose.position, Pose.looking_at(
            pose.position, (*pose.position[:2] * 0.5, 0), 0.05 * i).rotation), seed=i), iso=100 if i else 200)
    return raw


def test_plain_photos_are_made_a_capture_of(plain):
    heard, told = [], []
    capture = read_capture(plain, resolution=64, falloff="none", log=heard.append, report=lambda *what: told.append(what))
    assert [share for _, share in told] == sorted(share for _, share in told) and any("rectifying" in text for text, _ in told)
    assert (capture.calibration, capture.calibrated, len(capture), capture.index) == ("photos", True, 6, tuple(range(6)))
    assert capture.photos.shape == (6, 64, 64, 3) and capture.transfer == "srgb" and capture.views.size == 1
    assert capture.views.falloff == "none"
    assert any("ISO differs: 100" in note and "200 in IMG_0.jpg" in note for note in heard)
    assert any("not enlarged" in note for note in heard)  # 1024 was asked for, and the photos have fewer
    # The same points in all photos: of two, what is left of detail after exposure is noise and gloss.
    camera = np.stack([pose.position for pose in list(poses(height=20.0).values())[:6]])
    found = capture.views.camera.numpy()
    relative, expected = (x[:, :2] - x[:, :2].mean(axis=0) for x in (found, camera))
    assert np.corrcoef(relative.ravel(), expected.ravel())[0, 1] > 0.9999  # measured 1 - 1e-7
    assert len(heard) == len(capture.notes)


def test_few_photos_are_read_without_geometry(plain, tmp_path):
    first = (plain / "IMG_0.jpg").read_bytes()
    (tmp_path / "a.jpg").write_bytes(first)
    one = read_capture(tmp_path)
    assert one.calibration == "none" and one.photos.shape == (1, 450, 450, 3) and one.index == (0,)
    expected = np.asarray(Image.open(plain / "IMG_0.jpg"))[:, 75:525] / np.float32(255)
    assert np.array_equal(one.photos[0].numpy(), expected.astype(np.float32))
    stated = round(LENS.focal / math.hypot(*LENS.size) * math.hypot(36, 24))  # 35 mm equivalent, equal diagonals
    assert one.views.camera[0].tolist() == pytest.approx([0, 0, stated / math.hypot(36, 24) * 750 / 450])
    assert one.views.intensity[0, 0] / one.views.camera[0, 2] ** 2 == pytest.approx(math.pi)  # white has radiance 1
    assert len(one.notes) == 1 and "no calibration" in one.notes[0] and "from EXIF" in one.notes[0]
    Image.fromarray(np.full((450, 600, 3), 90, np.uint8)).save(tmp_path / "b.jpg")
    two = read_capture(tmp_path)
    assert len(two) == 1 and "only a.jpg is used of 2 photos" in two.notes[0]
    Image.fromarray(np.full((450, 600, 3), 90, np.uint8)).save(tmp_path / "c.jpg")
    three = read_capture(tmp_path)
    assert len(three) == 1 and "too few to align" in three.notes[0]


def test_a_damaged_photo_does_not_turn_many_into_one(plain, tmp_path):
    for i in range(4):
        data = (plain / f"IMG_{i}.jpg").read_bytes()
        (tmp_path / f"{i}.jpg").write_bytes(data[: len(data) // 2] if i == 2 else data)
    with pytest.raises(CaptureError, match="2.jpg: image file is truncated"):
        read_capture(tmp_path)


def test_a_single_photo_is_shown_upright(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    pixels = np.zeros((40, 60, 3), np.uint8)
    pixels[:, :30] = 200  # the left half as stored is the upper one as shown
    Image.fromarray(pixels).save(tmp_path / "a.jpg", exif=exif, quality=95)
    photo = read_capture(tmp_path).photos[0]
    assert photo.shape == (40, 40, 3) and photo[:15].mean() > 0.7 and photo[25:].mean() < 0.1


def test_tags_without_a_size_are_refused(made, plain):
    with pytest.raises(CaptureError, match="16 tags in IMG_0.jpg.*--sheet 18"):
        refuse_tags([Photo.open(made[0] / "IMG_0.jpg")])
    with pytest.raises(CaptureError, match="16 tags"):  # fit raw/ too: they would pass for material
        read_capture(made[0])
    refuse_tags([Photo.open(plain / "IMG_0.jpg")])
