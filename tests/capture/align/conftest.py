"""Fixtures that the tests of this folder share."""

import pytest
from helpers.tag_sheet import POSES, photograph


@pytest.fixture(scope="session")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photos")
    names = ["a.jpg", "b.jpg", "c.png", "d.jpg", "e.jpg"]
    return [photograph(folder / name, pose, glare=(8.0, 7.5) if name == "b.jpg" else None, seed=i)
            for i, (name, pose) in enumerate(zip(names, POSES))]
