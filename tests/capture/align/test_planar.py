"""Poses of a plane's photos: parallel ones, ones from one place, and how sure the focal length is."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from helpers.textured_plane import SIZE, held, misalignment, position_errors, take
from scipy.spatial.transform import Rotation

from mitsvbrdf.capture.align.from_photos import rig_from_photos
from mitsvbrdf.capture.align.planar import Match, adjust, carried, starts
from mitsvbrdf.capture.lens import Lens, Pose, rays


def exact(lens, poses, columns, rows):
    """Matches of each pair of photos, without errors, at a grid of pixels."""
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    return [Match(a, b, grid, carried(lens, poses[a], poses[b], rays(lens, grid)), 0.5)
            for a, b in combinations(poses, 2)]


@pytest.mark.slow
def test_parallel_photos(tmp_path):
    """Moved sideways only, a focal length looks like a height, a tilt like a shift: the prior decides."""
    poses = {f"{i}.png": Pose(np.array([x, y, 1.5]), np.diag((1.0, -1.0, -1.0)))
             for i, (x, y) in enumerate(((0, 0), (0.2, 0.1), (-0.2, 0.1), (0.1, -0.2), (-0.1, 0.2)))}
    rig = rig_from_photos(take(tmp_path, poses))
    assert misalignment(rig, poses) < 0.06  # pixels at 512; measured 0.013
    assert position_errors(rig, poses).max() < 0.01  # measured 0.0055: the stated focal length is off by 4 %
    assert any("focal length is uncertain" in note for note in rig.notes)


def test_photos_from_one_place():
    """Turned only, a camera cannot tell how the plane is tilted: it is expected to look straight down."""
    lens = Lens((1000, 800), 900.0)
    turns = Rotation.from_euler("xyz", [[0, 0, 0], [4, 0, 20], [-4, 2, 0], [0, -2, 90]],
                                degrees=True).as_matrix()
    poses = {name: Pose(np.array([0, 0, 1.0]), turn @ np.diag((1.0, -1.0, -1.0)))
             for name, turn in zip("abcd", turns)}
    matches = exact(lens, poses, np.linspace(300, 700, 7), np.linspace(250, 550, 6))
    tilt = Rotation.from_euler("x", 15, degrees=True).as_matrix()
    # agrees as well
    tilted = {name: Pose(pose.position, pose.rotation @ tilt) for name, pose in poses.items()}
    _, found, cost, _ = adjust(lens, tilted, "a", matches, lens.focal, 0.02)
    assert cost < 1  # half a sum of squares; measured 0.2, where the start has 4.7
    off = [pose.rotation[:, 2] @ poses[name].rotation[:, 2] for name, pose in found.items()]
    assert np.degrees(np.arccos(np.minimum(off, 1))).max() < 0.1  # measured 0.004; 15 at first


@pytest.mark.parametrize("turned, low, high", [(0.0, 0.0199, 0.0201), (1.0, 0.002, 0.01)])
def test_how_sure_the_focal_length_is(turned, low, high):
    """Parallel photos leave it as sure as it was before; photos from aside tell it. Matches are exact."""
    poses = {name: Pose.looking_at((x, y, 1.5), ((1 - turned) * x, (1 - turned) * y, 0)) for name, x, y in
             (("a", 0.0, 0.1), ("b", -0.5, 0.2), ("c", 0.6, -0.2), ("d", -0.1, 0.5), ("e", 0.1, -0.5))}
    lens = Lens(SIZE, 360.0)
    matches = exact(lens, poses, np.linspace(40, 440, 9), np.linspace(30, 330, 7))
    origin = np.array([*poses["a"].position[:2], 0.0])
    start = {name: Pose((pose.position - origin) / 1.5, pose.rotation) for name, pose in poses.items()}
    unsure = adjust(lens, start, "a", matches, lens.focal, 0.02)[3]
    # parallel just what is expected beforehand, 0.02; turned to the middle, measured 0.006
    assert low < unsure < high


def test_what_is_expected_of_the_focal_length_is_not_what_was_found_before():
    """Parallel photos leave it to what is expected, from wherever the search starts."""
    poses = {name: Pose(np.array([x, y, 1.0]), np.diag((1.0, -1.0, -1.0)))
             for name, x, y in (("a", 0.0, 0.0), ("b", -0.2, 0.1), ("c", 0.1, -0.2))}
    lens = Lens(SIZE, 360.0)
    matches = exact(lens, poses, np.linspace(40, 440, 9), np.linspace(30, 330, 7))
    found = adjust(replace(lens, focal=400.0), poses, "a", matches, 360.0, 0.02)[0]
    assert found.focal == pytest.approx(360.0, rel=1e-3)


def test_start_by_tilt():
    """Exact homographies of a hub tilted by 30 degrees: the best start has it within the grid's 4 degrees."""
    lens = Lens((1000, 800), 900.0)
    poses = held(6, seed=5) | {"hub": Pose.looking_at((0.0, -0.8, 1.4), (0.0, 0.0, 0.0))}
    plane = {name: lens.matrix @ np.column_stack((p.rotation[:, :2], -p.rotation @ p.position))
             for name, p in poses.items()}
    homographies = {name: h @ np.linalg.inv(plane["hub"]) for name, h in plane.items()}
    found = starts(lens, homographies)[0]
    for name, pose in poses.items():
        relative = pose.rotation @ poses["hub"].rotation.T
        assert np.degrees(np.arccos(np.clip(-found[name].rotation[2, 2], -1, 1))) == pytest.approx(
            np.degrees(np.arccos(-pose.rotation[2, 2])), abs=5)
        turn = found[name].rotation @ found["hub"].rotation.T @ relative.T
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 5
