"""Files of maps: what is mended on the way in, and what is refused."""

import numpy as np
import pytest
import torch

from mitsvbrdf import cli
from mitsvbrdf.errors import MapsError, MapsWarning
from mitsvbrdf.fit.fixed_maps import fixed_maps
from mitsvbrdf.io import images
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps, save_maps

SIDE = 32


def with_normals_under(folder, count):
    """A material of which this many texels' normals point down, aslant and straight in turns."""
    save_maps(make_material("leather", SIDE), folder)
    (folder / "normal.exr").unlink()
    normal = images.read_image(folder / "normal.png", MapsError)
    wrong = torch.tensor([[0.9, 0.5, 0.4], [0.5, 0.5, 0.0]])
    flat = normal.view(-1, 3)
    flat[:count] = wrong.repeat(count // 2 + 1, 1)[:count]
    images.write_png(folder / "normal.png", normal, bits=16)
    return folder


def test_a_few_normals_below_the_horizon_are_lifted_counted_and_said(tmp_path):
    folder = with_normals_under(tmp_path / "m", 3)
    with pytest.warns(MapsWarning, match=r"normal.png: 3 of 1024 normals \(0.29%\)"):
        normal = load_maps(folder)["normal"].reshape(-1, 3).numpy()
    lowest = 1 / 255
    side = np.array([0.8, 0.0, -0.2]) / np.linalg.norm([0.8, 0.0, -0.2])  # as stored
    expected = np.array([side[0], 0.0, lowest]) / np.hypot(side[0], lowest)
    assert np.abs(normal[0] - expected).max() < 3e-5  # 16 bits: 1.5e-5 a step, of a vector of length 0.82
    assert normal[1, 2] > 0.99 and normal[2, 2] > 0 and np.allclose(np.linalg.norm(normal[:3], axis=1), 1)
    untouched = make_material("leather", SIDE)["normal"].reshape(-1, 3)[3:].numpy()
    assert np.abs(normal[3:] - untouched).max() < 5e-5


def test_a_fixed_normal_map_is_read_the_same_way(tmp_path):
    folder = with_normals_under(tmp_path / "m", 2)
    with pytest.warns(MapsWarning, match="2 of 1024"):
        fixed = fixed_maps([f"normal={folder / 'normal.png'}"], "roughconductor", SIDE)["normal"]
    assert bool((fixed[..., 2] > 0).all())


@pytest.mark.filterwarnings("error")
def test_sound_maps_are_read_without_a_word(tmp_path):
    load_maps(with_normals_under(tmp_path / "m", 0))


def test_many_are_another_convention_and_refused(tmp_path):
    with pytest.raises(MapsError, match="11 of 1024 that point into the surface"):  # more than 1 %
        load_maps(with_normals_under(tmp_path / "m", 11))


def test_the_command_line_says_it_in_one_line_and_goes_on(tmp_path, capsys):
    folder = with_normals_under(tmp_path / "m", 1)
    assert cli.main(["evaluate", str(folder), "--reference", str(folder)]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "into the surface" in line]
    assert len(lines) >= 1 and all(line.startswith("warning: ") and "test_map" not in line for line in lines)
