"""Plain photos: aligned to the first, cropped, and given the stated default geometry."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from mitsvbrdf.capture import read_capture
from mitsvbrdf.capture.align import align_photos, default_views, field_of_view
from mitsvbrdf.errors import CaptureError

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
SHIFTED = [[40, 25]] * 4


def window(photo, side):
    top, left = (HEIGHT - side) // 2, (WIDTH - side) // 2
    return photo[top : top + side, left : left + side]


def save(folder, **images):
    for name, image in images.items():
        cv2.imwrite(str(folder / f"{name}.png"), (np.asarray(image)[..., ::-1] * 255).round().astype(np.uint8))


def test_known_homographies_are_undone():
    first = seen(texture(), STRAIGHT)
    squares, kept, notes = align_photos([first, seen(texture(), SKEWED), seen(texture(), SHIFTED)], "abc")
    assert kept == [0, 1, 2] and notes == []
    side = squares.shape[1]
    assert 246 <= side <= 250  # SHIFTED leaves 25 rows uncovered at one side, so at both, and rounding a pixel more
    assert torch.equal(squares[0], window(first, side))
    for square in squares[1:]:
        # Measured: 0.0023 and 0.0006 rms, what resampling twice costs; half a pixel off would be 0.014.
        assert (square - squares[0]).square().mean().sqrt() < 0.005


def test_turned_photo():
    first = seen(texture(), STRAIGHT)
    angle = np.deg2rad(20)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
    frame = np.array([[0, 0], [WIDTH - 1, 0], [WIDTH - 1, HEIGHT - 1], [0, HEIGHT - 1]])
    squares, kept, _ = align_photos([first, seen(texture(), (frame - middle) @ turn.T + middle - frame)], "ab")
    assert kept == [0, 1] and (squares[1] - squares[0]).square().mean().sqrt() < 0.005


def test_aligned_photos_pass_unchanged():
    first = seen(texture(), STRAIGHT)
    brighter = (first * 0.8 + 0.1).clamp(0, 1)
    squares, kept, notes = align_photos([first, brighter], "ab")
    assert kept == [0, 1] and notes == [] and squares.shape == (2, 300, 300, 3)
    assert torch.equal(squares[0], window(first, 300)) and torch.equal(squares[1], window(brighter, 300))


@pytest.mark.parametrize(("other", "reason"), [
    (torch.full((HEIGHT, WIDTH, 3), 0.5), "too few"),
    (seen(texture(1), STRAIGHT), "agree with one homography"),
    (seen(texture(), [[170, 120]] * 4), "too little"),
    (seen(texture(), [[0, 0], [0, 0], [-340, 0], [0, 0]]), "left out")])
def test_what_cannot_be_aligned_is_named(other, reason):
    first = seen(texture(), STRAIGHT)
    squares, kept, notes = align_photos([first, other, seen(texture(), SKEWED)], ["one", "two", "three"])
    assert kept == [0, 2] and len(notes) == 1 and "two" in notes[0] and reason in notes[0]
    squares, kept, notes = align_photos([first, other], ["one", "two"])
    assert kept == [0] and len(notes) == 2 and "only one is left" in notes[1]
    assert torch.equal(squares[0], window(first, 300))


def test_different_sizes_are_an_error():
    with pytest.raises(CaptureError, match="a of 400 x 300 and b of 300 x 300"):
        align_photos([seen(texture(), STRAIGHT), seen(texture(), STRAIGHT)[:, :300]], "ab")


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


def test_plain_photos_are_read_and_the_geometry_is_stated(tmp_path):
    save(tmp_path, IMG_1=seen(texture(), STRAIGHT), IMG_2=torch.full((HEIGHT, WIDTH, 3), 0.5),
         IMG_3=seen(texture(), SKEWED))
    heard = []
    capture = read_capture(tmp_path, resolution=64, log=heard.append)
    assert (capture.index, capture.calibrated, capture.transfer) == ((0, 2), False, "srgb")
    assert capture.photos.shape == (2, 64, 64, 3) and capture.views.size == 1
    assert "IMG_2.png is left out" in heard[0] and "no calibration" in heard[-1] and "60 degrees, assumed" in heard[-1]


def test_plain_photos_of_different_sizes(tmp_path):
    save(tmp_path, a=torch.zeros(20, 30, 3), b=torch.zeros(30, 20, 3))
    with pytest.raises(CaptureError, match="a.png of 30 x 20 and b.png of 20 x 30"):
        read_capture(tmp_path)


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
    assert len(notes) == 4 and "ISO differs: 100 in a.jpg, 400 in b.jpg" in notes[0]
    assert "exposure time" in notes[1] and "focal length" in notes[2] and "from EXIF" in notes[3]
    views = read_capture(tmp_path).views
    # 35 mm equivalent by the diagonal: 26 mm of 43.27 mm, a diagonal of 500 pixels, a patch of 300.
    assert views.camera[0, 2] == pytest.approx(26 / math.hypot(36, 24) * 500 / 300)


def test_exif_orientation_is_honoured(tmp_path):
    photo = seen(texture(), STRAIGHT)
    with_exif(tmp_path / "a.jpg", np.rot90(photo.numpy()), orientation=6)  # stored turned left: show turned right
    square = read_capture(tmp_path).photos[0]
    assert (square - window(photo, 300)).abs().mean() < 0.02  # JPEG at quality 98: 0.005


def test_real_photos_already_aligned(data_folder, tmp_path):
    target = data_folder / "captures" / "wood-knotty" / "target"
    for name in ("00", "01", "02"):
        image = cv2.imread(str(next(target.glob(f"{name}.*"))))
        cv2.imwrite(str(tmp_path / f"{name}.png"), cv2.resize(image, (512, 512), interpolation=cv2.INTER_AREA))
    capture = read_capture(tmp_path)
    assert capture.index == (0, 1, 2) and capture.resolution >= 495  # rectified by their authors to a few pixels
