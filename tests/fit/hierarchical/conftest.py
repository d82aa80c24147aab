"""Fixtures that the tests of this folder share."""

import pytest
from helpers import photos_of
from helpers.hierarchical_fits import SIDE

from mitsvbrdf.fit.hierarchical import scales, stages
from mitsvbrdf.material.made import make_material


@pytest.fixture
def two_stages(monkeypatch):
    """Coarse stages at half the size of these tests' photos."""
    monkeypatch.setattr(scales, "COARSE", SIDE // 2)


@pytest.fixture
def phone(monkeypatch):
    """Photos are taken for a phone's, whatever they are."""
    monkeypatch.setattr(stages, "EXACT", 0.0)


@pytest.fixture(scope="module")
def capture():
    return photos_of(make_material("leather", SIDE))


@pytest.fixture(scope="module")
def tiles():
    return photos_of(make_material("tiles", 8))
