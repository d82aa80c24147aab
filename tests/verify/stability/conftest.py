"""Fixtures that the tests of this folder share."""

import pytest
from helpers.one_sweep import FEW

from mitsvbrdf.verify.stability import SWEEPS
from mitsvbrdf.verify.stability.sweeps import Case, material, tilted


@pytest.fixture
def one_case(monkeypatch):
    grazing = material(normal=tilted(85))
    monkeypatch.setitem(SWEEPS, "tilt", ("One case", lambda: [Case("tilt", "85 degrees", 85, grazing, FEW)]))
