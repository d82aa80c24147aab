"""A phone's lens and poses against OpenCV, and rectified photos against what they must show."""

import json
import math

import cv2
import numpy as np
import pytest

from mitsvbrdf.capture.lens import Lens, Pose, field_of_view, on_plane, project, rays
from mitsvbrdf.capture.rectify import rectified
from mitsvbrdf.capture.rig import Rig, rig_to_json
from mitsvbrdf.views import texel_positions

LENSES = [Lens((600, 450), 500.0), Lens((600, 450), 475.0, (295.0, 228.5), (0.1, -0.06)),
          Lens((450, 600), 350.0, (230.0, 295.0), (-0.12, 0.03))]
POSES = [Pose.looking_at((0.2, -0.1, 3.0), (0, 0, 0)), Pose.looking_at((1.1, 0.6, 2.6), (0.1, 0, 0), 0.3),
         Pose.looking_at((-0.9, 0.3, 2.2), (0, 0.1, 0), -2.0)]


def points(count=200, seed=0):
    return np.random.default_rng(seed).uniform(-0.7, 0.7, (count, 3)) * (1, 1, 0.2)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("pose", POSES)
def test_pixels_are_opencvs(lens, pose):
    shift = -pose.rotation @ pose.position
    theirs = cv2.projectPoints(points(), cv2.Rodrigues(pose.rotation)[0], shift, lens.matrix,
                               np.array([*lens.distortion, 0.0, 0.0]))[0][:, 0]
    # Both in float64; the way through a rotation vector costs some digits. 1e-13 was seen.
    np.testing.assert_allclose(project(lens, pose, points()), theirs, atol=1e-9)


@pytest.mark.parametrize("crop", [(3000, 3000), (4000, 2250), (2250, 4000)])
def test_a_phones_crop_has_the_focal_length_of_the_whole_photo(crop):
    whole, found = (max(size) / 2 / math.tan(math.radians(field_of_view(26, *size)) / 2)
                    for size in ((4000, 3000), crop))
    assert found == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("height", [0.0, 0.3])
def test_the_plane_and_back(lens, height):
    where = points() * (1, 1, 0) + (0, 0, height)
    for pose in POSES:
        back = on_plane(lens, pose, project(lens, pose, where), height)
        np.testing.assert_allclose(back, where[:, :2], atol=1e-9)  # Newton has converged: 9e-16 was seen


@pytest.mark.parametrize("distortion", [(0.1, -0.06), (-0.12, 0.03), (0.5, 0.3)])  # the last is no phone's
def test_rays_undo_the_distortion(distortion):
    lens = Lens((600, 450), 475.0, (295.0, 228.5), distortion)
    ray = rays(lens, np.array([[0.0, 0.0], [295.0, 228.5], [599.0, 225.0]]))
    assert np.all(ray[:, 2] == 1) and np.allclose(ray[1], (0, 0, 1))
    for pixel, found in zip(((0.0, 0.0), (599.0, 225.0)), ray[[0, 2]]):
        bent = (np.array(pixel) - lens.middle) / lens.focal
        roots = np.roots([lens.distortion[1], 0, lens.distortion[0], 0, 1, -np.linalg.norm(bent)])
        radius = min(root.real for root in roots if abs(root.imag) < 1e-9 and root.real > 0)
        np.testing.assert_allclose(found[:2], bent / np.linalg.norm(bent) * radius, atol=1e-12)


def test_what_is_behind_the_camera_has_no_pixel():
    seen = project(LENSES[0], POSES[0], np.array([[0, 0, 5.0], [0, 0, 0.0]]))
    assert np.isnan(seen[0]).all() and np.isfinite(seen[1]).all()


def test_looking_at():
    pose = Pose.looking_at((0.4, -0.3, 2.0), (0.1, 0.2, 0.0))
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(pose.rotation) == pytest.approx(1)
    np.testing.assert_allclose(project(LENSES[0], pose, np.array([[0.1, 0.2, 0.0]]))[0], (299.5, 224.5),
                               atol=1e-9)
    straight, turned = Pose.looking_at((0, 0, 2), (0, 0, 0)), Pose.looking_at((0, 0, 2), (0, 0, 0), np.pi / 2)
    right, up = np.array([[0.1, 0, 0]]), np.array([[0, 0.1, 0]])
    np.testing.assert_allclose(project(LENSES[0], straight, right)[0], (324.5, 224.5))
    np.testing.assert_allclose(project(LENSES[0], straight, up)[0], (299.5, 199.5))  # rows count downward
    # the world's x now points up
    np.testing.assert_allclose(project(LENSES[0], turned, right)[0], (299.5, 199.5))


def test_the_flash_turns_with_the_phone():
    lens = Lens((1200, 900), 1000.0, flash=(1.0, 0.5, 0.0))
    straight, turned = Pose.looking_at((0, 0, 20), (0, 0, 0)), Pose.looking_at((0, 0, 20), (0, 0, 0),
                                                                               np.pi / 2)
    np.testing.assert_allclose(straight.flash(lens), (1, -0.5, 20), atol=1e-12)  # y of the camera points down
    np.testing.assert_allclose(turned.flash(lens), (-0.5, -1, 20), atol=1e-12)
    pose = Pose.looking_at((5, -3, 20), (1, 0, 0), 0.4)
    camera = pose.rotation @ (pose.flash(lens) - pose.position)
    np.testing.assert_allclose(camera, lens.flash, atol=1e-12)


