"""Edges that meet: on what is seamless, what repeats, and what does neither."""

import pytest
import torch

from mitsvbrdf.errors import MapsError
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.material.tiling import seam, seamless
from mitsvbrdf.testing import random_material


def jump(value):
    """Mean difference over the edges, over that of neighbours inside."""
    across = (value[0] - value[-1]).abs().mean() + (value[:, 0] - value[:, -1]).abs().mean()
    inside = (value[1:] - value[:-1]).abs().mean() + (value[:, 1:] - value[:, :-1]).abs().mean()
    return float(across / inside)


def cropped(material, rows, columns):
    return material.map(lambda value: value[rows, columns].contiguous())


def test_what_is_seamless_stays_as_it_is():
    for made in (make_material("tiles", 256), flat(32, diffuse=0.5)):
        found, part = seamless(made)
        assert found is made and part == 1


def test_a_seam_in_one_map_is_no_seamless_material():
    """The wood of the inlay ends in other wood; its normals are far rougher than that, and meet."""
    made = make_material("inlay", 128)
    assert jump(made["diffuse"]) > 1.5 and jump(made["normal"]) < 1
    found, part = seamless(made)
    assert part < 1 and seam(made) > 2 and seam(found) < 1.5  # measured 2.9 and 1.2


def test_a_seam_counts_beside_its_neighbours():
    """A ramp of 64 steps jumps by 63 of them where it begins again."""
    ramp = torch.linspace(0.2, 0.8, 64)[:, None, None].expand(64, 64, 1)
    found = flat(64)
    assert seam(found) == 0
    assert seam(SVBRDF(found.bsdf, dict(found.maps) | {"roughness": ramp})) == pytest.approx(63, rel=1e-4)


def test_too_few_texels_are_refused():
    with pytest.raises(MapsError, match="16 texels a side or more"):
        seamless(random_material("principled", 8))


@pytest.mark.parametrize("name", ["plates", "inlay"])
def test_edges_meet_afterwards(name):
    made = cropped(make_material(name, 96), slice(3, 83), slice(7, 87))
    found, part = seamless(made)
    assert found.check().resolution == 80 and 0.5 <= part < 0.9
    for key in ("diffuse", "roughness"):
        assert jump(made[key]) > 2 and jump(found[key]) < 1.6, key  # measured 2.4 to 6.8, and 0.5 to 1.2


def test_tiles_end_where_they_began():
    """Five by five tiles, cut amid one: the overlap that leaves whole tiles differs least."""
    # 4 tiles a side, of 32 texels
    _, part = seamless(cropped(make_material("tiles", 160), slice(10, 138), slice(20, 148)))
    # half a step of the overlaps tried
    assert 128 * part / 32 == pytest.approx(round(128 * part / 32), abs=0.07)


def test_all_maps_are_cut_alike():
    """Where all maps are the same picture, they still are afterwards."""
    made = random_material("roughconductor", 32)
    same = type(made)("roughconductor", dict(made.maps) | {"specular": made["diffuse"]})
    found, _ = seamless(same)
    assert torch.equal(found["specular"], found["diffuse"])
