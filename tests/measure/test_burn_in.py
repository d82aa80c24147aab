"""Burn-in against closed forms, maps of known share and a published map."""

import json
import math

import numpy as np
import pytest
import torch
from helpers import GRID

from mitsvbrdf import cli
from mitsvbrdf.capture import read_capture
from mitsvbrdf.fit.result import Fit
from mitsvbrdf.material.made import MATERIALS, make_material
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.measure.burn_in import burn_in, explained_share, local_burn_in
from mitsvbrdf.views import Views, coverage_angle, half_angles, nine_view_grid


def test_angle_is_that_of_the_nearest_half_vector():
    # In the unit of the views, with light and camera apart; by arc cosines, photo by photo.
    generator = np.random.default_rng(0)
    camera, light = (generator.uniform((-1, -1, 3), (1, 1, 6), (5, 3)) for _ in range(2))
    angle = coverage_angle(Views.of(camera, light, size=2.0), 8)
    for row, column in ((0, 0), (3, 6), (7, 2)):
        point = np.array([((column + 0.5) / 8 - 0.5) * 2, (0.5 - (row + 0.5) / 8) * 2, 0])
        wanted = math.inf
        for eye, lamp in zip(camera, light):
            h = (eye - point) / np.linalg.norm(eye - point) + (lamp - point) / np.linalg.norm(lamp - point)
            wanted = min(wanted, math.acos(h[2] / np.linalg.norm(h)))
        assert float(angle[row, column]) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("shape, wanted", [(lambda x: 3 - 2 * x + x**3, 1.0),
    # Legendre series of |x|: (5/2) (1/4)^2 of the variance 1/6 are in P2, none in P1 and P3
    (lambda x: x.abs(), 15 / 16),
    # of x^4 what P4, 8/35 of it, leaves out; any scale
    (lambda x: (5 * x**4 - 1) / 4, 1 - (128 / 11025) / (32 / 225)),
])
def test_share_of_a_curve(shape, wanted):
    # 20,000 midpoints in place of the integrals: an error of their square.
    x = (torch.arange(20000, dtype=torch.float64) + 0.5) / 10000 - 1
    assert explained_share(shape(x), x) == pytest.approx(wanted, abs=1e-7)
    assert explained_share(shape(x).reshape(100, 200), 1e-3 * x.reshape(100, 200)
                           + 0.3) == pytest.approx(wanted, abs=1e-7)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.9])
