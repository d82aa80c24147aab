"""What texels tell each other, against closed forms and a float64 twin."""

import math

import numpy as np
import pytest
import torch

from mitsvbrdf import color
from mitsvbrdf.fit.hierarchical import sharing
from mitsvbrdf.fit.hierarchical.sharing import COMMON, FARTHEST, LEAST_SPREAD, ROUNDS, TYPICAL, Shared, shared

# 50 texels each of two basis materials
TWO = torch.tensor([[1.0, 0.0], [0.0, 1.0]]).repeat_interleave(50, dim=0)
FIRST, SECOND = slice(0, 50), slice(50, 100)


def told(alone, sure, member=TWO, spread=0.1, prior=(0.5, 100.0), name="roughness", photos=0):
    """Texels whose photos alone say ``alone`` with precision ``sure``, under a prior (mean, precision)."""
    alone, sure = (torch.as_tensor(v, dtype=torch.float32).expand(len(member)) for v in (alone, sure))
    mean, precision = (torch.full_like(alone, p) for p in prior)
    total = sure + precision
    x = (sure * alone + precision * mean) / total
    found = shared([name], x[None], 1 / total[None], mean[None], precision[None],
                   lambda: member.split(sharing.STRIP), torch.tensor([spread]), photos)
    return Shared(found.mean[0], found.tau[0], float(found.spread[0]))


def twin(alone, sure, member, tau2):
    """The same by numpy in float64, from the definition: means, tau of each texel, and over all."""
    alone, sure, member = (np.asarray(v, dtype=np.float64) for v in (alone, sure, member))
    share, tau2 = member / member.sum(axis=0), np.full(len(sure), tau2)
    for _ in range(ROUNDS):
        weight = 1 / (1 / sure + tau2)
        materials = (member * (weight * alone)[:, None]).sum(axis=0) / (member * weight[:, None]).sum(axis=0)
        mean = member @ materials
        # Of y ~ N(z, 1 / sure), z ~ N(mean, tau2): expectation and variance of z, and their mean square
        # around the mean.
        variance = tau2 / (1 + sure * tau2)
        expected = mean + sure * tau2 / (1 + sure * tau2) * (alone - mean)
        square = (expected - mean) ** 2 + variance
        own, count = share.T @ square, member.sum(axis=0)  # of each basis material, drawn to what all have
        tau2 = member @ (own + (square.mean() - own) * COMMON / (COMMON + count))
    return mean, np.sqrt(tau2), math.sqrt(square.mean())


def test_two_groups_of_equal_noise_in_closed_form():
    # Values a +- d measured with standard deviation s: the mean is a, and tau^2 = d^2 - s^2 is where
    # maximisation stays.
    d, s = 0.05, 0.03
    signs = torch.tensor([1.0, -1.0]).repeat(50)
    levels = torch.cat((torch.full((50,), 0.45), torch.full((50,), 0.55)))
    mean, _, spread = told(levels + d * signs, s**-2, spread=math.sqrt(d**2 - s**2))
    assert torch.allclose(mean, levels, atol=1e-5)  # all share one part in a million
    assert spread == pytest.approx(math.sqrt(d**2 - s**2), rel=1e-3)
    # From elsewhere it gets there, by a factor of d^2 - tau^2 - s^2 each time.
    assert told(levels + d * signs, s**-2, spread=0.2).spread == pytest.approx(math.sqrt(d**2 - s**2),
                                                                               rel=0.1)


def test_unequal_noise_and_soft_groups_as_the_twin():
    random = torch.Generator().manual_seed(0)
    alone = 0.5 + 0.04 * torch.randn(100, generator=random)
    alone[SECOND] = 0.5 + (alone[SECOND] - 0.5) / 4  # each group has a spread of its own
    sure = 10 ** (1 + 3 * torch.rand(100, generator=random))
    for member in (TWO, torch.softmax(torch.randn(100, 3, generator=random), dim=1)):
        mean, own, spread = told(alone, sure, member, spread=0.05)
        wanted, taus, tau = twin(alone, sure, member, 0.05**2)
        # Dividing the prior out again costs float32 four digits where the photos say ten times less than it.
        assert np.allclose(mean, wanted, atol=1e-5) and spread == pytest.approx(tau, rel=1e-4)
        assert np.allclose(own, taus, rtol=1e-4)


def test_the_prior_itself_is_no_evidence():
    # Texels that photos tell nothing have the posterior of their prior, 0.5. Few of their group that know
    # outweigh them.
    sure = torch.zeros(100)
    sure[:5] = 1e4
    mean, *_ = told(torch.full((100,), 0.4), sure, prior=(0.5, 400.0))
    # 45 texels count 1e-3 each, five 100 each
    assert torch.allclose(mean[FIRST], torch.full((50,), 0.4), atol=2e-3)
    # a group without any stays where it was
    assert torch.allclose(mean[SECOND], torch.full((50,), 0.5), atol=1e-3)


def test_limits():
    assert told(0.5, 1e6, spread=0.02).spread == pytest.approx(LEAST_SPREAD)
    mean, *_ = told(0.9, 1e4, prior=(0.5, 100.0))  # further off its prior than evidence may count
    assert torch.allclose(mean, torch.full((100,), 0.5 + FARTHEST), atol=1e-5)
    mean, *_ = told(0.99, 1e4, prior=(0.95, 100.0))
    assert mean.max() <= 1


def test_what_is_typical_decides_where_nothing_is_known():
    usual, _ = TYPICAL["specular"]
    assert color.decode(torch.tensor(usual)).item() == pytest.approx(0.04, rel=1e-4)
    unknown = told(0.5, 0.0, name="specular", photos=9).mean
    assert torch.allclose(unknown, torch.full((100,), usual), atol=2e-3)
    # roughness has no usual
    assert torch.allclose(told(0.5, 0.0, photos=9).mean, torch.full((100,), 0.5), atol=1e-5)
    # One group is known to be usual, the other not known at all.
    sure = torch.cat((torch.full((50,), 1e5), torch.zeros(50)))
    mean, *_ = told(usual, sure, prior=(0.3, 50.0), name="specular", photos=9)
    assert torch.allclose(mean, torch.full((100,), usual), atol=2e-3)


def test_what_is_typical_weighs_as_much_as_the_texels_that_one_photo_stands_for():
    usual, rare = TYPICAL["specular"]
    for photos, count in ((9, 50 / 9), (25, 2.0), (80, 1.0)):
        mean, tau, _ = told(0.4, 400.0, name="specular", photos=photos, prior=(0.4, 100.0))
        worth, held = 50 / (1 / 400 + float(tau[0]) ** 2), count / rare**2
        # tau is still on its way when the mean is taken: measured 2e-4 apart.
        assert float(mean[0]) == pytest.approx((worth * 0.4 + held * usual) / (worth + held), abs=1e-3)


def test_parts_tell_what_the_whole_tells(monkeypatch):
    random = torch.Generator().manual_seed(0)
    alone, member = torch.rand(100, generator=random), torch.rand(100, 3, generator=random)
    sure, member = 400 * torch.rand(100, generator=random), member / member.sum(dim=1, keepdim=True)
    whole = told(alone, sure, member, photos=9, name="specular")
    monkeypatch.setattr(sharing, "STRIP", 30)
    for one, other in zip(whole, told(alone, sure, member, photos=9, name="specular")):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)  # sums in another order
