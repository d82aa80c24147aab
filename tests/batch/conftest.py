"""A library on this machine's disk with one result in it."""

import pytest
from helpers.batches import FOLDER, TASK, publish_result

from mitsvbrdf.batch.places.place import LocalPlace


@pytest.fixture
def place(tmp_path):
    return LocalPlace(tmp_path)


@pytest.fixture
def result(place):
    """A result that appeared; its folder."""
    assert publish_result(place, TASK)
    return place.root / FOLDER
