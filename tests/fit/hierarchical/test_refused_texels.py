"""Texels whose photos refuse their answer: found by their noise, searched further, they alone."""

from __future__ import annotations

import pytest
import torch
from helpers import photos_of
from helpers.hierarchical_fits import method_of, reached

from mitsvbrdf.fit.hierarchical import kernel, rounds
from mitsvbrdf.fit.hierarchical.solver import Observations, TexelSolver
from mitsvbrdf.fit.hierarchical.stages import Stage
from mitsvbrdf.fit.hierarchical.texel_prior import TexelEstimate
from mitsvbrdf.material.made import make_material

SIDE = 16
TURNED_AWAY = 8.0  # slope


def test_some_texels_are_solved_as_among_all(monkeypatch):
    shots = photos_of(make_material("inlay", SIDE))
    weights = torch.rand(shots.photos.shape[:3], generator=torch.Generator().manual_seed(3))
    photos = Observations(shots.photos, shots.views, shots.transfer, 0.01, weights=weights)
    known = {"roughness": torch.rand(SIDE, SIDE, 1, generator=torch.Generator().manual_seed(2)) * 0.5 + 0.2}
    solver, texels = TexelSolver("roughconductor", known), torch.tensor([[3, 250], [77, 3]])
    x = torch.rand(solver.unknowns.size, SIDE, SIDE, generator=torch.Generator().manual_seed(1)) * 0.5 + 0.1
    monkeypatch.setattr(kernel, "TILE", 5 * SIDE)
    for whole, some in zip(solver.normal_equations(photos, x), solver.normal_equations(
            photos.of_texels(texels), x.flatten(1)[:, texels])):
        torch.testing.assert_close(some, whole.flatten(-2)[..., texels], rtol=0, atol=0)


@pytest.fixture(scope="module")
def fine():
    """A fit of exact photos in its last stage."""
    method = reached(Stage.FINE, method_of(photos_of(make_material("inlay", SIDE)), exact=True))
    method.step(0.0)
    return method


@pytest.mark.slow
def test_a_texel_that_was_turned_away_comes_back(fine):
    scoring, lobes = fine._scoring(), fine.exact.lobes
    answer, cost = scoring.scored(fine.answer, 1)
    refused, away = scoring.refused(answer), torch.tensor([5 * SIDE + 4, 12 * SIDE + 9])
    assert not torch.isin(away, refused).any()
    x = answer.x.clone()
    of, diffuse = fine.prior.slopes, fine.prior.unknowns.of("diffuse")
    x.flatten(1)[of[:, None], away] = TURNED_AWAY
    x.flatten(1)[diffuse[:, None], away] = 1.0
    spoilt, its = scoring.scored(answer._replace(x=x), 0)
    assert torch.equal(scoring.refused(spoilt), torch.cat((refused, away)).unique())

    found, less = scoring.searched_further(TexelEstimate(*map(torch.clone, spoilt)), its.clone(),
                                           lobes.further_starts)
    assert not torch.isin(away, scoring.refused(found)).any()
    assert (less <= its).all()
    alone = torch.ones(SIDE**2, dtype=torch.bool).index_fill(0, torch.cat((refused, away)), False)
    assert torch.equal(found.x.flatten(1)[:, alone], spoilt.x.flatten(1)[:, alone])
    off = (found.x - answer.x).flatten(1)[:, away].abs().amax()
    assert off < 0.05  # .004 here


def test_few_planes_tell_the_prior_of_texels_with_lobes(fine):
    answer, lobes, prior = fine.answer, fine.exact.lobes.lobes, fine.prior
    assert (len(answer.mean), len(answer.precision), answer.lobe.dtype) == (1, 1, torch.uint8)
    whole, start = prior.whole(answer), fine.start().x[prior.diffuse].flatten(1)
    for row, column in ((0, 0), (5, 9), (SIDE - 1, 3)):
        lobe = int(answer.lobe[row, column])
        mean, precision = whole.mean[:, row, column], whole.precision[:, row, column]
        torch.testing.assert_close(mean[prior.shared], lobes.mean[lobe].float(), rtol=1e-6, atol=0)
        torch.testing.assert_close(precision[prior.shared], (1 / lobes.variance[lobe]).float(), rtol=1e-6,
                                   atol=0)
        assert (mean[prior.slopes] == 0).all()
        assert (precision[prior.slopes] == answer.precision[0, row, column]).all()
        assert torch.equal(mean[prior.diffuse], start[:, answer.mean[0, row, column]])


def test_a_round_of_exact_photos_at_full_size_is_measured_by_a_sample(fine, monkeypatch):
    monkeypatch.setattr(rounds, "SHOWN", 4)
    svbrdf, _, seen = fine.glimpse()
    some = slice(SIDE // 4 // 2, None, SIDE // 4)
    assert fine.measured_every == 1 and torch.equal(seen.photos, fine.capture.photos[:, some, some])
    whole = fine.estimate()[0]  # torch's powers of few and of many numbers round apart with AVX-512
    assert all((value - whole[name][some, some]).abs().max() < 1e-7 for name, value in svbrdf.maps.items())
