"""Photos without calibration that no poses can be found of: the stated default geometry."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from mitsvbrdf.capture import read_capture
from mitsvbrdf.capture.lens import field_of_view
from mitsvbrdf.capture.photo import Photo, photos_in
from mitsvbrdf.capture.rig import OnePlace
from mitsvbrdf.capture.stages import make_capture
from mitsvbrdf.views import default_views

WIDTH, HEIGHT = 400, 300


def texture(seed=0):
    """Noise of several scales, 400 x 300, with room around: 800 x 600."""
    rng = np.random.default_rng(seed)
    out = np.zeros((600, 800, 3), dtype=np.float32)
    for blur, weight in ((1.5, 0.2), (4, 0.3), (12, 0.5)):
        layer = cv2.GaussianBlur(rng.standard_normal(out.shape).astype(np.float32), (0, 0), blur)
        out += weight * layer / layer.std()
    return np.clip(0.5 + 0.25 * out, 0, 1)


def seen(material, corners):
    """The photo whose corners see these points of the material (relative to its central 400 x 300 window)."""
    frame = np.float32([[0, 0], [WIDTH - 1, 0], [WIDTH - 1, HEIGHT - 1], [0, HEIGHT - 1]])
    warp = cv2.getPerspectiveTransform(frame + np.float32(corners) + np.float32([200, 150]), frame)
    photo = cv2.warpPerspective(material, warp, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    return torch.from_numpy(np.rint(np.clip(photo, 0, 1) * 255).astype(np.float32) / 255)


STRAIGHT = [[0, 0]] * 4
SKEWED = [[12, -9], [-15, 6], [8, 14], [-6, -11]]


def window(photo, side):
    top, left = (HEIGHT - side) // 2, (WIDTH - side) // 2
    return photo[top : top + side, left : left + side]


def save(folder, **images):
    for name, image in images.items():
        cv2.imwrite(str(folder / f"{name}.png"),
                    (np.asarray(image)[..., ::-1] * 255).round().astype(np.uint8))


def test_default_views():
    views = default_views(3, 60.0)
    distance = 0.5 / math.tan(math.radians(30))
    assert len(views) == 3 and views.size == 1 and views.co_located
    assert torch.allclose(views.camera, torch.tensor([[0, 0, distance]] * 3, dtype=torch.float64))
    # A white diffuse texel under the light: I / (pi d^2) = 1.
    assert torch.allclose(views.intensity / (math.pi * distance**2), torch.ones(3, 3, dtype=torch.float64))
    assert default_views(1, 60.0, share=0.5).camera[0, 2] == pytest.approx(2 * distance)


def test_field_of_view():
    assert field_of_view(50, 3600, 2400) == pytest.approx(math.degrees(2 * math.atan(18 / 50)))
    assert field_of_view(26, 3000, 4000) == field_of_view(26, 4000, 3000)


def test_of_too_few_photos_the_first_is_read_and_the_geometry_is_stated(tmp_path):
    first = seen(texture(), STRAIGHT)
    save(tmp_path, IMG_1=first, IMG_2=seen(texture(), SKEWED))
    heard = []
    capture = read_capture(tmp_path, log=heard.append)
    assert (capture.index, capture.calibration, capture.transfer) == ((0,), "none", "srgb")
    assert torch.equal(capture.photos[0], window(first, 300)) and capture.views.size == 1
    assert "only IMG_1.png is used of 2 photos: 3 or more" in heard[0]
    assert "no calibration" in heard[-1] and "60 degrees, assumed" in heard[-1]


def with_exif(path, image, orientation=1, iso=100, exposure=0.01, focal=4.2, focal_35mm=26):
    exif = Image.Exif()
    exif[0x0112] = orientation
    exif.get_ifd(0x8769).update({34855: iso, 33434: exposure, 37386: focal, 41989: focal_35mm})
    Image.fromarray((np.asarray(image) * 255).round().astype(np.uint8)).save(path, quality=98, exif=exif)


def test_exif_gives_the_field_of_view_and_warnings(tmp_path):
    photo = seen(texture(), STRAIGHT)
    with_exif(tmp_path / "a.jpg", photo)
    with_exif(tmp_path / "b.jpg", photo, iso=400, exposure=0.02, focal=2.1)
    notes = read_capture(tmp_path).notes
    assert len(notes) == 5 and "ISO differs: 100 in a.jpg, 400 in b.jpg" in notes[0]
    assert "exposure time" in notes[1] and "focal length" in notes[2] and "from EXIF" in notes[4]
    views = read_capture(tmp_path).views
    # 35 mm equivalent by the diagonal: 26 mm of 43.27 mm, a diagonal of 500 pixels, a patch of 300.
    assert views.camera[0, 2] == pytest.approx(26 / math.hypot(36, 24) * 500 / 300)


def test_exif_orientation_is_honoured(tmp_path):
    photo = seen(texture(), STRAIGHT)
    # stored turned left: show turned right
    with_exif(tmp_path / "a.jpg", np.rot90(photo.numpy()), orientation=6)
    square = read_capture(tmp_path).photos[0]
    assert (square - window(photo, 300)).abs().mean() < 0.02  # JPEG at quality 98: 0.005


def test_photos_that_show_everything_in_the_same_place_are_taken_for_rectified(tmp_path):
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    lit = [seen(texture(),
                STRAIGHT) * torch.from_numpy(np.exp(-((x - u) ** 2 + (y - v) ** 2) / 3e5)[..., None]).float()
           for u, v in ((100, 80), (300, 60), (200, 250))]
    save(tmp_path, a=lit[0], b=lit[1], c=lit[2])
    heard = []
    capture = read_capture(tmp_path, log=heard.append)
    assert capture.calibration == "none" and capture.index == (0, 1, 2) and "taken for rectified" in heard[-1]
    for photo, square in zip(lit, capture.photos):
        assert (square - window(photo, 300)).abs().max() < 0.6 / 255
    with pytest.raises(OnePlace, match="from a tripod, or rectified"):
        make_capture([Photo.open(path) for path in photos_in(tmp_path)])
