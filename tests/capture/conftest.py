"""Fixtures that the tests of this folder share."""

import pytest
from helpers.made_photos import ground, poses, stored, taken

from mitsvbrdf.capture.lens import Lens, Pose


@pytest.fixture(scope="session")
def plain(tmp_path_factory):
    """Six photos without a sheet, of 600 x 450 pixels, from places that show the patch more largely."""
    raw, lens = tmp_path_factory.mktemp("plain"), Lens((600, 450), 450.0, flash=(1.4, 0.3, 0.0))
    what = ground(False)
    for i, (name, pose) in enumerate(list(poses(height=20.0).items())[:6]):
        stored(raw / name, taken(what, lens, Pose(pose.position, Pose.looking_at(
            pose.position, (*pose.position[:2] * 0.5, 0), 0.05 * i).rotation), seed=i), iso=100 if i else 200)
    return raw
