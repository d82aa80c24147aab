"""From raw photos with a sheet to a capture, and what is rejected."""

import html
import json
import math
import re

import cv2
import numpy as np
import pytest
from helpers import ROOT
from helpers.colour_files import SPACES, icc_of
from helpers.made_photos import LENS, POWER, SHEET, ground, optics, poses, stored, taken
from helpers.rigs import lens_and_poses
from helpers.tables import words_at_the_right
from PIL import Image

from mitsvbrdf import cli
from mitsvbrdf.capture import read_capture
from mitsvbrdf.capture.align.from_sheet import refuse_tags
from mitsvbrdf.capture.lens import Pose, project
from mitsvbrdf.capture.photo import Photo, photos_in
from mitsvbrdf.capture.rectify import rectified
from mitsvbrdf.capture.rig import OnePlace
from mitsvbrdf.capture.stages import make_capture
from mitsvbrdf.errors import CaptureError, ConfigError


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
    mask = cv2.GaussianBlur(((columns - 250) ** 2 + (rows - 450) ** 2 < 370**2).astype(np.float32), (0, 0),
                            10)[..., None]
    stored(raw / "finger.jpg", photo * (1 - mask) + mask * np.array((0.06, 0.012, 0.01)),
           icc_profile=icc_of(*SPACES["Display P3"]))
    stored(raw / "dark.jpg", taken(what, LENS, aside, flash=False, seed=12), flash=0x10)
    stored(raw / "room.jpg",
           taken(what, LENS, Pose.looking_at((-2.5, 1, 25), (0, 0, 0)), flash=False, seed=13), flash=None)
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
                "aside": "partly outside: it shows only 7.%", "size": "others have 1200 x 900: cropped",
                "turned": "900 x 1200 pixels.*: its pixels were turned when it was stored"}
    for name, word in expected.items():
        assert re.search(word, rows[f"{name}.jpg"]["reason"]), (name, rows[f"{name}.jpg"]["reason"])
    assert len(rows) == 16
    at = ((np.stack(np.meshgrid(*[(np.arange(200) + 0.5) / 200 - 0.5] * 2), axis=-1).reshape(-1, 2)) * 0.64
          * 18)
    seen = project(LENS, Pose.looking_at((6, 0, 20), (9, 0, 0)), np.column_stack((at, np.zeros(len(at)))))
    inside = ((seen > -0.5) & (seen < np.array(LENS.size) - 0.5)).all(axis=1)
    # a texel in 256 along one edge is 0.004
    assert rows["aside.jpg"]["overlap"] == pytest.approx(inside.mean(), abs=0.01)


def test_the_capture_is_where_the_phone_was(made, truth):
    capture = read_capture(made[1])
    assert (capture.calibration, capture.transfer, len(capture), capture.resolution) == ("sheet", "srgb", 7,
                                                                                         256)
    assert capture.views.size == pytest.approx(0.64 * 18)
    camera = np.stack([pose.position for pose in truth.values()])
    light = np.stack([pose.flash(LENS) for pose in truth.values()])
    # Measured, in cm at 24 cm: cameras 0.005, lights 0.036; the bar is 0.5 % of the distance, 0.12.
    assert np.abs(capture.views.camera.numpy() - camera).max() < 0.06
    assert np.abs(capture.views.light.numpy() - light).max() < 0.12
    # measured 0.4 %
    assert capture.views.intensity.numpy() == pytest.approx(np.full((7, 3), POWER), rel=0.02)
    # A texel's radiance over its irradiance is its albedo: of the photo with the least gloss there, within
    # noise and JPEG.
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
    # svbrdf-diff-renderer's
    assert {"camera_pos", "light_pos", "light_pow", "im_size", "idx", "target_dir"} <= set(stated)
    assert (stated["unit"], stated["calibration"], stated["photos"]) == ("cm", "sheet", list(truth))
    assert stated["colours"] == {}  # the one photo with a profile is rejected
    assert len(stated["rejected"]) == 9 and stated["uncertainty"]["flash_x"] < 0.1
    lens, found = lens_and_poses(stated["rig"])
    pixel = project(lens, found["IMG_3.jpg"], np.zeros((1, 3)))
    # measured 0.01
    assert pixel == pytest.approx(project(LENS, truth["IMG_3.jpg"], np.zeros((1, 3))), abs=0.1)
    assert lens.vignetting[0] == pytest.approx(-0.2, abs=0.02)  # measured -0.204


def test_quality_page_and_pictures(made):
    out = made[1]
    record, page = json.loads((out / "quality.json").read_text()), html.unescape(
        (out / "quality.html").read_text())
    for row in record["photos"]:
        assert row["name"] in page and (row["used"] or row["reason"].split(" (")[0] in page)
    assert page.count("<img") == 16 and "http://" not in page.replace("http://www.w3.org",
                                                                      "") and len(page) < 2e6
    assert 0.3 < record["coverage"]["share"] <= 1
    assert any("flash differs" in warning for warning in record["warnings"])
    assert "<td" in page and not words_at_the_right(page)


