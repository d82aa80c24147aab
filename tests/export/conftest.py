"""Fixtures that the tests of this folder share."""

import pytest
from helpers.exported import BSDFS

from mitsvbrdf.material.conversion import as_principled
from mitsvbrdf.material.made import make_material


@pytest.fixture(scope="session", params=BSDFS)
def material(request):
    """32 px, row and column told apart by every map, metal and plain texels."""
    made = make_material("plates", 32)
    return made if request.param == "roughconductor" else as_principled(made)
