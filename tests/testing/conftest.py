"""Fixtures that the tests of this folder share."""

import sys

import pytest
from helpers.golden_suite import TWO, Suite

from mitsvbrdf.material.maps import flat
from mitsvbrdf.render import make_renderer
from mitsvbrdf.testing import running


@pytest.fixture
def report(tmp_path, monkeypatch):
    """Pages of comparisons that are meant to fail go here instead of beside those of this suite."""
    monkeypatch.setattr(running, "now", running.Running(
        "tests/test_a.py::test_b[c/d]", tmp_path / "test_a.py", report=tmp_path / "report"))
    return tmp_path / "report"


@pytest.fixture
def loaded():
    """Mitsuba and the lazy modules of Dr.Jit, loaded for good.

    After each run ``pytester`` makes Python forget what has been loaded meanwhile, and neither survives being
    loaded twice. Lazy modules load when first asked for anything, as a failing test asks every module.
    """
    make_renderer("mitsuba-scene").render(flat(2), TWO)
    for module in list(sys.modules.values()):
        hasattr(module, "__file__")


@pytest.fixture
def suite(loaded, pytester, monkeypatch):
    # no plugins but ours, whatever is installed here
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    return Suite(pytester).write()
