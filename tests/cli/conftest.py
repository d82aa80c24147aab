"""Fixtures that the tests of this folder share."""

import pytest

from mitsvbrdf import cli


@pytest.fixture(scope="session")
def shots(tmp_path_factory):
    """A capture of nine photos of the builtin inlay, 48 px, made by `synth`."""
    folder = tmp_path_factory.mktemp("capture") / "photos"
    assert cli.main(["synth", "builtin:inlay", "-o", str(folder), "--resolution", "48", "--noise",
                     "0.002"]) == 0
    return folder
