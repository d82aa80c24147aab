"""The patch that all photos show."""

import numpy as np
import pytest
from PIL import Image, ImageOps

from mitsvbrdf.capture.align.patch import centred_square, choose_patch, largest_square, turned, upright
from mitsvbrdf.capture.lens import Pose


@pytest.mark.parametrize("orientation", range(1, 9))
def test_top_of_a_photo_by_its_exif(orientation):
    """Pillow's turning is the judge: where is the stored pixel that it puts at the middle of the top row?"""
    stored = np.arange(15 * 9, dtype=np.int32).reshape(9, 15)
    image = Image.fromarray(stored)
    image.getexif()[0x0112] = orientation
    shown = np.asarray(ImageOps.exif_transpose(image))
    row, column = np.argwhere(stored == shown[0, shown.shape[1] // 2])[0]
    direction = np.sign((column - 7, row - 4))
    pose = Pose.looking_at((0.0, 0.0, 2.0), (0.0, 0.0, 0.0), turn=0.3)
    top = pose.rotation.T @ (*direction, 0.0)
    assert turned(pose, upright(pose, orientation)).rotation.T @ (*direction, 0.0) == pytest.approx((0, 1, 0))
    assert upright(pose, orientation) == pytest.approx(np.arctan2(top[0], top[1]))


def test_the_patch_is_as_near_to_below_the_cameras_as_it_can_be():
    box = np.array([(1.0, 0.0, 2.0), (-1.0, 0.0, 2.0), (0.0, 1.0, 1.0), (0.0, -1.0, 1.0)])  # 4 x 2
    for below, wanted in (((0.7, 0.02), (0.7, 0.02)), ((0.7, 0.3), (0.7, 0.05)),
                          ((-3.0, -1.0), (-1.05, -0.05))):
        assert centred_square([box], 1.9, np.array(below)) == pytest.approx(np.array(wanted), abs=1e-9)


def test_largest_square():
    # x from -2 to 2, y from -0.7 to 0.5
    wide = np.array([(1, 0, 2.0), (-1, 0, 2.0), (0, 1, 0.5), (0, -1, 0.7)])
    assert largest_square([wide]) == pytest.approx(1.2)
    tilted = np.array([(c, s, 1.0) for c, s in ((0.6, 0.8), (-0.6, -0.8), (0.8, -0.6), (-0.8, 0.6))])
    # in a square of side 2 turned by t: 2 / (cos t + sin t)
    assert largest_square([tilted]) == pytest.approx(2 / 1.4)
    assert largest_square([wide, np.array([(-1.0, 0.0, -3.0)])]) < 0


def test_a_photo_that_would_cost_too_much_of_the_patch_is_left_out():
    box = np.array([(1, 0, 1.0), (-1, 0, 1.0), (0, 1, 1.0), (0, -1, 1.0)])
    photos = {"a": box, "b": box, "c": box, "d": box * (1, 1, 0.85), "e": box * (1, 1, 0.6)}
    side, out = choose_patch(photos)
    assert out == ["e"] and side == pytest.approx(1.7)
    assert choose_patch(photos, least=5) == (pytest.approx(1.2), [])
    assert choose_patch(photos, always="e")[1] == []
