"""The networks have the papers' layers."""

import pytest
import torch
from helpers import ANALYTIC, GRID

from mitsvbrdf import color
from mitsvbrdf.capture import Capture
from mitsvbrdf.fit import FitTask, GanConfig, make_method
from mitsvbrdf.fit.generator.networks import AllPhotosGenerator, PatchDiscriminator, TwoStreamGenerator
from mitsvbrdf.material.made import make_material


def test_input_and_rendering_of_the_gan_show_the_same_blend():
    # Were the generator right, its picture would be the input itself, for one photo and for blends of two.
    truth, views = make_material("inlay", 16), GRID
    photos = color.to_display(ANALYTIC.render(truth, views))
    gan = make_method(FitTask(Capture(photos, views), ANALYTIC, GanConfig(width=8), truth["diffuse"]))
    seen = set()
    for _ in range(20):
        photo, picked, weights = gan._draw_input()
        seen.add(len(picked))
        assert torch.allclose(gan._picture(truth, picked, weights), photo, atol=1e-4)
    assert seen == {1, 2}


def test_networks_have_the_papers_layers():
    def layers(module, kind):
        return sum(isinstance(m, kind) for m in module.modules())

    g = TwoStreamGenerator(width=8)
    assert layers(g.encoder, torch.nn.Conv2d) == 5
    assert (layers(g.normal_roughness, torch.nn.Conv2d), layers(g.normal_roughness, torch.nn.ConvTranspose2d)) == (1, 3)
    assert (layers(g.diffuse_specular, torch.nn.Conv2d), layers(g.diffuse_specular, torch.nn.ConvTranspose2d)) == (0, 3)
    assert layers(PatchDiscriminator(8), torch.nn.Conv2d) == 5
    assert g.encode(torch.rand(1, 3, 64, 64)).shape[-1] == 8
    probability = PatchDiscriminator(8)(torch.rand(1, 3, 64, 64))
    assert probability.shape[1] == 1 and probability.shape[2] > 1 and 0 < probability.min() and probability.max() < 1


def test_group_norm_with_one_channel_a_group_is_instance_norm():
    x = torch.randn(2, 6, 9, 9)
    assert torch.allclose(torch.nn.GroupNorm(6, 6)(x), torch.nn.InstanceNorm2d(6)(x), atol=1e-5)


@pytest.mark.parametrize("side", [8, 17, 40])
def test_any_size_comes_out_as_it_went_in(side):
    maps = TwoStreamGenerator(width=8)(torch.rand(1, 3, side, side))
    assert maps["normal"].shape == (2, side, side) and maps["diffuse"].shape == (3, side, side)
    changes = AllPhotosGenerator(5, width=8)(torch.rand(1, 5, side, side))
    assert changes["roughness"].shape == (1, side, side) and changes["roughness"].abs().max() == 0