@pytest.mark.parametrize("name", ["roughness", "specular"])
def test_maps_of_a_known_share(name, share):
    # A cubic of the angle plus noise without any cubic in it; float32 maps and the encoding of specular leave
    # 1e-6.
    angle = coverage_angle(GRID, 64).flatten()
    powers = torch.stack([angle**k for k in range(4)], dim=1)
    noise = torch.randn(64 * 64, 1, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    noise = noise - powers @ torch.linalg.lstsq(powers, noise).solution
    burnt = (powers @ torch.tensor([[0.0], [1.0], [-3.0], [20.0]], dtype=torch.float64)) if share else noise
    mixed = (math.sqrt(share) * (burnt - burnt.mean()) / burnt.std()
             + math.sqrt(1 - share) * noise / noise.std())
    shown = (0.4 + 0.04 * mixed).reshape(64, 64, 1)
    maps = dict(flat(64).maps) | {name: (shown**2.2).expand(64, 64, 3) if name == "specular" else shown}
    found = burn_in(SVBRDF("roughconductor", maps).to(torch.float32), GRID)
    assert found == pytest.approx({"specular": 0, "roughness": 0} | {name: share}, abs=1e-5)


def test_constant_maps_and_angles_have_none():
    none = {"specular": 0.0, "roughness": 0.0}
    constant = flat(32, roughness=0.3, specular=0.07)
    assert burn_in(constant, GRID) == local_burn_in(constant, GRID) == none
    assert burn_in(flat(32, "principled", base_color=0.3, metallic=0.7), GRID) == none
    assert explained_share(torch.rand(9, 9), torch.full((9, 9), 0.2)) == pytest.approx(0, abs=1e-12)


def roughness_of(values):
    """A material of this roughness, scaled to 0.12 +- 0.01, and else flat."""
    values = 0.12 + 0.01 * (values - values.mean()) / values.std()
    return SVBRDF("roughconductor", dict(flat(len(values)).maps) | {"roughness": values[..., None].float()})


def lit_from(turn):
    """Three views around the patch."""
    angle = torch.tensor([0.0, 2 * math.pi / 3, 4 * math.pi / 3], dtype=torch.float64) + turn
    return Views.of(torch.stack((0.35 * angle.cos(), 0.35 * angle.sin(), torch.full_like(angle, 2.0)), dim=1))


def test_ovals_are_found_where_they_are():
    views, noise = lit_from(0.0), torch.randn(64, 64, generator=torch.Generator().manual_seed(3),
                                              dtype=torch.float64)
    ovals = torch.exp(-(torch.tan(half_angles(views, 64)) / 0.06).square() / 2).sum(dim=0)
    # a sum of the bumps
    assert local_burn_in(roughness_of(ovals), views)["roughness"] == pytest.approx(1, abs=1e-3)
    # A quarter of the variance, the rest noise; seen from there, and from where no photo was taken.
    mixed = roughness_of(0.5 * (ovals - ovals.mean()) / ovals.std() + 0.75**0.5 * noise)
    there, elsewhere = (local_burn_in(mixed, lit_from(turn))["roughness"] for turn in (0.0, math.pi / 3))
    # Measured: 0.19, since elsewhere the same bumps explain some of it too, and 0.04.
    assert 0.15 < there < 0.25 and abs(elsewhere) < 0.08
    assert abs(local_burn_in(roughness_of(noise), views)["roughness"]) < 0.02


@pytest.mark.parametrize("name", MATERIALS)
def test_true_maps_hold_no_ovals(name):
    # Measured with these and five captures' views, ten materials: -0.03 to 0.13.
    assert all(abs(share) < 0.2 for share in local_burn_in(make_material(name, 64),
                                                           nine_view_grid()).values())


@pytest.mark.parametrize("name, wanted, ovals", [
    ("wood-bamboo", 0.670, 0.297), ("cards-blue", 0.015, -0.003), ("bathroomtile1", 0.013, -0.018)])
def test_published_maps(name, wanted, ovals, data_folder):
    # MaterialGAN's roughness as its files store it, at 128 px: 0.6697, 0.0146, 0.0132.
    folder = data_folder / "captures" / name
    published, views = (load_maps(folder / "materialgan", encoding="linear"),
                        read_capture(folder, resolution=16).views)
    assert burn_in(published.resized(128), views)["roughness"] == pytest.approx(wanted, abs=1e-3)
    assert local_burn_in(published, views)["roughness"] == pytest.approx(ovals, abs=2e-3)


def test_evaluate_looks_at_the_photos_of_the_fit(tmp_path):
    shots, out, figures = (str(tmp_path / name) for name in ("shots", "out", "e.json"))
    assert cli.main(["synth", "builtin:inlay", "-o", shots, "--resolution", "32"]) == 0
    fast = ["--method", "direct", "--renderer", "analytic", "--iterations", "20", "--resolution", "32"]
    assert cli.main(["fit", shots, "-o", out, *fast, "--views", "0,1,3,8"]) == 0
    record = json.loads((tmp_path / "out/fit.json").read_text())["burn_in"]
    assert set(record) == {"specular", "roughness"} and record["roughness"] > 1e-3
    assert torch.equal(Fit.of_maps(out).views.camera,
                       read_capture(tmp_path / "shots").views.camera[[0, 1, 3, 8]])
    arguments = ["--capture", shots, "--views", "4,7", "--renderer", "analytic", "--json", figures]
    assert cli.main(["evaluate", out, *arguments]) == 0
    # From the files: EXR keeps the maps' float32.
    assert json.loads((tmp_path / "e.json").read_text())["burn_in"] == pytest.approx(record, rel=1e-4)
    (tmp_path / "out/fit.json").unlink()
    assert cli.main(["evaluate", out, *arguments, "--overwrite"]) == 0
    found = json.loads((tmp_path / "e.json").read_text())["burn_in"]
    assert found == burn_in(load_maps(out), read_capture(tmp_path / "shots").views.pick([4, 7]))
    assert found["roughness"] != pytest.approx(record["roughness"], rel=1e-2)
