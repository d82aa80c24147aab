"""The studio of the live viewer: its sums against plainer ones."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
import torch
from helpers.viewer_pages import changed

from mitsvbrdf.material.maps import flat
from mitsvbrdf.relight import environment
from mitsvbrdf.render.analytic import MIN_ALPHA, AnalyticRenderer
from mitsvbrdf.report import viewer_lighting
from mitsvbrdf.views import Views


def weighted(directions: torch.Tensor, kernel) -> np.ndarray:
    """The studio under a kernel of the cosine, one direction after the other."""
    rows = 2 * viewer_lighting.ROWS
    light = environment.studio(rows).reshape(-1, 3)
    ways = environment.directions(rows, 2 * rows).reshape(-1, 3)
    weight = kernel(directions @ ways.T) * (1 - ways[:, 2] ** 2).clamp_min(0).sqrt()
    return ((weight @ light) / weight.sum(-1, keepdim=True)).numpy() * viewer_lighting._scale()


def lobe(alpha: float, cosine: torch.Tensor) -> torch.Tensor:
    """D G1 by the angle's half, from Walter et al. 2007, eqs. 33 and 34."""
    half, n_l = torch.acos(cosine.clamp(-1, 1)) / 2, cosine.clamp_min(0)
    d = alpha**2 / (math.pi * torch.cos(half) ** 4 * (alpha**2 + torch.tan(half) ** 2) ** 2)
    return d * 2 / (1 + torch.sqrt(1 + alpha**2 * (1 / n_l.clamp_min(1e-9) ** 2 - 1))) * (n_l > 0)


def test_lobes_and_irradiance_are_plain_sums():
    some = [0, 500, 1234, 2345, 4607]
    ways = environment.directions(viewer_lighting.ROWS, 2 * viewer_lighting.ROWS).reshape(-1, 3)
    pictures = viewer_lighting.lobes().reshape(viewer_lighting.LEVELS, -1, 3)
    for level in (2, 5, 8):
        # The plain sum leaves out the zenith, where the first of these lies; measured: 5e-3 at level 2, 4e-4
        # above.
        assert np.allclose(pictures[level][some],
                           weighted(ways[some], functools.partial(lobe, (level / 8) ** 2)), rtol=8e-3)
    ways = environment.directions(16, 32).reshape(-1, 3)
    diffuse = viewer_lighting.diffuse().reshape(-1, 3)[::37]
    assert np.allclose(diffuse, weighted(ways[::37], lambda c: c.clamp_min(0)), rtol=2e-3)


def test_white_that_faces_the_camera_has_luminance_0_8():
    ahead = environment.directions(16, 32)[..., 1]
    facing = viewer_lighting.diffuse()[ahead < ahead.min() + 1e-9]
    # half a pixel aside
    assert (facing @ environment.LUMINANCE.numpy()).mean() == pytest.approx(0.8, rel=0.01)


@pytest.mark.parametrize("row, column", [(5, 28), (12, 9), (20, 20), (31, 31), (31, 4)])
def test_shares_are_what_the_analytic_renderer_reflects_of_light_from_everywhere(row, column):
    roughness, n_v = (row + 0.5) / viewer_lighting.SHARES, (column + 0.5) / viewer_lighting.SHARES
    # Middles of cells of equal solid angle, as lights far away.
    count = 150
    middles = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    z, phi = (axis.reshape(-1, 1) for axis in torch.meshgrid(middles, 2 * math.pi * middles, indexing="ij"))
    lights = torch.cat(((1 - z**2).sqrt() * phi.cos(), (1 - z**2).sqrt() * phi.sin(), z), dim=-1) * 1e4
    camera = [[1e4 * math.sqrt(1 - n_v**2), 0.0, 1e4 * n_v]] * len(lights)
    views = Views.of(camera, lights, 1e8 * 2 * math.pi / len(lights))
    reflected = {}
    for colour in (1.0, 0.0):
        metal = flat(1, "principled", base_color=colour, metallic=1.0).to(torch.float64)
        metal = changed(metal, roughness=torch.tensor(roughness, dtype=torch.float64))
        reflected[colour] = float(AnalyticRenderer(torch.float64).render(metal, views)[..., 0].sum())
    found = viewer_lighting.shares(MIN_ALPHA["principled"])[row, column]
    assert found == pytest.approx([reflected[1.0], reflected[0.0]], rel=0.02, abs=2e-4)
