"""Whoever reads what a kill left half in place meets it whole."""

import pytest
from helpers import photos_of
from helpers.half_put import half_put

from mitsvbrdf.capture import read_capture, write_capture
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps, save_maps


@pytest.mark.parametrize("read", [read_capture, lambda folder: read_capture(folder / "capture.json")])
def test_a_capture(tmp_path, capsys, read):
    write_capture(photos_of(make_material("inlay", 8)), tmp_path)
    half_put(tmp_path)
    assert len(read(tmp_path)) == 9
    assert "was killed while it put its result in place" in capsys.readouterr().out


@pytest.mark.parametrize("inner", [".", "maps", "look"])
def test_maps(tmp_path, inner):
    save_maps(make_material("inlay", 8), tmp_path / inner)
    half_put(tmp_path)
    assert load_maps(tmp_path / inner).resolution == 8
