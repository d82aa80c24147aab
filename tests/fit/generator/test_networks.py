"""The networks have the papers' layers."""

from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, GRID

from mitsvbrdf import color
from mitsvbrdf.capture import Capture
from mitsvbrdf.fit.generator.networks import AllPhotosGenerator, PatchDiscriminator, TwoStreamGenerator
from mitsvbrdf.fit.generator.pictures import PictureSource, seen_through
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF


def test_input_and_rendering_of_the_gan_show_the_same_blend():
    # Were the generator right, its picture would be the input itself, for one photo and for blends of two.
    truth, views = make_material("inlay", 16), GRID
    photos = color.to_display(ANALYTIC.render(truth, views))
    random, seen = torch.Generator().manual_seed(0), set()
    source = PictureSource(Capture(photos, views))
    for _ in range(20):
        pictures = source.draw(2, random)
        seen |= {int((row > 0).sum()) for row in pictures.weights}
        assert torch.allclose(pictures.of(ANALYTIC.render(truth, views.pick(pictures.index))),
                              pictures.shown, atol=1e-4)
    assert seen == {1, 2}


@pytest.mark.parametrize("falloff", ["inverse-square", "none"])
def test_a_crop_is_lit_as_the_whole_is(falloff):
    # What is rendered of a crop's texels under the views moved to it is the crop of what is rendered of the
    # whole.
    truth, views = make_material("inlay", 32), replace(GRID, size=1.0, falloff=falloff)
    photos = color.to_display(ANALYTIC.render(truth, views))
    source = PictureSource(Capture(photos, views), crop=16)
    random = torch.Generator().manual_seed(0)
    for _ in range(5):
        pictures = source.draw(2, random)
        part = SVBRDF(truth.bsdf, {k: v[pictures.window] for k, v in truth.maps.items()})
        assert part.resolution == 16
        lit = seen_through(pictures.window, views, 32).pick(pictures.index)
        assert torch.allclose(pictures.of(ANALYTIC.render(part, lit)), pictures.shown, atol=1e-4)


def test_networks_have_the_papers_layers():
    def layers(module, kind):
        return sum(isinstance(m, kind) for m in module.modules())

    g = TwoStreamGenerator(width=8)
    assert layers(g.encoder, torch.nn.Conv2d) == 5
    assert (layers(g.normal_roughness, torch.nn.Conv2d),
            layers(g.normal_roughness, torch.nn.ConvTranspose2d)) == (1, 3)
    assert (layers(g.diffuse_specular, torch.nn.Conv2d),
            layers(g.diffuse_specular, torch.nn.ConvTranspose2d)) == (0, 3)
    assert layers(PatchDiscriminator(8), torch.nn.Conv2d) == 5
    assert g.encode(torch.rand(1, 3, 64, 64)).shape[-1] == 8
    logits = PatchDiscriminator(8).activations(torch.rand(1, 3, 64, 64))[-1]
    assert logits.shape[1] == 1 and logits.shape[2] > 1


@pytest.mark.parametrize("side", [8, 17, 40])
def test_any_size_comes_out_as_it_went_in(side):
    generator = TwoStreamGenerator(width=8)
    code = generator.encode(torch.rand(1, 3, side, side))
    maps = generator.decode(0, code, side) | generator.decode(1, code, side)
    assert maps["normal"].shape == (2, side, side) and maps["diffuse"].shape == (3, side, side)
    changes = AllPhotosGenerator(5, width=8)(torch.rand(1, 5, side, side))
    assert changes["roughness"].shape == (1, side, side) and changes["roughness"].abs().max() == 0
