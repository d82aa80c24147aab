"""Fifty digits and float64."""

import dataclasses
import math

import pytest
import torch
from helpers import TWIN
from helpers.fifty_digits import texel_sum
from helpers.one_sweep import FEW

from mitsvbrdf.material.maps import CHANNELS, flat
from mitsvbrdf.measure.gradients import fixed_cotangent, render_and_gradients
from mitsvbrdf.verify.stability import SWEEPS
from mitsvbrdf.verify.stability.sweeps import GRID, material, tilted
from mitsvbrdf.views import Views

LOW = Views.of([[3.0, 0.2, 1.0]], [[-2.0, 0.3, 0.4]], 30.0)
PAPER = dataclasses.replace(GRID.pick([0, 4]), falloff="none", size=2.0)


@pytest.mark.parametrize("bsdf", CHANNELS)
@pytest.mark.parametrize("views, values", [
    (FEW, {}), (PAPER, {}), (LOW, {}), (FEW, {"roughness": 1e-3}), (FEW, {"roughness": 1.0}),
    (LOW, {"normal": tilted(85)}), (FEW, {"specular": 1e-5, "metallic": 1.0, "base_color": 0.0}),
    (FEW, {"specular": 0.9985, "metallic": 0.0}),
])
def test_float64_agrees_with_fifty_digits(bsdf, views, values):
    # Measured over these: 8e-14 at worst, the gradient of F0 at 0.9985, where 1 - F0 has lost three digits;
    # else 2e-14.
    agrees(material(bsdf, **values), views, [(2, 3), (9, 14)], 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("sweep", SWEEPS)
def test_float64_agrees_with_fifty_digits_to_the_ends_of_every_range(sweep):
    """In each case's brightest texel. Measured: 1e-15; 3e-9 where both stand low on opposite sides."""
    for case in SWEEPS[sweep][1]():
        if case.small and not case.refused:
            brightest = int(TWIN.render(case.svbrdf, case.views).sum(dim=(0, 3)).argmax())
            agrees(case.svbrdf, case.views, [divmod(brightest, case.svbrdf.resolution)], 1e-6)


def agrees(svbrdf, views, texels, bound):
    side = svbrdf.resolution
    cotangent = fixed_cotangent(torch.Size((len(views), side, side, 3))).double()
    exact = render_and_gradients(TWIN, svbrdf, views, cotangent)
    for row, column in texels:
        total, slopes = texel_sum(svbrdf, views, row, column, cotangent[:, row, column].tolist())
        parts = cotangent[:, row, column] * exact.image[:, row, column]
        assert abs(float(total) - float(parts.sum())) <= bound * float(parts.abs().sum())
        for name, values in slopes.items():
            true = torch.tensor([float(x) for x in values], dtype=torch.float64)
            assert (exact.gradients[name][row, column] - true).norm() <= bound * true.norm(), name


def test_fifty_digits_know_the_closed_form():
    # A white diffuse texel below the light: I / (pi d^2), and the same as the slope in albedo.
    svbrdf = flat(1, diffuse=1.0, specular=0.0)
    total, slopes = texel_sum(svbrdf, Views.of([[0, 0, 2.5]], intensity=7.0), 0, 0, [[0.0, 1.0, 0.0]])
    assert float(total) == pytest.approx(7 / (math.pi * 2.5**2), rel=1e-15)
    assert [float(x) for x in slopes["diffuse"]] == pytest.approx([0, 7 / (math.pi * 2.5**2), 0], rel=1e-15)
