"""Fifty digits and float64."""

import dataclasses
import math

import pytest
import torch
from helpers import TWIN
from helpers.one_sweep import FEW

from mitsvbrdf.material.maps import CHANNELS, flat
from mitsvbrdf.measure.gradients import fixed_cotangent, render_and_gradients
from mitsvbrdf.verify.stability.reference import texel_sum
from mitsvbrdf.verify.stability.sweeps import GRID, material, tilted
from mitsvbrdf.views import Views

LOW = Views.of([[3.0, 0.2, 1.0]], [[-2.0, 0.3, 0.4]], 30.0)
PAPER = dataclasses.replace(GRID.pick([0, 4]), falloff="none", size=2.0)


@pytest.mark.parametrize("bsdf", CHANNELS)
@pytest.mark.parametrize("views, values", [
    (FEW, {}), (PAPER, {}), (LOW, {}), (FEW, {"roughness": 1e-3}), (FEW, {"roughness": 1.0}),
    (LOW, {"normal": tilted(85)}),
    (FEW, {"specular": 1e-5, "metallic": 1.0, "base_color": 0.0}),
    (FEW, {"specular": 0.9985, "metallic": 0.0}),
])
def test_float64_agrees_with_fifty_digits(bsdf, views, values):
    # Measured over these: 8e-14 at worst, the gradient of F0 at 0.9985, where 1 - F0 has lost three digits;
    # else 2e-14.
    svbrdf = material(bsdf, **values)
    cotangent = fixed_cotangent(torch.Size((len(views), 16, 16, 3))).double()
    exact = render_and_gradients(TWIN, svbrdf, views, cotangent)
    for row, column in ((2, 3), (9, 14)):
        total, slopes = texel_sum(svbrdf, views, row, column, cotangent[:, row, column].tolist())
        parts = cotangent[:, row, column] * exact.image[:, row, column]
        assert abs(float(total) - float(parts.sum())) <= 1e-12 * float(parts.abs().sum())
        for name, values_ in slopes.items():
            true = torch.tensor([float(x) for x in values_], dtype=torch.float64)
            assert (exact.gradients[name][row, column] - true).norm() <= 1e-12 * true.norm(), name


def test_fifty_digits_know_the_closed_form():
    # A white diffuse texel below the light: I / (pi d^2), and the same as the slope in albedo.
    svbrdf = flat(1, diffuse=1.0, specular=0.0)
    total, slopes = texel_sum(svbrdf, Views.of([[0, 0, 2.5]], intensity=7.0), 0, 0, [[0.0, 1.0, 0.0]])
    assert float(total) == pytest.approx(7 / (math.pi * 2.5**2), rel=1e-15)
    assert [float(x) for x in slopes["diffuse"]] == pytest.approx([0, 7 / (math.pi * 2.5**2), 0], rel=1e-15)
