"""The variational generator, against torch's own distributions and under other orders of the photos."""

import torch
from helpers import GRID, photos_of
from torch.distributions import Normal, kl_divergence

from mitsvbrdf.capture import guess_diffuse
from mitsvbrdf.fit.generator.variational import (
    VariationalGenerator,
    condition_of,
    divergence,
    product_of_experts,
)
from mitsvbrdf.fit.parameters import STREAMS
from mitsvbrdf.material.made import make_material


def trained_looking(width=4):
    torch.manual_seed(0)
    return VariationalGenerator(STREAMS["roughconductor"], width, change=False)


def test_a_product_of_experts_is_the_product_of_their_densities():
    # On a grid, the densities multiplied and normed: no formula of normal distributions.
    means, logs = torch.tensor([0.7, -1.2, 2.0]).double(), torch.tensor([0.3, -0.9, 1.1]).double()
    x = torch.linspace(-12, 12, 40001, dtype=torch.float64)
    density = Normal(0.0, 1.0).log_prob(x)
    for mean, log in zip(means, logs):
        density = density + Normal(mean, (log / 2).exp()).log_prob(x)
    density = torch.softmax(density, dim=0)
    mean = (density * x).sum()
    variance = (density * (x - mean) ** 2).sum()
    found = product_of_experts(means[:, None], logs[:, None])
    assert torch.allclose(torch.cat(found)[:, 0], torch.stack((mean, variance)), atol=1e-6)


def test_the_divergence_is_torchs():
    mean, variance = torch.randn(4, 5), torch.rand(4, 5) + 0.1
    theirs = kl_divergence(Normal(mean, variance.sqrt()), Normal(0.0, 1.0)).mean()
    assert torch.allclose(divergence(mean, variance), theirs, atol=1e-6)


def test_any_number_of_photos_in_any_order():
    shots = photos_of(make_material("inlay", 32))
    guess, generator = guess_diffuse(shots, "min"), trained_looking()
    orders = ([0, 1, 2, 3, 4, 5, 6, 7, 8], [8, 2, 5, 0, 7, 1, 3, 6, 4], [4], [4, 7])
    with torch.no_grad():
        one, other, single, two = (generator(condition_of(shots.pick(order), guess)) for order in orders)
    for name, value in one.items():
        # float32 sums in another order; instance norms of a coarse level enlarge the difference
        assert torch.allclose(value, other[name], atol=1e-4)
        assert value.shape == single[name].shape == two[name].shape and not torch.allclose(single[name],
                                                                                           two[name], atol=1e-3)


def test_codes_are_drawn_in_training_and_their_mean_makes_the_result():
    shots = photos_of(make_material("inlay", 32), GRID.pick([0, 1]))
    condition, generator = condition_of(shots, guess_diffuse(shots, "min")), trained_looking()
    with torch.no_grad():
        drawn = [generator(condition, torch.Generator().manual_seed(seed))["diffuse"] for seed in (0, 0, 1)]
        mean = [generator(condition)["diffuse"] for _ in range(2)]
    assert torch.equal(drawn[0], drawn[1]) and not torch.allclose(drawn[0], drawn[2], atol=1e-3)
    assert torch.equal(*mean) and float(generator.divergence) > 0


def test_it_begins_at_the_start():
    shots = photos_of(make_material("inlay", 16))
    generator = VariationalGenerator(STREAMS["roughconductor"], 4)
    assert all(value.abs().max() == 0 for value in generator(condition_of(shots,
                                                                          guess_diffuse(shots, "min"))).values())
