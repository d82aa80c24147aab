"""From raw photos without a sheet to a capture."""

import math

import cv2
import numpy as np
import pytest
from helpers.made_photos import LENS, poses
from PIL import Image

from mitsvbrdf.capture import read_capture
from mitsvbrdf.capture.photo import Photo, photos_in
from mitsvbrdf.capture.rig import OnePlace
from mitsvbrdf.capture.stages import make_capture
from mitsvbrdf.errors import CaptureError


def test_plain_photos_are_made_a_capture_of(plain):
    told = []
    capture = read_capture(plain, resolution=64, falloff="none", report=lambda *what: told.append(what))
    assert [share for _, share in told] == sorted(share for _, share in told) and any("rectifying" in text
                                                                                      for text, _ in told)
    assert (capture.calibration, capture.calibrated, len(capture), capture.index) == ("photos", True, 6,
                                                                                      tuple(range(6)))
    assert capture.photos.shape == (6, 64, 64, 3) and capture.transfer == "srgb" and capture.views.size == 1
    assert capture.views.falloff == "none"
    assert any("ISO differs: 100" in note and "200 in IMG_0.jpg" in note for note in capture.notes)
    # 1024 was asked for, and the photos have fewer
    assert any("not enlarged" in note for note in capture.notes)
    # The same points in all photos: of two, what is left of detail after exposure is noise and gloss.
    camera = np.stack([pose.position for pose in list(poses(height=20.0).values())[:6]])
    found = capture.views.camera.numpy()
    relative, expected = (x[:, :2] - x[:, :2].mean(axis=0) for x in (found, camera))
    assert np.corrcoef(relative.ravel(), expected.ravel())[0, 1] > 0.9999  # measured 1 - 1e-7


def test_few_photos_are_read_without_geometry(plain, tmp_path):
    (tmp_path / "a.jpg").write_bytes((plain / "IMG_0.jpg").read_bytes())
    one = read_capture(tmp_path)
    assert one.calibration == "none" and one.photos.shape == (1, 450, 450, 3) and one.index == (0,)
    expected = np.asarray(Image.open(plain / "IMG_0.jpg"))[:, 75:525] / np.float32(255)
    assert np.array_equal(one.photos[0].numpy(), expected.astype(np.float32))
    # 35 mm equivalent, equal diagonals
    stated = round(LENS.focal / math.hypot(*LENS.size) * math.hypot(36, 24))
    assert one.views.camera[0].tolist() == pytest.approx([0, 0, stated / math.hypot(36, 24) * 750 / 450])
    # white has radiance 1
    assert one.views.intensity[0, 0] / one.views.camera[0, 2] ** 2 == pytest.approx(math.pi)
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


def test_photos_that_show_everything_in_the_same_place_are_taken_for_rectified(tmp_path):
    (y, x), grain = np.mgrid[:300, :400], np.random.default_rng(0).standard_normal((4, 300, 400, 3))
    noise = cv2.GaussianBlur(grain[0], (0, 0), 2)  # too weak for features beside what each photo has alone
    lit = [((0.5 + 0.3 * noise) * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 3e5)[..., None]
            + 0.1 * own).clip(0, 1) for own, (u, v) in zip(grain[1:], ((100, 80), (300, 60), (200, 250)))]
    for i, photo in enumerate(lit):
        Image.fromarray(np.rint(photo * 255).astype(np.uint8)).save(tmp_path / f"{i}.png")
    capture = read_capture(tmp_path)
    assert capture.calibration == "none" and capture.index == (0, 1, 2)
    assert "taken for rectified" in capture.notes[-1]
    for photo, square in zip(lit, capture.photos.numpy()):
        assert np.abs(square - photo[:, 50:350]).max() < 0.6 / 255
    with pytest.raises(OnePlace, match="from a tripod, or rectified"):
        make_capture([Photo.open(path) for path in photos_in(tmp_path)])


@pytest.mark.slow
def test_a_mirrored_photo_is_named(plain, tmp_path):
    for path in photos_in(plain)[:4]:
        image = Image.open(path)
        flip = path.name == "IMG_2.jpg"
        (image.transpose(Image.Transpose.FLIP_LEFT_RIGHT) if flip else image).save(
            tmp_path / path.name, quality=95, exif=image.getexif())
    made = make_capture([Photo.open(path) for path in photos_in(tmp_path)], resolution=64)
    assert list(made.rig.rejected) == ["IMG_2.jpg"] and "mirrored beside " in made.rig.rejected["IMG_2.jpg"]
