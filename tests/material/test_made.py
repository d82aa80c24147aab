"""Made materials: the same for the same seed, in range, and the same structure at every resolution."""

import pytest
import torch

from mitsvbrdf.errors import ConfigError
from mitsvbrdf.material.made import MATERIALS, make_material

NAMES = list(MATERIALS)
pytestmark = pytest.mark.usefixtures("painted_anew")


@pytest.mark.parametrize("name", NAMES)
def test_the_seed_decides(name):
    first, again, other = make_material(name, 32, 3), make_material(name, 32, 3), make_material(name, 32, 4)
    assert all(torch.equal(first[m], again[m]) for m in first.maps)
    assert not torch.equal(first["diffuse"], other["diffuse"])
    assert not torch.equal(first["normal"], other["normal"])


@pytest.mark.parametrize("resolution, seed", [(2, 0), (33, 7), (128, 1)])
@pytest.mark.parametrize("name", NAMES)
def test_values_are_in_range(name, resolution, seed):
    made = make_material(name, resolution, seed).check()
    assert made.bsdf == "roughconductor" and made.resolution == resolution
    assert all(value.dtype == torch.float32 for value in made.maps.values())
    # 1e-6: area averages of float32 values at a bound.
    for map_name, low, high in (("diffuse", 0, 0.95), ("specular", 0.02, 0.95), ("roughness", 0.08, 1)):
        assert made[map_name].min() >= low - 1e-6 and made[map_name].max() <= high + 1e-6
    assert (made["diffuse"] + made["specular"]).max() <= 1 + 1e-6
    assert (made["normal"].norm(dim=-1) - 1).abs().max() < 1e-6
    assert made["normal"][..., 2].min() > 0.86  # cos 30.7 degrees: no bevel is steeper than 30


@pytest.mark.parametrize("name", NAMES)
def test_the_structure_does_not_depend_on_the_resolution(name):
    large, small = make_material(name, 256).resized(64), make_material(name, 64)
    for map_name in small.maps:
        a, b = large[map_name].flatten(), small[map_name].flatten()
        if b.std() > 1e-3:
            assert torch.corrcoef(torch.stack((a, b)))[0, 1] > 0.99
        assert (a - b).abs().mean() < 0.01


def test_the_inlay_has_parts_of_different_kinds():
    inlay = make_material("inlay", 128)
    gold, wood, glaze = (84, 65), (20, 40), (100, 107)  # (row, column): star, ground, medallion
    assert inlay["specular"][gold][0] > 0.8 > 0.5 > inlay["specular"][gold][2]
    assert inlay["specular"][wood].max() < 0.06 and inlay["roughness"][wood] > 0.5
    assert inlay["roughness"][glaze] < 0.2 and inlay["diffuse"][glaze].max() > 0.6
    assert 25 < torch.rad2deg(torch.acos(inlay["normal"][..., 2].clamp(max=1))).max() < 30.5


def test_mistakes_are_named():
    with pytest.raises(ConfigError, match="inlay"):
        make_material("marble")
    with pytest.raises(ConfigError, match="2 or more"):
        make_material("inlay", 1)


@pytest.mark.parametrize("name", NAMES)
def test_a_material_made_in_strips_is_the_whole_bit_by_bit(name, monkeypatch):
    whole = make_material(name, 48, 5)
    monkeypatch.setattr("mitsvbrdf.views.STRIP", 48 * 7)
    strips = make_material(name, 48, 5)
    assert all(torch.equal(whole[m], strips[m]) for m in whole.maps)
