"""Parameters, start and losses."""


import pytest
import torch
from helpers import photos_of

from mitsvbrdf.fit import losses
from mitsvbrdf.fit.parameters import STREAMS, to_raw, to_svbrdf
from mitsvbrdf.fit.start import robust_start
from mitsvbrdf.material.maps import CHANNELS, flat


@pytest.mark.parametrize("bsdf", CHANNELS)
def test_parameters_invert_and_stay_in_range(bsdf):
    material = flat(8, bsdf, roughness=0.3)
    back = to_svbrdf(bsdf, to_raw(material))
    for name in material.maps:
        assert torch.allclose(back[name], material[name], atol=2.5e-3), name  # 0 metallic is cut to 0.002
    wild = {name: 100 * torch.randn(c, 8, 8) for name, c in (STREAMS[bsdf][0] | STREAMS[bsdf][1]).items()}
    to_svbrdf(bsdf, wild).check()


def test_start_finds_a_uniform_material():
    # Every texel alike and flat: the search has to find roughness (on its grid) and specular level, the guess
    # the rest.
    truth = flat(24, diffuse=0.3, specular=0.2, roughness=0.35)
    start = robust_start(photos_of(truth), truth["diffuse"], "roughconductor")
    assert start["roughness"].mean().item() == pytest.approx(0.35)
    assert start["specular"].mean().item() == pytest.approx(0.2, abs=0.01)


def test_clipped_pixels_only_ask_for_at_least_their_value():
    photo = torch.tensor([1.0, 1.0, 0.5]).reshape(1, 1, 1, 3)
    rendered = torch.tensor([4.0, 0.5**2.2, 0.5**2.2]).reshape(1, 1, 1, 3).requires_grad_()
    loss = losses.photometric(rendered, photo, "gamma2.2")
    # only the second pixel is off, by 0.5
    assert loss.item() == pytest.approx((0.5 + 5 * 0.5**2) / 3, abs=1e-5)
    (gradient,) = torch.autograd.grad(loss, rendered)
    assert gradient.flatten()[0] == 0 and gradient.flatten()[1] < 0
