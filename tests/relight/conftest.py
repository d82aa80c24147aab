"""Fixtures that the tests of this folder share."""

import pytest

from mitsvbrdf.render.llvm import mitsuba_module


@pytest.fixture(scope="session")
def mi():
    return mitsuba_module()