def test_vignetting_counts_from_the_middle_to_the_corner():
    lens = Lens((400, 300), 300.0, (210.0, 140.0), vignetting=(-0.3, 0.1))
    np.testing.assert_allclose(lens.transmission(np.array([[199.5, 149.5], [-0.5, -0.5], [199.5, -0.5]])),
                               (1, 0.8, 1 - 0.3 * 0.36 + 0.1 * 0.36**2))


SIZE = 1.2


def coordinates(lens, pose, kind):
    """A photo whose red is x and green is y of the plane, from -1 to 1, and the largest value of its kind."""
    columns, rows = np.meshgrid(np.arange(lens.size[0]), np.arange(lens.size[1]))
    at = on_plane(lens, pose, np.stack((columns.ravel(), rows.ravel()), axis=1)).reshape(*columns.shape, 2)
    photo = np.concatenate(((at + 1) / 2, np.full_like(at[..., :1], 0.25)), axis=-1)
    whole = np.iinfo(kind).max if np.issubdtype(kind, np.integer) else 1
    return (np.rint(photo * whole) if whole > 1 else photo).clip(0, whole).astype(kind)


# Half a step of 8 bits is 3.9e-3. Floats were off by 3e-6 and 16 bits by 1.3e-5 with OpenCV 5; OpenCV 4
# rounds places to 1/32 pixel, which may come to 9e-5 here. A pixel is 4e-3 to 6e-3 wide.
@pytest.mark.parametrize("kind, limit", [(np.float32, 1.5e-4), (np.uint16, 1.5e-4), (np.uint8, 4e-3)])
@pytest.mark.parametrize("lens, pose", list(zip(LENSES, POSES)))
def test_rectified_photos_show_each_place_where_it_is(lens, pose, kind, limit):
    found = rectified(coordinates(lens, pose, kind), lens, pose, SIZE, 64)
    assert found.shape == (64, 64, 3) and found.dtype == np.float32
    truth = texel_positions(64).numpy()[..., :2] * SIZE
    assert np.abs(found[..., :2] * 2 - 1 - truth).max() < limit
    np.testing.assert_allclose(found[..., 2], 0.25, atol=limit)


@pytest.mark.parametrize("times", [1, 4, 7])
def test_pixels_are_averages_over_their_area(times):
    """Straight above and aligned, the answer is the block average: nothing is skipped or counted twice."""
    lens = Lens((32 * times, 32 * times), 100.0)
    pose = Pose.looking_at((0, 0, 100.0 * SIZE / (32 * times)), (0, 0, 0))
    photo = np.random.default_rng(0).random((*lens.size, 3)).astype(np.float32)
    found = rectified(photo, lens, pose, SIZE, 32)
    blocks = photo.reshape(32, times, 32, times, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(found, blocks, atol=1e-6)  # 0 was seen; sums of float32 may differ in order


def test_a_photo_reaches_to_the_rim_of_its_pixels():
    """A patch that fills the photo, at twice its resolution: samples lie outside the outermost centres."""
    lens, pose = Lens((32, 32), 100.0), Pose.looking_at((0, 0, 100.0 * SIZE / 32), (0, 0, 0))
    np.testing.assert_array_equal(rectified(np.full((32, 32, 3), 0.5, dtype=np.float32), lens, pose, SIZE,
                                            64), 0.5)


def test_what_a_photo_does_not_reach_is_nan():
    lens, pose = LENSES[0], Pose.looking_at((0.5, 0, 2.0), (0.5, 0, 0))
    found = rectified(coordinates(lens, pose, np.uint8), lens, pose, 1.7, 64)
    at = project(lens, pose, texel_positions(64).numpy().reshape(-1, 3) * 1.7).reshape(64, 64, 2)
    inside = ((at > 6) & (at < np.array(lens.size) - 7)).all(axis=-1)  # a texel is 7 pixels wide
    outside = ((at < -6) | (at > np.array(lens.size) + 5)).any(axis=-1)
    assert inside.sum() > 1000 and outside.sum() > 100
    assert np.isfinite(found[inside]).all() and np.isnan(found[outside]).all()


def test_many_rows_are_done_in_parts():
    """Photos much finer than the result are worked through in bands, which leave no seams."""
    lens = Lens((1500, 1500), 1400.0)
    pose = Pose.looking_at((0.1, 0.05, 1.2), (0, 0, 0))
    found = rectified(coordinates(lens, pose, np.uint16), lens, pose, SIZE, 80)
    truth = texel_positions(80).numpy()[..., :2] * SIZE
    assert np.abs(found[..., :2] * 2 - 1 - truth).max() < 1e-4  # 1.1e-5 was seen


def test_a_rig_is_plain_json():
    lens = Lens((4032, 3024), 3000.5, (2010.0, 1500.25), (0.06, -0.04), (-0.25, 0.05), (1.5, 0.4, 0.0))
    pose = Pose.looking_at((3, -2, 25), (0.4, 0.1, 0), 0.2)
    rig = Rig(lens, {"b.png": pose}, 11.52, "cm", "sheet", {"b.png": 0.25}, {"c.jpg": "blurred"})
    back = json.loads(json.dumps(rig_to_json(rig)))
    assert back["lens"] == {"size": [4032, 3024], "focal": 3000.5, "centre": [2010.0, 1500.25],
        "distortion": [0.06, -0.04], "vignetting": [-0.25, 0.05], "flash": [1.5, 0.4, 0.0]}
    stated = {"position": pose.position.tolist(), "rotation": pose.rotation.tolist()}
    assert back["poses"] == {"b.png": stated}
    assert (back["size"], back["unit"], back["source"]) == (11.52, "cm", "sheet")
    assert (back["errors"], back["rejected"], back["notes"]) == ({"b.png": 0.25}, {"c.jpg": "blurred"}, [])
