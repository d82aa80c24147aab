"""Tiles of texels, samples of them and strips of rows: the same answer in less memory."""

from __future__ import annotations

import torch
from helpers import GRID

from mitsvbrdf import views
from mitsvbrdf.capture import Capture
from mitsvbrdf.fit.hierarchical import kernel
from mitsvbrdf.fit.hierarchical.solver import Observations, TexelSolver
from mitsvbrdf.material.made import make_material
from mitsvbrdf.measure import rerender
from mitsvbrdf.measure.metrics import photo_rmse
from mitsvbrdf.measure.rerender import rerender_errors
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.views import coverage_angle, geometry, half_angles

SIDE = 10


def some_photos(count: int = 9) -> torch.Tensor:
    return torch.rand(count, SIDE, SIDE, 3, generator=torch.Generator().manual_seed(1))


def test_tiles_give_the_same_bits(monkeypatch):
    observations, found = Observations(some_photos(), GRID, "gamma2.2", 0.03, 0.1), []
    for tile in (SIDE * SIDE, 3 * SIDE):  # all; three rows, of which the last tile shares two with another
        monkeypatch.setattr(kernel, "TILE", tile)
        solver = TexelSolver("roughconductor")
        x = torch.full((solver.unknowns.size, SIDE, SIDE), 0.3)
        low, high = torch.full((len(x),), 0.05), torch.ones(len(x))
        solved = solver.solve(observations, x, torch.full((SIDE, SIDE), 0.01), x, torch.full_like(x, 10.0),
                              low, high, 4)
        found.append([solved.x, solved.data, *solver.posterior(observations, x, torch.ones_like(x)),
                      *solver.normal_equations(observations, x)])
    assert all(torch.equal(one, other) for one, other in zip(*found))
    assert not torch.equal(found[0][0], x)


def test_texels_that_have_arrived_stay(monkeypatch):
    """Steps beyond the end of a search change nothing that counts: 1e-4 is what ends it."""
    observations = Observations(some_photos(), GRID, "gamma2.2", 0.03)
    solver, ends = TexelSolver("roughconductor"), []
    x = torch.full((solver.unknowns.size, SIDE, SIDE), 0.3)
    low, high = torch.full((len(x),), 0.05), torch.ones(len(x))
    for free in (kernel.FREE, -1.0):  # -1: no search ends
        monkeypatch.setattr(kernel, "FREE", free)
        solver = TexelSolver("roughconductor")
        ends.append(solver.solve(observations, x, torch.full((SIDE, SIDE), 0.01), x,
                                 torch.full_like(x, 100.0), low, high, 30))
    cost, other = (end.data + end.prior for end in ends)
    assert not torch.equal(ends[0].x, ends[1].x)
    assert float((cost / other - 1).abs().max()) < 1e-3  # 2e-5 here


def test_strips_of_rows_are_rows():
    whole, angles = geometry(GRID, SIDE), half_angles(GRID, SIDE)
    for rows in (slice(0, 4), slice(7, 10)):
        assert all(torch.equal(part, each[:, rows]) for part, each in zip(geometry(GRID, SIDE, rows), whole))
        assert torch.equal(half_angles(GRID, SIDE, rows), angles[:, rows])


def test_errors_of_strips_and_of_views_one_by_one(monkeypatch):
    svbrdf, renderer = make_material("leather", SIDE), AnalyticRenderer()
    measured = some_photos()[..., 0] > 0.3
    capture = Capture(some_photos(), GRID, measured=measured)
    images, total, each = rerender.rerender(renderer, svbrdf, GRID, capture)
    monkeypatch.setattr(rerender, "PIXELS", 2 * SIDE * SIDE)
    assert rerender_errors(renderer, svbrdf, GRID, capture) == (total, each)
    monkeypatch.setattr(views, "STRIP", 3 * SIDE)
    again = photo_rmse(images, capture.photos, capture.transfer, measured)
    torch.testing.assert_close(torch.tensor([again[0], *again[1]]), torch.tensor([total, *each]),
                               rtol=1e-6, atol=0)
    error = (images.double().clamp_min(0) ** (1 / 2.2)).clip(0, 1) - capture.photos.double()
    said = error[0].square().mean(dim=-1)[measured[0]].mean().sqrt()
    assert abs(float(said) / each[0] - 1) < 1e-3  # the response has a straight toe
    assert torch.equal(coverage_angle(GRID, SIDE), half_angles(GRID, SIDE).amin(dim=0))
