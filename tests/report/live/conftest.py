"""Fixtures that the tests of this folder share."""

import pytest
from helpers import photos_of
from helpers.live_fits import SIDE

from mitsvbrdf.fit import live as fit_live
from mitsvbrdf.material.made import make_material


@pytest.fixture(scope="session")
def capture():
    return photos_of(make_material("inlay", SIDE), noise=0.003)


@pytest.fixture
def every_step(monkeypatch):
    """A record at each step."""
    monkeypatch.setattr(fit_live, "SECONDS", 0.0)
    monkeypatch.setattr(fit_live, "SHARE", 1.0)
