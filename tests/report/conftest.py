"""Fixtures that the tests of this folder share."""

import json
import shutil
from dataclasses import replace

import pytest
import torch
from helpers import GRID, photos_of
from helpers.fit_pages import FAST, HOSTILE, SIDE, Page

from mitsvbrdf import cli
from mitsvbrdf.capture import write_capture
from mitsvbrdf.material.made import make_material


@pytest.fixture(scope="session")
def photos(tmp_path_factory):
    """Five photos of the inlay in a folder with a hostile name; the flash stands beside the camera."""
    folder, views = tmp_path_factory.mktemp("capture") / HOSTILE, GRID.pick([0, 1, 3, 5, 7])
    beside = replace(views, light=views.light + torch.tensor([0.05, 0.02, 0.0], dtype=torch.float64))
    write_capture(photos_of(make_material("inlay", SIDE), beside), folder)
    return folder


@pytest.fixture(scope="session")
def fitted(photos, tmp_path_factory):
    """A fit to photos 0, 1 and 3."""
    out = tmp_path_factory.mktemp("fit") / "out"
    assert cli.main(["fit", str(photos), "-o", str(out), *FAST, "--views", "0,1,3"]) == 0
    return out


@pytest.fixture
def copy(fitted, tmp_path):
    return shutil.copytree(fitted, tmp_path / "out")


@pytest.fixture(scope="session")
def measured(fitted, tmp_path_factory):
    """The same fit after `mitsvbrdf report`: its folder, the two records, and the page."""
    out = shutil.copytree(fitted, tmp_path_factory.mktemp("report") / "out")
    assert cli.main(["report", str(out)]) == 0
    fit, record = (json.loads((out / name).read_text()) for name in ("fit.json", "report.json"))
    return out, fit, record, Page(out / "report.html")
