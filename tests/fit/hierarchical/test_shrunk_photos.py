"""Photos of a simulation that are shrunk: texels of two materials or slopes follow no model."""

import pytest
import torch
from helpers import GRID, MITSUBA, photos_of

from mitsvbrdf.capture import Capture, read_capture, write_capture
from mitsvbrdf.fit import HierarchicalConfig, fit_svbrdf
from mitsvbrdf.fit.hierarchical import rounds
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import flat

SIDE, LESS, ROUNDS = 64, 16, 13  # one more than the first stage has
TOLD = "their averages at 16 px do not"


def told(capture):
    result = fit_svbrdf(capture, MITSUBA, HierarchicalConfig(iterations=ROUNDS))
    return sum(TOLD in warning for warning in result.warnings)


def test_a_fit_tells_of_texels_that_mix(tmp_path):
    write_capture(photos_of(make_material("inlay", SIDE)), tmp_path)
    assert told(read_capture(tmp_path, LESS)) == 1


@pytest.mark.slow
def test_nothing_is_told_of_photos_that_still_follow_the_model():
    assert told(photos_of(make_material("inlay", LESS))) == 0  # not shrunk
    assert told(photos_of(flat(SIDE, diffuse=0.3, specular=0.04, roughness=0.4)).averaged(LESS)) == 0


@pytest.mark.slow
def test_nothing_is_told_of_photos_that_never_did(monkeypatch):
    monkeypatch.setattr(rounds, "MIXED", 0.5)  # so that averages leave enough, and the pixels decide
    exposed = torch.tensor([0.7, 1.0, 0.85] * 3)[:, None, None, None]  # which no view states
    assert told(Capture(photos_of(make_material("inlay", SIDE)).photos * exposed, GRID).averaged(LESS)) == 0


@pytest.mark.parametrize("side, less", [(64, 16), (250, 100), (4096, 256)])
def test_single_pixels_lie_in_the_middle_of_their_squares(side, less):
    place = torch.arange(side).float()[:, None, None].expand(side, side, 3) / side
    capture = Capture(place[None], GRID.pick([0])).averaged(less)
    count = len(capture.single[0])
    middles = (torch.arange(count) + 0.5) / count * side  # in pixels, whose middles lie at k + 1/2
    assert count <= less
    assert (capture.single[0, :, 0, 0] * side + 0.5 - middles).abs().max() <= 0.5


def test_single_pixels_are_picked_as_their_photos_are():
    capture = photos_of(make_material("inlay", SIDE))
    assert torch.equal(capture.averaged(LESS).pick([3]).single, capture.pick([3]).averaged(LESS).single)
