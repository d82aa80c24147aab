"""Fixtures that the tests of this folder share."""

import pytest
from helpers import ANALYTIC, photos_of

from mitsvbrdf.material.made import make_material
from mitsvbrdf.synth.photograph import photograph
from mitsvbrdf.views import nine_view_grid


@pytest.fixture(scope="session")
def leather():
    return photograph(make_material("leather", 16), nine_view_grid(), ANALYTIC)


@pytest.fixture(scope="session")
def capture():
    return photos_of(make_material("inlay", 32))