def test_formats_page_names_the_keys_of_our_own(made):
    page, stated = (ROOT / "docs/formats.md").read_text(), json.loads((made[1] / "capture.json").read_text())
    theirs = {"camera_pos", "light_pos", "im_size", "idx", "target_dir"}  # svbrdf-diff-renderer's
    assert {key for key in stated if f"`{key}`" not in page} <= theirs


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
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (60, 80, 3),
                                                      dtype=np.uint8)).save(empty / "4.jpg")
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


@pytest.mark.slow
def test_of_photos_rectified_to_their_sheet_the_patch_is_cut_out(truth, tmp_path, capsys):
    """The frame of tags fills them: their middle 512 of 800 pixels are the patch."""
    raw, out = tmp_path / "raw", tmp_path / "out"
    raw.mkdir()
    cut = []
    for name in ("IMG_0.jpg", "IMG_1.jpg", "IMG_2.jpg", "IMG_4.jpg"):
        photo = taken(ground(), LENS, truth[name])
        stored(raw / name, rectified(photo.clip(0, 1).astype(np.float32), LENS, truth[name], 18.0, 800))
        shown = np.asarray(Image.open(raw / name), np.float32)[144:656, 144:656] / 255
        cut.append(cv2.resize(shown, (256, 256), interpolation=cv2.INTER_AREA))
    assert cli.main(["capture", str(raw), "-o", str(out), "--sheet", "18", "--resolution", "256"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "rectified to their sheet already" in printed and "has a highlight" not in printed
    assert "Where cameras stood" not in (out / "quality.html").read_text()
    capture = read_capture(out)
    assert (capture.calibration, capture.resolution) == ("none", 256)
    assert capture.views.size == pytest.approx(0.64 * 18)
    stated = json.loads((out / "capture.json").read_text())
    assert not stated.keys() & {"camera_pos", "light_pos", "light_pow"} and stated["rig"] is None
    assert json.loads((out / "quality.json").read_text())["coverage"]["share"] is None
    for photo, expected in zip(capture.photos.numpy(), cut, strict=True):
        assert np.abs(photo - expected).mean() < 0.01  # measured 0.002; a pixel aside 0.021
        assert np.abs(photo[:, 1:] - expected[:, :-1]).mean() > 0.01
    still, same = [raw / f"still{i}.jpg" for i in range(3)], taken(ground(), LENS, truth["IMG_1.jpg"])
    for path in still:
        stored(path, same)
    with pytest.raises(OnePlace, match="tripod"):
        make_capture([Photo.open(path) for path in still], 18.0)


@pytest.mark.slow
def test_of_masked_photos_the_rest_is_used(made, truth, tmp_path):
    """Of the patch a disk, half of it, remains in each; of one photo nothing."""
    for name, pose in truth.items():
        ray = optics(LENS)[0] @ pose.rotation
        at = (pose.position - ray * (pose.position[2] / ray[:, 2:]))[:, :2] / (0.64 * 18)
        shown = (np.hypot(*at.T) < 0.4 * (name != "IMG_2.jpg")) | (np.abs(at).max(axis=1) > 0.52)
        opened, alpha = Image.open(made[0] / name), np.uint8(255 * shown).reshape(LENS.size[::-1])
        Image.fromarray(np.dstack((opened, alpha))).save(tmp_path / f"{name}.png", exif=opened.getexif(),
                                                              compress_level=1)
    found = make_capture([Photo.open(path) for path in photos_in(tmp_path)], 18.0, resolution=256)
    assert [(name, why[:7]) for name, why in found.rig.rejected.items()] == [("IMG_2.jpg.png", "masked:")]
    radius = np.hypot(*((np.mgrid[:256, :256] + 0.5) / 256 - 0.5))
    assert (found.capture.measured.numpy() == (radius < 0.4)).mean(axis=(1, 2)).min() > 0.98  # the rim
    for photo, same in zip(found.capture.photos, read_capture(made[1]).pick([0, 1, 3, 4, 5, 6]).photos):
        assert (photo - same)[radius < 0.39].abs().mean() < 0.004  # measured 0.0012


def test_too_few_are_left(made):
    """Two good ones, and one that is not: the error names it and the reason."""
    photos = [Photo.open(made[0] / name)
              for name in ("IMG_0.jpg", "IMG_1.jpg", "IMG_2.jpg", "size.jpg", "two.jpg")]
    with pytest.raises(CaptureError, match="size.jpg: 1000 x 900"):
        make_capture(photos[1:4], 18.0)
    with pytest.raises(CaptureError, match="two.jpg: the same photo as IMG_1.jpg"):
        make_capture([photos[0], photos[1], photos[4]], 18.0, resolution=64)


def test_tags_without_a_size_are_refused(made, plain, tmp_path):
    (cut := tmp_path / "cut.jpg").write_bytes((plain / "IMG_0.jpg").read_bytes()[:20_000])  # hides no tags
    with pytest.raises(CaptureError, match="16 tags in IMG_0.jpg.*--sheet 18"):
        refuse_tags([Photo.open(path) for path in (cut, plain / "IMG_0.jpg", made[0] / "IMG_0.jpg")])
    with pytest.raises(CaptureError, match="16 tags"):  # fit raw/ too: they would pass for material
        read_capture(made[0])
    refuse_tags([Photo.open(plain / "IMG_0.jpg")])
