"""Fixtures that the tests of this folder share."""

import pytest
from helpers.crosschecks import BOTH, THREE

from mitsvbrdf.cli import crosscheck as command
from mitsvbrdf.material.corner_cases import corner_materials
from mitsvbrdf.material.made import make_material
from mitsvbrdf.render import make_renderer
from mitsvbrdf.verify.crosscheck import crosscheck


@pytest.fixture(scope="session")
def real():
    """Record and error maps of three renderers, two materials, both BSDFs; one has roughness below 0.1."""
    renderers = [make_renderer(name) for name in command.RENDERERS]
    materials = {"leather": make_material("leather", 24), "polished": corner_materials(24)["polished"]}
    maps: dict = {}
    return crosscheck(materials, THREE, BOTH, renderers, repeats=2, error_maps=maps), maps
