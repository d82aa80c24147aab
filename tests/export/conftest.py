"""Fixtures that the tests of this folder share."""

import pytest
from helpers.exported import BSDFS, gilt_plates

from mitsvbrdf.material.conversion import as_principled


@pytest.fixture(scope="session", params=BSDFS)
def material(request):
    """32 px, row and column told apart by every map, metal and plain texels."""
    made = gilt_plates(32)
    return made if request.param == "roughconductor" else as_principled(made)
