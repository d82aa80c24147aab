"""Normals in files: signed, of two channels, of DirectX."""

import warnings

import numpy as np
import OpenEXR
import pytest
import torch

from mitsvbrdf.errors import MapsWarning
from mitsvbrdf.io import images
from mitsvbrdf.material.map_files import load_maps, save_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.material.normals import directx_by_curl, unit_normals

SIDE = 64


def bump():
    """Normals of the height .03 exp(-r^2 / .01), by its derivatives; rows go down, y up."""
    step = (torch.arange(SIDE) + 0.5) / SIDE - 0.5
    y, x = torch.meshgrid(-step, step, indexing="ij")
    slope = 6 * torch.exp(-(x**2 + y**2) / 0.01)
    normal = torch.stack((slope * x, slope * y, torch.ones_like(x)), dim=-1)
    return torch.nn.functional.normalize(normal, dim=-1)


TURNED = torch.tensor([1.0, -1.0, 1.0])


def written(folder, pixels, **channels):
    """A material whose normals are this EXR: R, G, B, or the channels given."""
    save_maps(flat(SIDE), folder)
    for path in (folder / "normal.png", folder / "normal.exr", folder / "material.json"):
        path.unlink()
    pixels = np.ascontiguousarray(pixels.numpy())
    named = {name: np.ascontiguousarray(pixels[..., k]) for name, k in channels.items()} or {"RGB": pixels}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, named).write(str(folder / "normal.exr"))
    return folder


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("stored, channels", [
    (lambda n: n, {}), (lambda n: (n + 1) / 2, {}), (lambda n: n, {"X": 0, "Y": 1, "Z": 2}),
    (lambda n: n, {"R": 0, "G": 1}), (lambda n: (n + 1) / 2, {"R": 0, "G": 1}),
    (lambda n: n * torch.tensor([1.0, 1.0, 0.0]), {})],
    ids=["signed", "half", "XYZ", "signed x and y", "x and y", "blue is 0"])
def test_normals_of_an_exr_are_the_vectors_it_stands_for(stored, channels, tmp_path):
    assert (load_maps(written(tmp_path, stored(bump()), **channels))["normal"] - bump()).abs().max() < 2e-6


@pytest.mark.parametrize("name, options, turned, said", [
    ("normal", {}, True, "are DirectX"), ("normal", {"normal": "gl"}, False, ""),
    ("normal", {"encoding": "normal=gl"}, False, ""), ("normal", {"normal": "dx"}, True, ""),
    ("normal_dx", {}, True, "turned around")])
def test_directx_is_found_and_overruled(name, options, turned, said, tmp_path):
    folder = written(tmp_path, (bump() * TURNED + 1) / 2)
    (folder / "normal.exr").rename(folder / f"{name}.exr")
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        found = load_maps(folder, **options)["normal"]
    assert (found - bump() * (1 if turned else TURNED)).abs().max() < 2e-6
    assert (said in " ".join(str(w.message) for w in seen)) if said else not seen


def test_a_field_that_fits_less_well_is_read_as_it_is_with_a_warning(tmp_path):
    """The slopes have noise: either sign leaves a curl, DirectX's the smaller one."""
    noise = torch.randn(SIDE, SIDE, 2, generator=torch.Generator().manual_seed(0))
    field = bump() * TURNED
    slopes = field[..., :2] / field[..., 2:] + 0.008 * noise
    field = torch.nn.functional.normalize(torch.cat((slopes, torch.ones(SIDE, SIDE, 1)), dim=-1), dim=-1)
    assert directx_by_curl(field) is None
    with pytest.warns(MapsWarning, match="may be DirectX's.*read as OpenGL's; --encoding normal=dx"):
        found = unit_normals((field + 1) / 2, tmp_path / "n.png")
    assert (found - field).abs().max() < 1e-6


def test_of_level_normals_the_sign_hardly_shows_and_nothing_is_said():
    noise = 0.002 * torch.randn(SIDE, SIDE, 2, generator=torch.Generator().manual_seed(0))
    level = torch.nn.functional.normalize(torch.cat((noise, torch.ones(SIDE, SIDE, 1)), dim=-1), dim=-1)
    assert directx_by_curl(level) is False
    assert directx_by_curl(torch.tensor([128, 128, 255]).expand(SIDE, SIDE, 3) / 127.5 - 1) is False


def test_the_curl_of_published_normals(data_folder):
    """None is called DirectX; turned around, most are, and only level ones are called OpenGL's."""
    found, turned, level = {}, {}, set()
    for path in sorted(data_folder.glob("materials/*/normal.png")) + sorted(
            data_folder.glob("one-photo/known/*/strip.png")) + sorted(
            data_folder.glob("captures/*/materialgan/normal.jpg")):
        image = images.read_image(path, RuntimeError)
        normal = torch.nn.functional.normalize(image[:, :image.shape[0]] * 2 - 1, dim=-1)
        found[path], turned[path] = directx_by_curl(normal), directx_by_curl(normal * TURNED)
        level |= {path} if normal[..., 1].abs().mean() < 1 / 255 else set()
    assert True not in found.values()
    assert {path for path, verdict in turned.items() if verdict is False} <= level
    assert sum(verdict is True for path, verdict in turned.items() if "captures" not in path.parts) >= 11
    files = data_folder / "files" / "4"
    for name, wanted in {"r_normal_map": False, "r_normal_map_reversed_y": True}.items():
        normal = images.read_image(files / f"{name}.png", RuntimeError) * 2 - 1
        assert directx_by_curl(torch.nn.functional.normalize(normal, dim=-1)) is wanted
