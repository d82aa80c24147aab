"""Heights from normals, and the sky that a relief hides: closed forms."""

import math

import pytest
import torch
import torch.nn.functional as F

from mitsvbrdf.material import relief
from mitsvbrdf.material.relief import heights, occlusion
from mitsvbrdf.views import texel_positions


def bump(size):
    """A Gaussian bump beside the middle: its height less the mean, and its normals."""
    x, y, _ = texel_positions(size).unbind(-1)
    height = 0.05 * torch.exp(-((x - 0.1) ** 2 + (y + 0.2) ** 2) / 0.02)
    right, up = -height * (x - 0.1) / 0.01, -height * (y + 0.2) / 0.01
    return height - height.mean(), F.normalize(torch.stack((-right, -up, torch.ones_like(x)), dim=-1), dim=-1)


def test_heights_of_a_bump_and_of_a_slope():
    height, normal = bump(128)
    # measured 7.7e-4: slopes are averaged between texels
    assert (heights(normal) - height).abs().max() < 1e-3 * 0.05
    coarse, normal = bump(64)
    assert (heights(normal) - coarse).abs().max() < 4e-3 * 0.05  # and 3.1e-3: of second order
    tilted = F.normalize(torch.tensor([0.1, -0.3, 1.0], dtype=torch.float64), dim=0).expand(16, 16, 3)
    x, y, _ = texel_positions(16).unbind(-1)
    assert (heights(tilted) - (-0.1 * x + 0.3 * y)).abs().max() < 1e-12  # exact for a plane


def test_a_normal_that_lies_down_is_no_tower():
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).repeat(64, 64, 1)
    # the lowest that maps may have
    normal[20, 30] = F.normalize(torch.tensor([1.0, 0.0, 1e-5]).double(), dim=0)
    # As high as a slope of 10: measured 0.028 patch sides, and 285 without an end to slopes.
    assert 0.01 < heights(normal).abs().max() < 0.05


def waves(size):
    """A height that goes on over the edges, and its normals."""
    x, y, _ = texel_positions(size).unbind(-1)
    a, b = 2 * math.pi, 4 * math.pi
    height = 0.02 * torch.cos(a * x) * torch.sin(b * y)
    right, up = -0.02 * a * torch.sin(a * x) * torch.sin(b * y), 0.02 * b * torch.cos(a * x) * torch.cos(
        b * y)
    return height, F.normalize(torch.stack((-right, -up, torch.ones_like(x)), dim=-1), dim=-1)


def test_a_relief_that_is_repeated_has_no_edges():
    height, normal = waves(64)
    found = heights(normal, periodic=True)
    assert (found - height).abs().max() < 0.01 * 0.02  # slopes are averaged between texels
    # a slope of the whole is lost
    tilted = F.normalize(normal + torch.tensor([0.2, 0.1, 0.0], dtype=torch.float64), dim=-1)
    for each in (found, heights(tilted, periodic=True)):
        assert float((each[:, 0] - each[:, -1]).abs().max()) < 1.5 * float(
            (each[:, 1:] - each[:, :-1]).abs().max())
    shifted = occlusion(height.roll((20, 9), (0, 1)), periodic=True).roll((-20, -9), (0, 1))
    assert (shifted - occlusion(height, periodic=True)).abs().max() < 1e-12  # no texel is at an edge
    assert (occlusion(height) - occlusion(height, periodic=True)).abs().max() > 1e-3


def test_flat_and_sloping_ground_sees_the_whole_sky():
    assert bool((occlusion(torch.zeros(16, 16, dtype=torch.float64)) == 1).all())
    # half of the directions look uphill: mean of 1 / (1 + (0.2 cos)^2) over them
    up = occlusion(0.2 * texel_positions(64)[..., 0])[32, 16:48]
    truth = 0.5 + 0.5 / math.sqrt(1 + 0.2**2)
    assert (up - truth).abs().max() < 4e-3  # measured 2.4e-3: steps along a direction end at whole texels


@pytest.mark.parametrize("away", [1, 4, 8])
def test_the_sky_beside_a_wall_has_a_closed_form(away):
    """A wall of height H at distance a hides (1 - a / sqrt(a^2 + H^2)) / 2 of an evenly bright sky."""
    size, wall = 256, 0.05
    height = torch.zeros(size, size, dtype=torch.float64)
    height[:, size // 2:] = wall
    a = away / size
    found = float(occlusion(height)[size // 2, size // 2 - away])
    # measured up to 0.02: sixteen directions
    assert found == pytest.approx((1 + a / math.hypot(a, wall)) / 2, abs=0.03)


def test_occlusion_of_larger_reliefs_is_that_of_their_average(monkeypatch):
    height = 4 * bump(600)[0]
    coarse = occlusion(height)
    monkeypatch.setattr(relief, "FINEST", 600)
    # measured 0.016
    assert coarse.shape == (600, 600) and float((coarse - occlusion(height)).abs().max()) < 0.03
