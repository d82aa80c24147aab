"""Raw photos of a flat material to lens and poses: a simulated phone over a textured plane, of which everything is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations

import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from mitsvbrdf.capture.align import from_photos, pairs
from mitsvbrdf.capture.align.features import Features, find_features, homography, match
from mitsvbrdf.capture.align.from_photos import rig_from_photos
from mitsvbrdf.capture.align.pairs import Pair, chained_pairs
from mitsvbrdf.capture.align.patch import centred_square, choose_patch, largest_square, turned, upright
from mitsvbrdf.capture.align.planar import Match, adjust, carried, starts
from mitsvbrdf.capture.lens import Lens, Pose, on_plane, project
from mitsvbrdf.capture.photo import Photo
from mitsvbrdf.errors import CaptureError

SIZE = (480, 360)
LENS = Lens(SIZE, 0.75 * SIZE[0], distortion=(0.02, -0.01), flash=(0.08, 0.0, 0.0))
SPAN = 2.4  # side of the material; cameras are some 1.5 above it


@cache
def texture(seed=0, side=1200):
    """Noise of several scales, in display values."""
    rng = np.random.default_rng(seed)
    out = np.zeros((side, side), dtype=np.float32)
    for blur, weight in ((1.2, 0.35), (3, 0.35), (8, 0.4), (30, 0.4)):
        layer = cv2.GaussianBlur(rng.standard_normal(out.shape).astype(np.float32), (0, 0), blur)
        out += weight * layer / layer.std()
    return np.clip(0.4 + 0.15 * out, 0.05, 0.9)


def photo_of(material, lens, pose, seed, shine=1.2):
    """What the phone stores: the material under its flash, with falloff, a highlight that moves with it, and noise."""
    columns, rows = np.meshgrid(np.arange(lens.size[0]), np.arange(lens.size[1]))
    at = on_plane(lens, pose, np.stack((columns, rows), axis=-1).reshape(-1, 2))
    texels = ((np.stack((at[:, 0], -at[:, 1]), axis=1) / SPAN + 0.5) * len(material) - 0.5).astype(np.float32)
    seen = cv2.remap(material, texels.reshape(*columns.shape, 2), None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    x, y, z = pose.flash(lens)
    aside = np.square(at - (x, y)).sum(axis=1).reshape(columns.shape) / z**2
    light = seen**2.2 * 1.2 * (1 + aside) ** -1.5 + shine * np.exp(-aside / 0.006) * (0.3 + seen)
    noise = 0.01 * np.random.default_rng(seed).standard_normal(light.shape)
    return (np.clip(np.clip(light, 0, 1) ** (1 / 2.2) + noise, 0, 1) * 255).round().astype(np.uint8)


def held(count, seed=0, spread=0.35, turn=8.0):
    """Poses of a hand."""
    rng = np.random.default_rng(seed)
    found = {}
    for i in range(count):
        position = np.array([*rng.uniform(-spread, spread, 2), 1.5 * np.exp(rng.normal(0, 0.06))])
        aim = np.append(position[:2] * 0.5 + rng.normal(0, 0.06, 2), 0.0)
        found[f"{i}.png"] = Pose.looking_at(position, aim, np.deg2rad(rng.normal(0, turn)))
    return found


def save(folder, name, pixels, orientation=1, stated=27):
    Image.fromarray(np.repeat(pixels[..., None], 3, axis=2)).save(folder / name)
    return Photo(folder / name, (pixels.shape[1], pixels.shape[0]), orientation,
                 {"35 mm focal length": stated} if stated else {})


# LENS is one of 0.75 * 43.27 / 1.25 = 26.0 mm: what is stated is 4 % too long, twice the deviation expected.
def take(folder, poses, material=None, stated=27, **how):
    material = texture() if material is None else material
    return [save(folder, name, photo_of(material, LENS, pose, i, **how), stated=stated)
            for i, (name, pose) in enumerate(poses.items())]


def position_errors(rig, poses):
    """Distances to the true positions after the best common similarity of the plane, as shares of the distance: N."""
    ours = np.array([rig.poses[name].position for name in rig.poses])
    true = np.array([poses[name].position for name in rig.poses])
    a, b = ours[:, 0] + 1j * ours[:, 1], true[:, 0] + 1j * true[:, 1]

    def off(x):
        scale = x[0] + 1j * x[1]
        aside = scale * a + x[2] + 1j * x[3] - b
        return np.stack((aside.real, aside.imag, abs(scale) * ours[:, 2] - true[:, 2]))

    found = least_squares(lambda x: off(x).ravel(), (1.0, 0.0, 0.0, 0.0)).x
    return np.linalg.norm(off(found), axis=0) / np.linalg.norm(true, axis=1)


def misalignment(rig, poses):
    """RMS distance, in pixels at 512, between the points of the material that rectified photos show at the same place."""
    steps = (np.arange(9) + 0.5) / 9 - 0.5
    grid = np.array([[x, y, 0.0] for y in steps for x in steps]) * rig.size
    seen = np.stack([on_plane(LENS, poses[name], project(rig.lens, pose, grid)) for name, pose in rig.poses.items()])
    side = np.linalg.norm(seen[:, 8] - seen[:, 0], axis=1).mean() * 9 / 8
    return np.sqrt(np.square(seen - seen.mean(axis=0)).sum(axis=-1).mean()) / side * 512


@pytest.fixture(scope="module")
def nine(tmp_path_factory):
    poses = held(9, seed=6)
    return poses, take(tmp_path_factory.mktemp("nine"), poses)


@pytest.fixture(scope="module")
def nine_rig(nine):
    return rig_from_photos(nine[1])


def test_poses_and_alignment(nine, nine_rig):
    poses, _ = nine
    assert set(nine_rig.poses) == set(poses) and not nine_rig.left_out and not nine_rig.notes
    assert (nine_rig.size, nine_rig.unit, nine_rig.source) == (1.0, "patch sides", "photos")
    assert position_errors(nine_rig, poses).max() < 0.001  # measured 0.0003
    assert misalignment(nine_rig, poses) < 0.06  # pixels at 512; measured 0.025
    assert max(nine_rig.errors.values()) < 0.4  # pixels; measured 0.24 to 0.28
    assert nine_rig.lens.focal == pytest.approx(LENS.focal, rel=0.01)  # measured 0.006; what was stated is off by 4 %


def test_all_photos_show_the_patch(nine_rig):
    corners = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    for pose in nine_rig.poses.values():
        seen = project(nine_rig.lens, pose, corners)
        assert seen.min() > 0 and (seen < np.array(SIZE) - 1).all()


def test_reference(nine, nine_rig):
    poses, photos = nine
    straightest = min(poses, key=lambda name: poses[name].rotation[2, 2])
    assert upright(nine_rig.poses[straightest], 1) == pytest.approx(0, abs=1e-9)
    assert straightest != "0.png"
    rig = rig_from_photos([replace(photo, orientation=8) for photo in photos[:4]], reference="first")
    assert upright(rig.poses["0.png"], 8) == pytest.approx(0, abs=1e-9)


def test_photos_left_alone_by_few_features_are_compared_by_all(nine, monkeypatch):
    features = {photo.name: find_features(photo) for photo in nine[1][:3]}
    monkeypatch.setattr(pairs, "FEW_FEATURES", 20)
    assert all(pair.count > 100 for pair in pairs.find_pairs(features, SIZE, lambda share: None))


def quarter(pose):
    """The phone turned by 90 degrees."""
    return Pose(pose.position, np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) @ pose.rotation)


def test_turned_phone(tmp_path):
    poses = held(5, seed=1)
    poses["2.png"] = quarter(poses["2.png"])
    rig = rig_from_photos(take(tmp_path, poses))
    assert set(rig.poses) == set(poses)
    assert position_errors(rig, poses).max() < 0.001  # measured 0.0002
    assert misalignment(rig, poses) < 0.06  # pixels at 512; 0.02, and 0.33 where features are all off by 0.25 pixels


def test_what_cannot_be_used_is_named(tmp_path):
    poses = held(7, seed=2)
    good = {name: poses[name] for name in ("0.png", "1.png", "2.png", "3.png")}
    photos = take(tmp_path, good)
    photos.append(save(tmp_path, "blank.png", np.full(SIZE[::-1], 90, dtype=np.uint8)))
    photos.append(save(tmp_path, "other.png", photo_of(texture(5), LENS, poses["4.png"], 4)))
    photos.append(save(tmp_path, "zoomed.png", photo_of(texture(), LENS, poses["5.png"], 5), stated=52))
    photos.append(save(tmp_path, "upright.png", np.rot90(photo_of(texture(), LENS, poses["6.png"], 6))))
    rig = rig_from_photos(photos)
    assert set(rig.poses) == set(good) and position_errors(rig, good).max() < 0.001  # measured 0.0001
    assert set(rig.left_out) == {"blank.png", "other.png", "zoomed.png", "upright.png"}
    for name, reason in (("blank", "too few"), ("other", "another material"), ("zoomed", "52 mm, most have 27 mm"),
                         ("upright", "360 x 480 pixels, the others have 480 x 360")):
        assert reason in rig.left_out[f"{name}.png"]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_photos(tmp_path, count):
    with pytest.raises(CaptureError, match=f"3 or more photos .* got {count} of {count}"):
        rig_from_photos(take(tmp_path, held(count)))


def test_a_pattern_that_repeats_itself_is_noted(tmp_path):
    """Tiles of 0.3, all alike: what is seen at one of them is seen at each."""
    rig = rig_from_photos(take(tmp_path, held(3), np.tile(texture()[:150, :150], (8, 8))))
    assert any("repeats itself" in note for note in rig.notes)


def test_photos_of_nothing_in_common(tmp_path):
    photos = [save(tmp_path, f"{i}.png", photo_of(texture(i), LENS, pose, i)) for i, pose in enumerate(held(3).values())]
    with pytest.raises(CaptureError, match="no agreement with any other photo"):
        rig_from_photos(photos)


def test_parallel_photos(tmp_path):
    """Moved sideways only, a focal length looks like a height and a tilt like a shift: what is expected decides."""
    poses = {f"{i}.png": Pose(np.array([x, y, 1.5]), np.diag((1.0, -1.0, -1.0)))
             for i, (x, y) in enumerate(((0, 0), (0.2, 0.1), (-0.2, 0.1), (0.1, -0.2), (-0.1, 0.2)))}
    rig = rig_from_photos(take(tmp_path, poses))
    assert misalignment(rig, poses) < 0.06  # pixels at 512; measured 0.013
    assert position_errors(rig, poses).max() < 0.01  # measured 0.0055: the stated focal length is off by 4 %
    assert any("focal length stays uncertain" in note for note in rig.notes)


def test_photos_from_one_place():
    """Turned only, a camera cannot tell how the plane is tilted: then it is expected to look straight down."""
    lens = Lens((1000, 800), 900.0)
    turns = Rotation.from_euler("xyz", [[0, 0, 0], [4, 0, 20], [-4, 2, 0], [0, -2, 90]], degrees=True).as_matrix()
    poses = {name: Pose(np.array([0, 0, 1.0]), turn @ np.diag((1.0, -1.0, -1.0))) for name, turn in zip("abcd", turns)}
    grid = np.stack(np.meshgrid(np.linspace(300, 700, 7), np.linspace(250, 550, 6)), axis=-1).reshape(-1, 2)
    matches = [Match(a, b, grid, carried(lens, poses[a], poses[b], grid), 0.5) for a, b in combinations(poses, 2)]
    tilt = Rotation.from_euler("x", 15, degrees=True).as_matrix()
    tilted = {name: Pose(pose.position, pose.rotation @ tilt) for name, pose in poses.items()}  # agrees as well
    _, found, cost, _ = adjust(lens, tilted, "a", matches, lens.focal, 0.02)
    assert cost < 1  # half a sum of squares; measured 0.2, where the start has 4.7
    off = [pose.rotation[:, 2] @ poses[name].rotation[:, 2] for name, pose in found.items()]
    assert np.degrees(np.arccos(np.minimum(off, 1))).max() < 0.1  # measured 0.004; 15 at first


@pytest.mark.parametrize("turned, low, high", [(0.0, 0.0199, 0.0201), (1.0, 0.002, 0.01)])
def test_how_sure_the_focal_length_is(turned, low, high):
    """Photos that are parallel leave it as sure as it was before; from aside they tell it. The matches are exact."""
    poses = {name: Pose.looking_at((x, y, 1.5), ((1 - turned) * x, (1 - turned) * y, 0)) for name, x, y in
             (("a", 0.0, 0.1), ("b", -0.5, 0.2), ("c", 0.6, -0.2), ("d", -0.1, 0.5), ("e", 0.1, -0.5))}
    lens = Lens(SIZE, 360.0)
    grid = np.stack(np.meshgrid(np.linspace(40, 440, 9), np.linspace(30, 330, 7)), axis=-1).reshape(-1, 2)
    matches = [Match(a, b, grid, carried(lens, poses[a], poses[b], grid), 0.5) for a, b in combinations(poses, 2)]
    origin = np.array([*poses["a"].position[:2], 0.0])
    start = {name: Pose((pose.position - origin) / 1.5, pose.rotation) for name, pose in poses.items()}
    unsure = adjust(lens, start, "a", matches, lens.focal, 0.02)[3]
    assert low < unsure < high  # parallel just what is expected beforehand, 0.02; turned to the middle, measured 0.006


def test_what_is_expected_of_the_focal_length_is_not_what_was_found_before():
    """Parallel photos leave it to what is expected, from wherever the search starts."""
    poses = {name: Pose(np.array([x, y, 1.0]), np.diag((1.0, -1.0, -1.0))) for name, x, y in
             (("a", 0.0, 0.0), ("b", -0.2, 0.1), ("c", 0.1, -0.2))}
    lens = Lens(SIZE, 360.0)
    grid = np.stack(np.meshgrid(np.linspace(40, 440, 9), np.linspace(30, 330, 7)), axis=-1).reshape(-1, 2)
    matches = [Match(a, b, grid, carried(lens, poses[a], poses[b], grid), 0.5) for a, b in combinations(poses, 2)]
    found = adjust(replace(lens, focal=400.0), poses, "a", matches, 360.0, 0.02)[0]
    assert found.focal == pytest.approx(360.0, rel=1e-3)


@pytest.mark.slow
def test_no_exif_and_a_large_highlight(tmp_path):
    """Without EXIF 60 degrees are assumed, here 10 % off; the highlight hides a quarter of each photo."""
    poses = held(6, seed=3)
    rig = rig_from_photos(take(tmp_path, poses, stated=None, shine=8.0))
    assert set(rig.poses) == set(poses) and "no EXIF" in rig.notes[0] and "67 degrees" in rig.notes[0]
    assert position_errors(rig, poses).max() < 0.002 and misalignment(rig, poses) < 0.06  # measured 0.0007, 0.020


def test_a_photo_that_shows_another_part(tmp_path):
    poses = held(5, seed=4)
    poses["3.png"] = Pose.looking_at((0.1, 0.65, 1.5), (0.1, 0.65, 0.0))
    rig = rig_from_photos(take(tmp_path, poses))
    assert rig.left_out == {"3.png": "it shows too little of what the others show"} and len(rig.poses) == 4


@pytest.mark.parametrize("orientation", range(1, 9))
def test_top_of_a_photo_by_its_exif(orientation):
    """Pillow's own turning as the judge: where is the stored pixel that it puts at the middle of the top row?"""
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
    for below, wanted in (((0.7, 0.02), (0.7, 0.02)), ((0.7, 0.3), (0.7, 0.05)), ((-3.0, -1.0), (-1.05, -0.05))):
        assert centred_square([box], 1.9, np.array(below)) == pytest.approx(np.array(wanted), abs=1e-9)


