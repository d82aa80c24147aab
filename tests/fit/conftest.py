"""Fixtures that the tests of this folder share."""

import pytest
from helpers import photos_of

from mitsvbrdf.material.made import make_material


@pytest.fixture(scope="session")
def leather():
    return photos_of(make_material("leather", 16))


@pytest.fixture(scope="session")
def capture():
    return photos_of(make_material("inlay", 32))
