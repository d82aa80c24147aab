"""Patches are those that one would cut out by hand, and their sliced distance is the closed form of shifts
and scales.
"""

import math

import pytest
import torch

from mitsvbrdf.errors import MapsError
from mitsvbrdf.measure.patch_statistics import highlights, patches_of, sliced_wasserstein


def test_patches_are_the_slices_around_chosen_pixels():
    pictures = torch.rand(2, 12, 10, 3, generator=torch.Generator().manual_seed(1))
    chosen = torch.zeros(2, 12, 10, dtype=torch.bool)
    for where in ((0, 4, 5), (1, 8, 3), (1, 2, 5)):  # the last one's patch reaches over the upper edge
        chosen[where] = True
    expected = torch.stack([pictures[0, 1:8, 2:9].flatten(), pictures[1, 5:12, 0:7].flatten()])
    assert torch.equal(patches_of(pictures, chosen), expected)
    with pytest.raises(MapsError, match="odd"):
        patches_of(pictures, chosen, 4)


def test_the_distance_of_a_shifted_set_is_the_mean_length_of_the_projected_shift():
    # Of x and x + t each projection is off by |t . w|; its mean over the sphere is |t| Gamma(d/2) / (sqrt(pi)
    # Gamma((d+1)/2)).
    d = 12
    x = torch.randn(500, d, generator=torch.Generator().manual_seed(2))
    shift = torch.linspace(-1, 1, d)
    closed = float(shift.norm()) * math.gamma(d / 2) / (math.sqrt(math.pi) * math.gamma((d + 1) / 2))
    # 4096 directions: standard error sqrt(pi/2 - 1) / 64 = 1.2 % of the mean; 4 of them
    assert sliced_wasserstein(x, x + shift, 4096) == pytest.approx(closed, rel=0.05)


def test_the_distance_is_that_of_an_independent_solver_in_one_dimension():
    scipy_stats = pytest.importorskip("scipy.stats")
    first, second = torch.rand(2, 300, 1, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    second = second**2
    truth = scipy_stats.wasserstein_distance(first[:, 0].numpy(), second[:, 0].numpy())
    assert sliced_wasserstein(first, second, 8) == pytest.approx(truth, rel=1e-9)


def test_the_distance_does_not_ask_what_lies_where_and_keeps_its_bits():
    x = torch.rand(200, 147, generator=torch.Generator().manual_seed(4))
    y = torch.rand(200, 147, generator=torch.Generator().manual_seed(5))
    # a product's rounding may depend on the row: 2e-18 on AMD, 0 on Intel
    assert sliced_wasserstein(x, x.flip(0)) < 1e-15
    assert sliced_wasserstein(x, y, seed=7) == sliced_wasserstein(x, y, seed=7) != sliced_wasserstein(x, y,
                                                                                                      seed=8)
    with pytest.raises(MapsError, match="as many"):
        sliced_wasserstein(x, y[:100])


def test_highlights_are_where_either_picture_is_over_twice_its_diffuse_part():
    matte = torch.full((1, 20, 20, 3), 0.1)
    photo, rendered = matte.clone(), matte.clone()
    photo[:, :, :8] = 0.5  # seen on the left
    rendered[:, 12:] = 0.5  # drawn below
    found = highlights(photo, rendered, matte)[0]
    assert found[2, 2] and found[17, 17] and not found[4, 17]
    assert not highlights(photo * 0.39, rendered * 0.39, matte).any()  # 0.195 is less than twice 0.1