def test_largest_square():
    wide = np.array([(1, 0, 2.0), (-1, 0, 2.0), (0, 1, 0.5), (0, -1, 0.7)])  # x from -2 to 2, y from -0.7 to 0.5
    assert largest_square([wide])[1] == pytest.approx(1.2)
    tilted = np.array([(c, s, 1.0) for c, s in ((0.6, 0.8), (-0.6, -0.8), (0.8, -0.6), (-0.8, 0.6))])
    centre, side = largest_square([tilted])  # in a square of side 2 turned by t: 2 / (cos t + sin t)
    assert centre == pytest.approx((0, 0)) and side == pytest.approx(2 / 1.4)
    assert largest_square([wide, np.array([(-1.0, 0.0, -3.0)])])[1] < 0


def test_a_photo_that_would_cost_too_much_of_the_patch_is_left_out():
    box = np.array([(1, 0, 1.0), (-1, 0, 1.0), (0, 1, 1.0), (0, -1, 1.0)])
    photos = {"a": box, "b": box, "c": box, "d": box * (1, 1, 0.85), "e": box * (1, 1, 0.6)}
    _, side, out = choose_patch(photos)
    assert out == ["e"] and side == pytest.approx(1.7)
    assert choose_patch(photos, least=5)[1:] == (pytest.approx(1.2), [])
    assert choose_patch(photos, always="e")[2] == []


