"""Which texels look alike."""

import pytest
import torch
from helpers import ANALYTIC, GRID, photos_of

from mitsvbrdf import color
from mitsvbrdf.capture import Capture
from mitsvbrdf.fit.hierarchical.sharing import appearance_of, basis_materials, membership
from mitsvbrdf.material.maps import flat
from mitsvbrdf.views import Views, nine_view_grid


def test_a_patch_of_two_colours_splits_in_two():
    left = (torch.arange(16) < 8).float()[None, :, None].expand(16, 16, 1)
    material = flat(16, specular=0.04, roughness=0.4)
    material.maps["diffuse"] = (left * torch.tensor([0.5, 0.2, 0.1])
                                + (1 - left) * torch.tensor([0.1, 0.25, 0.45]))
    seen = appearance_of(photos_of(material, noise=0.002), material["diffuse"])
    assert seen.shape == (256, 5) and float(seen.min()) > -0.3 and float(seen.max()) < 0.6
    for count in (2, 5):
        centres = basis_materials(seen, count, 0)
        assert centres.shape == (count, 5)
        member = membership(seen, centres, 0.02)
        assert torch.allclose(member.sum(dim=1), torch.ones(256), atol=1e-5)
        of_left, of_right = (member[left.flatten() == side].sum(dim=0) for side in (1, 0))
        assert float((of_left * of_right).sum().sqrt()) < 1e-3 * 128  # no basis material is of both
    assert torch.equal(basis_materials(seen[:1], 64, 0), seen[:1])  # one texel
    # Kernels far wider than looks are apart: all alike.
    assert torch.allclose(membership(seen, basis_materials(seen, 2, 0), 100.0), torch.full((256, 2), 0.5),
                          atol=1e-3)


def test_looks_do_not_depend_on_the_light():
    # A matt patch looks the same from wherever it is lit, at any power and with either falloff; and
    # brightness shows.
    grey = flat(8, diffuse=0.3, specular=0.0, roughness=1.0)
    near, far = nine_view_grid(1.5), nine_view_grid(4.0, 0.8)
    for views in (near, far, Views.of(near.camera, intensity=near.intensity / 3),
                  Views.of(near.camera * 7, None, near.intensity * 49, 7.0),
                  Views.of(near.camera, intensity=near.intensity, falloff="none")):
        photos = color.to_display(ANALYTIC.render(grey, views))
        seen = appearance_of(Capture(photos, views), grey["diffuse"])
        level = float(color.encode(torch.tensor(0.3)))
        wanted = torch.tensor([0.0, 0.0, 0.0, level / 2, level / 2]).expand(64, 5)
        assert torch.allclose(seen, wanted, atol=2e-3), (seen - wanted).abs().max()


@pytest.mark.parametrize("photos", [torch.zeros(9, 4, 4, 3), torch.ones(1, 4, 4, 3), torch.zeros(1, 4, 4, 3)])
def test_looks_of_photos_that_show_nothing(photos):
    seen = appearance_of(Capture(photos, GRID.pick(range(len(photos)))), torch.zeros(4, 4, 3))
    member = membership(seen, basis_materials(seen, 64, 0), 0.02)
    assert torch.isfinite(member).all() and torch.allclose(member.sum(dim=1), torch.ones(16), atol=1e-5)


def test_groups_depend_on_the_seed_and_on_nothing_else():
    random = torch.Generator().manual_seed(1)
    seen = torch.rand(400, 5, generator=random)
    first = basis_materials(seen, 20, 3)
    basis_materials(torch.rand(50, 5, generator=random), 7, 1)
    torch.rand(5)
    assert torch.equal(basis_materials(seen, 20, 3), first) and not torch.equal(basis_materials(seen, 20, 4),
                                                                                first)
    # The order of the texels changes which ones k-means starts from, not how well it does: within 10 % in
    # mean distance.
    turned = basis_materials(seen.flip(0), 20, 3)
    spread = [float(torch.cdist(seen, centres).amin(dim=1).mean()) for centres in (first, turned)]
    assert spread[0] == pytest.approx(spread[1], rel=0.1)
    assert torch.equal(membership(seen, first, 0.1).flip(0), membership(seen.flip(0), first, 0.1))


def test_looks_do_not_depend_on_the_order_of_photos():
    capture = photos_of(flat(8, diffuse=0.3), noise=0.01)
    order = [4, 2, 8, 0, 1, 7, 6, 5, 3]
    guess = torch.full((8, 8, 3), 0.3)
    # Sums of the same numbers in another order, in float32.
    assert torch.allclose(appearance_of(capture, guess), appearance_of(capture.pick(order), guess), atol=1e-6)
