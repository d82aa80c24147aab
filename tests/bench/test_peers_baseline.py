"""The peers' baseline is plain Adam on clamped values, and goes on bit by bit."""

import pytest
import torch
from helpers import ANALYTIC, GRID, photos_of

from mitsvbrdf.bench.peers_baseline import PeersBaseline, PeersConfig
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import FitTask
from mitsvbrdf.material.made import make_material


def test_peers_baseline_is_plain_adam_on_clamped_gamma_values():
    views = GRID.pick([0, 2, 5])
    capture = photos_of(make_material("inlay", 8), views)
    method, config = PeersBaseline(FitTask(capture, ANALYTIC, PeersConfig())), PeersConfig()
    losses = [method.step(k / 6)["l2"] for k in range(6)]

    # The same by hand: gamma-encoded maps on [-1, 1], 9 channels in one tensor, and torch's Adam.
    start = torch.cat((torch.full((8, 8, 3), 0.0), torch.full((8, 8, 3), 2 * 0.04 - 1),
                       torch.full((8, 8, 1), 2 * 0.2 - 1), torch.zeros(8, 8, 2)), dim=-1)
    textures = start.clone().requires_grad_()
    adam, expected = torch.optim.Adam([textures], lr=0.01), []
    for _ in range(6):
        diffuse, specular, roughness = (((textures + 1) / 2) ** 2.2)[..., :7].split((3, 3, 1), dim=-1)
        x, y = textures[..., 7], textures[..., 8]
        normal = torch.stack((x, y, (1 - x**2 - y**2).sqrt()), dim=-1)
        maps = {"diffuse": diffuse, "specular": specular, "roughness": roughness, "normal": normal}
        rendered = ANALYTIC.render(type(make_material("inlay", 8))("roughconductor", maps), views)
        loss = ((rendered.clamp(1e-6, 1) ** (1 / 2.2) - capture.photos) ** 2).mean()
        expected.append(float(loss.detach()))
        adam.zero_grad()
        loss.backward()
        adam.step()
    assert config.iterations == 1000
    assert losses == pytest.approx(expected, rel=1e-5)  # measured: the same bits
    assert losses[-1] < 0.99 * losses[0]
    found = method.estimate()[0]
    # one step apart, 0.005 encoded; measured 0.0051
    assert float((found["diffuse"] - diffuse.detach()).abs().max()) < 0.01


def test_peers_baseline_goes_on_bit_by_bit_and_stays_in_range():
    capture = photos_of(make_material("tiles", 8))
    # large steps meet every bound
    method = PeersBaseline(FitTask(capture, ANALYTIC, PeersConfig(learning_rate=0.7)))
    for _ in range(5):
        method.step(0.0)
    state = method.state()
    after = [method.step(0.0)["l2"] for _ in range(2)]
    method.load_state(state)
    assert [method.step(0.0)["l2"] for _ in range(2)] == after
    method.estimate()[0].check()
    for name in ("diffuse", "specular", "roughness"):
        assert float(method.textures[name].detach().abs().max()) <= 1
    with pytest.raises(ConfigError, match="principled"):
        PeersConfig(bsdf="principled").check()