def test_a_tree_of_homographies():
    """Photo d has nothing in common with a; and where two ways lead to c, that of more matches is taken."""
    rng = np.random.default_rng(0)
    true = {name: np.eye(3) + rng.normal(0, 0.05, (3, 3)) * (1, 1, 0.01) for name in "abcd"}  # from the plane

    def pair(a, b, count, right=True):
        matches = Match(a, b, np.zeros((count, 2)), np.zeros((count, 2)), 1.0)
        wrong = np.diag((1.0 if right else 2.0, 1.0, 1.0))
        return Pair(matches, np.ones(count, dtype=bool), true[b] @ np.linalg.inv(true[a]) @ wrong)

    links = [pair("a", "b", 90), pair("b", "c", 40), pair("a", "c", 20, right=False), pair("d", "c", 30)]
    hub, warps = chained_pairs("abcde", links)
    assert hub == "b" and set(warps) == set("abcd")
    for name, warp in warps.items():
        expected = true[name] @ np.linalg.inv(true["b"])
        assert warp / warp[2, 2] == pytest.approx(expected / expected[2, 2])


def test_a_photo_that_agrees_with_each_other_differently_is_left_out():
    """Exact matches, but those of 4.png lie elsewhere for each other photo, as of a pattern that repeats itself."""
    poses, rng = held(5, seed=7), np.random.default_rng(2)
    pairs = []
    for n, (a, b) in enumerate(combinations(poses, 2)):
        at_a = rng.uniform(0, SIZE, (40 if b == "4.png" else 60, 2))
        points = np.pad(on_plane(LENS, poses[a], at_a), ((0, 0), (0, 1)))
        at_b = project(LENS, poses[b], points) + (15.0 * n if b == "4.png" else 0.0)
        warp, agree = homography(at_a, at_b, 1.0)
        pairs.append(Pair(Match(a, b, at_a, at_b, pairs.SIGMA), agree, warp))
    hub, warps = chained_pairs(poses, pairs)
    left_out = {}
    lens, found, _, _ = from_photos._posed(replace(LENS, distortion=(0.0, 0.0)), 0.02, hub, warps, pairs, left_out)
    assert list(left_out) == ["4.png"] and "fits a place of the camera" in left_out["4.png"]
    # Measured 0.001 off: what is expected of lens, heights and tilts holds a little against exact matches.
    first, other = ((p["1.png"].position - p["0.png"].position) / p["0.png"].position[2] for p in (found, poses))
    assert np.linalg.norm(first) == pytest.approx(np.linalg.norm(other), rel=5e-3)


