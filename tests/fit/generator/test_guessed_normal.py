"""Normals guessed from shading, against closed forms."""

import math

import pytest
import torch
from helpers import ANALYTIC, GRID

from mitsvbrdf import color
from mitsvbrdf.capture import Capture
from mitsvbrdf.fit.generator.guessed_normal import (
    blurred,
    from_slopes,
    gradient,
    guess_normal,
    height_of,
    strength,
)
from mitsvbrdf.material.maps import SVBRDF, flat

R = 64


def relief(periods, height):
    """A height map of waves along x, in texels, and its slopes n_x / n_z, n_y / n_z by calculus."""
    x = (torch.arange(R, dtype=torch.float64) + 0.5).expand(R, R) * 2 * math.pi * periods / R
    slope = height * 2 * math.pi * periods / R * torch.sin(x)
    return height * torch.cos(x), torch.stack((slope, torch.zeros_like(slope)), dim=-1)


def matt(slopes, albedo=0.5):
    maps = dict(flat(R, specular=0.0, roughness=1.0).maps) | {"normal": from_slopes(slopes.float())}
    maps["diffuse"] = torch.full((R, R, 3), 1.0) * torch.as_tensor(albedo, dtype=torch.float32)
    return SVBRDF("roughconductor", maps)


def photographed(material):
    return Capture(color.to_display(ANALYTIC.render(material, GRID)), GRID)


def test_slopes_of_a_height_map_are_those_of_calculus():
    height, slopes = relief(2, 1.5)
    inner = (slice(4, -4), slice(4, -4))
    found, up = -gradient(height), -gradient(height.T.flip(0))  # the same wave towards y, which points up
    assert torch.allclose(found[inner], slopes[inner], atol=2e-3)
    assert torch.allclose(up[..., 1][inner], slopes[..., 0].T.flip(0)[inner], atol=2e-3)
    assert up[..., 0].abs().max() < 1e-12


@pytest.mark.parametrize("periods", [2, 8])
def test_a_faint_wave_of_shading_becomes_a_wave_of_height(periods):
    # Small waves go through linearly: an octave passes exp(-(2 pi f sigma)^2 / 2) of the finer less that of
    # the coarser one, and the curve's slope at the rim is 1.
    wave = 1e-3 * relief(periods, 1.0)[0]
    passed = [1.0, *(math.exp(-(2 * math.pi * periods / R * 2**k) ** 2 / 2) for k in range(4))]
    gain = sum(2**k * (fine - coarse) for k, (fine, coarse) in enumerate(zip(passed, passed[1:])))
    found = height_of(1 + wave)
    assert torch.allclose(found[:, 28:36], gain * wave[:, 28:36], atol=0.01 * gain * 1e-3 + 2e-6 * gain)


def test_dark_is_deep_along_the_curve():
    # A dark dot in a bright plane: the finest octave alone is 2 / ratio - 1 under the root, less the rim.
    shade = torch.ones(8, 8, dtype=torch.float64)
    shade[4, 4] = 0.3
    around = blurred(shade, 1.0)[4, 4]
    assert math.isclose(height_of(shade)[4, 4], -(math.sqrt(2 * float(around) / 0.3 - 1) - 1), rel_tol=1e-9)


def test_a_blur_keeps_the_mean_and_spreads_by_its_sigma():
    dot = torch.zeros(33, 33, dtype=torch.float64)
    dot[16, 16] = 1
    spread = blurred(dot, 2.0)
    at = torch.arange(33, dtype=torch.float64) - 16
    assert math.isclose(spread.sum(), 1, rel_tol=1e-9)
    assert math.isclose((spread.sum(dim=0) * at**2).sum(), 4, rel_tol=0.04)  # cut at 3 sigma


@pytest.mark.parametrize("factor", [1.0, -0.5])
def test_the_photos_say_how_steep_it_is(factor):
    slopes = relief(4, 0.4)[1].float()
    found = strength(photographed(matt(factor * slopes)), slopes)
    # a Lambertian's shading to first order of slopes up to 0.16
    assert math.isclose(found, factor, rel_tol=0.05)


def test_without_shading_normals_are_flat():
    # Painted waves, no relief: dark is not deep, and the photos say so.
    painted = 0.4 + 0.2 * relief(4, 1.0)[0].float()[..., None].expand(-1, -1, 3)
    normal = guess_normal(photographed(matt(torch.zeros(R, R, 2), painted)), painted)
    assert normal[..., :2].abs().max() < 0.01


def test_cavities_that_are_dark_are_found():
    height, slopes = relief(4, 0.6)
    cavities = 0.4 + 0.3 * height.float()[..., None].expand(-1, -1, 3)  # paint that is darker in the deep
    truth = matt(slopes, cavities)
    normal = guess_normal(photographed(truth), cavities)
    before, after = ((n - truth["normal"]).square().mean().sqrt() for n in (flat(R)["normal"], normal))
    assert after < 0.75 * before  # half of the steepness is taken
    assert torch.allclose(normal.norm(dim=-1), torch.ones(R, R), atol=1e-5)
