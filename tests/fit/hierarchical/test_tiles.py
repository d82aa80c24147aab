"""Tiles of texels, samples of them and strips of rows: the same answer in less memory."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from helpers import GRID, MITSUBA, photos_of
from helpers.hierarchical_fits import method_of, reached

from mitsvbrdf import views
from mitsvbrdf.capture import Capture
from mitsvbrdf.fit import HierarchicalConfig, fit_svbrdf
from mitsvbrdf.fit.hierarchical import kernel, scales, scoring, stages
from mitsvbrdf.fit.hierarchical.sensor_noise import noise_at
from mitsvbrdf.fit.hierarchical.solver import Observations, TexelSolver
from mitsvbrdf.fit.hierarchical.texel_prior import TexelEstimate
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.resample import area_averaged, averaged_rows, enlarged_rows, resized, sampled
from mitsvbrdf.measure import rerender
from mitsvbrdf.measure.metrics import photo_rmse
from mitsvbrdf.measure.rerender import rerender_errors
from mitsvbrdf.render import texels
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


def test_planes_that_share_memory_do_not_bind_later_calls():
    """Dr.Jit would take the next prior for the start, or all of its precisions for one."""
    observations, generator = Observations(some_photos(), GRID, "gamma2.2", 0.03), torch.Generator()
    solver, fresh = TexelSolver("roughconductor"), TexelSolver("roughconductor")
    x, mean = (0.2 + 0.5 * torch.rand(9, SIDE, SIDE, generator=generator.manual_seed(k)) for k in (3, 4))

    def solved(solver, mean, precision):
        return solver.solve(observations, x, torch.full((SIDE, SIDE), 0.01), mean, precision,
                            torch.full((9,), 0.05), torch.ones(9), 3).x

    once, each = torch.full((1, SIDE, SIDE), 100.0).expand_as(x), 50 + 100 * mean
    own = solved(solver, x, once)
    assert torch.equal(solved(solver, mean, each), solved(fresh, mean, each))
    assert torch.equal(own, solved(fresh, x.clone(), once.contiguous()))
    assert not torch.equal(own, solved(fresh, mean, once))


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


def test_rows_of_resampled_images_are_rows():
    fine, coarse = some_photos(2), some_photos(2)[:, :4, :4]
    for side in (3, 4, SIDE):
        assert torch.equal(averaged_rows(lambda rows: fine[:, rows], SIDE, side), area_averaged(fine, side))
    for side in (4, 8, 11):
        rows = [enlarged_rows(coarse, side, slice(k, min(k + 3, side))) for k in range(0, side, 3)]
        torch.testing.assert_close(torch.cat(rows, dim=1), resized(coarse, side), rtol=0, atol=1e-6)
    assert sampled(fine[:1].movedim(-1, 1), 1).untyped_storage().nbytes() == 3 * 4  # it keeps nothing else


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


def test_rows_of_photos_give_the_rows_of_the_answer(monkeypatch):
    monkeypatch.setattr(kernel, "TILE", 4 * SIDE)
    stored = (some_photos() * 255).round().byte()
    sensor = torch.stack((torch.linspace(0, 1, 16), torch.linspace(0.02, 0.05, 16)))
    photos = Observations(stored, GRID, "gamma2.2", 0.03, 0.1, sensor=sensor)
    # the same as floats, with the weights said
    decoded = stored.float() / 255
    told = Observations(decoded, GRID, "gamma2.2", 0.03, 0.1,
                        (0.03 / noise_at(decoded.mean(dim=-1), sensor)).square())
    solver = TexelSolver("roughconductor")
    x = torch.rand(solver.unknowns.size, SIDE, SIDE, generator=torch.Generator().manual_seed(2)) * 0.5 + 0.1
    whole = solver.normal_equations(told, x)
    for rows in kernel.tiles(SIDE):
        part = solver.normal_equations(photos.of_rows(rows), x[:, rows])
        assert all(torch.equal(one, each[..., rows, :]) for one, each in zip(part, whole))
    assert [rows.stop for rows in kernel.tiles(SIDE)] == [4, 8, 10]


def test_starts_from_neighbours_are_planes_rolled():
    planes = torch.arange(2.0 * SIDE * SIDE).reshape(2, SIDE, SIDE)
    answer, rows = TexelEstimate(planes, planes + 0.1, planes + 0.2, torch.zeros(1)), slice(7, 10)
    for down, right in ((1, 0), (-1, 0), (0, 1), (3, -2)):
        assert torch.equal(answer.rows(rows, down, right).x, planes.roll((down, right), (1, 2))[:, rows])
        assert torch.equal(answer.rows(rows, down, right).mean, answer.mean[:, rows])  # a texel's own
    lobed = answer._replace(lobe=planes[0].long())
    assert torch.equal(lobed.rows(rows, 1).mean, answer.mean.roll(1, 1)[:, rows])
    assert torch.equal(lobed.rows(rows, 1).lobe, lobed.lobe.roll(1, 0)[rows])


def test_tiles_are_written_once_none_starts_from_them(monkeypatch):
    """Neither from below, nor round the edge, nor where the last tile shares rows with another."""
    side, reach = 26, 5  # in tiles of 3 rows
    monkeypatch.setattr(kernel, "TILE", 3 * side)
    monkeypatch.setattr(scoring, "COARSE", side // reach)
    planes = torch.arange(2.0 * side * side).reshape(2, side, side)
    for down in range(-reach, reach + 1):
        answer = TexelEstimate(*(planes.clone() for _ in range(3)), torch.zeros(1), planes[0].long())
        cost = torch.zeros(side, side)
        scoring.write_by_tiles(answer, cost, lambda rows, answer=answer, cost=cost, down=down: (
            answer.rows(rows, down, 1), cost[rows] + 1))
        assert torch.equal(answer.x, planes.roll((down, 1), (1, 2))) and torch.equal(answer.mean, answer.x)
        assert torch.equal(answer.lobe, answer.x[0].long()) and (cost == 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("exact", [False, True])
def test_photos_as_stored_give_the_same_fit(exact, monkeypatch):
    """In one tile of floats, and in tiles of photos that are kept in 8 bits."""
    monkeypatch.setattr(stages, "EXACT", 1.0 if exact else 0.0)
    monkeypatch.setattr(scales, "COARSE", 8)
    shots, ends = photos_of(make_material("inlay", 16)), []
    stored = (shots.photos * 255).round().byte()
    for photos, tile in ((stored.float() / 255, 16 * 16), (stored, 5 * 16)):
        for module in (kernel, texels):
            monkeypatch.setattr(module, "TILE", tile)
        ends.append(fit_svbrdf(replace(shots, photos=photos), MITSUBA, HierarchicalConfig(budget=1e4)))
    first, second = ends
    assert all(torch.equal(first.svbrdf[name], second.svbrdf[name]) for name in first.svbrdf.maps)
    assert first.record["per_photo"] == second.record["per_photo"]
    assert first.record["confidence"] == second.record["confidence"]
    assert torch.equal(first.photos, second.photos)


@pytest.mark.slow
def test_a_state_keeps_equal_precisions_once(monkeypatch):
    monkeypatch.setattr(stages, "EXACT", 0.0)
    monkeypatch.setattr(scales, "COARSE", 8)
    method = reached(stages.Stage.FINE, method_of(photos_of(make_material("leather", 16))))
    assert method.glimpse() is None  # real photos at full size are measured whole
    state = method.state()
    assert state["precision"].shape == (9, 1, 1)
    again = method_of(method.capture)
    again.load_state(state)
    assert again.answer.precision.shape == method.answer.x.shape
    method.step(0.0)
    again.step(0.0)
    assert torch.equal(method.answer.x, again.answer.x)


def test_renderings_that_are_not_kept_are_made_again(monkeypatch):
    shots = photos_of(make_material("leather", 16))
    kept = fit_svbrdf(shots, MITSUBA, HierarchicalConfig(iterations=2))
    monkeypatch.setattr(rerender, "PIXELS", 2 * 16 * 16)
    made = fit_svbrdf(shots, MITSUBA, HierarchicalConfig(iterations=2))
    assert "rerendered" in kept.known and "rerendered" not in made.known
    assert torch.equal(kept.rerendered, made.rerendered)
    assert torch.equal(kept.known["sample"], made.known["sample"]) and kept.warnings == made.warnings