def test_start_by_tilt():
    """Exact homographies of a hub that is tilted by 30 degrees: the best start has that tilt within the grid's 4 degrees."""
    lens = Lens((1000, 800), 900.0)
    poses = held(6, seed=5) | {"hub": Pose.looking_at((0.0, -0.8, 1.4), (0.0, 0.0, 0.0))}
    plane = {name: lens.matrix @ np.column_stack((p.rotation[:, :2], -p.rotation @ p.position)) for name, p in poses.items()}
    homographies = {name: h @ np.linalg.inv(plane["hub"]) for name, h in plane.items()}
    found = starts(lens, homographies, "hub")[0]
    for name, pose in poses.items():
        relative = pose.rotation @ poses["hub"].rotation.T
        assert np.degrees(np.arccos(np.clip(-found[name].rotation[2, 2], -1, 1))) == pytest.approx(
            np.degrees(np.arccos(-pose.rotation[2, 2])), abs=5)
        turn = found[name].rotation @ found["hub"].rotation.T @ relative.T
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 5


def test_matches_are_each_others_nearest():
    rng = np.random.default_rng(1)
    ours, noise, others = (rng.random((count, 128), dtype=np.float32) for count in (60, 30, 40))
    theirs = np.concatenate((ours[:30] + np.linspace(0, 6, 30, dtype=np.float32)[:, None] * noise, others))
    theirs[35] = theirs[3]  # two look alike: neither is a match
    ours[40] = ours[5] + 0.2 * noise[5]  # the nearest of 5 is another
    a, b = (Features(np.zeros((len(d), 2)), d / np.linalg.norm(d, axis=1, keepdims=True), 1.0) for d in (ours, theirs))
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(a.descriptors, b.descriptors, k=2)
    back = cv2.BFMatcher(cv2.NORM_L2).match(b.descriptors, a.descriptors)
    expected = [(p.queryIdx, p.trainIdx) for p, q in pairs
                if p.distance < 0.8 * q.distance and back[p.trainIdx].trainIdx == p.queryIdx]
    assert match(a, b).tolist() == [list(e) for e in expected] and 5 < len(expected) < 15
    assert match(a, b, most=6).tolist() == [[0, 0], [1, 1], [2, 2], [3, 3], [4, 4], [5, 5]]
