"""Rectified photos of known maps."""

import pytest
import torch
from helpers import ANALYTIC, GRID

from mitsvbrdf.color import to_display
from mitsvbrdf.errors import CaptureError
from mitsvbrdf.material.made import make_material
from mitsvbrdf.synth import photograph


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_photos_of_few_views_at_a_time_are_those_of_all(noise, monkeypatch):
    material = make_material("tiles", 16)
    whole = photograph(material, GRID, ANALYTIC, noise, 3)
    monkeypatch.setattr("mitsvbrdf.measure.rerender.PIXELS", 2 * 16**2)
    assert torch.equal(whole.photos, photograph(material, GRID, ANALYTIC, noise, 3).photos)
    exact = to_display(ANALYTIC.render(material, GRID), "gamma2.2")
    off = (whole.photos - exact)[exact < 1]
    assert off.abs().max() <= 0.5 / 255 + 1e-6 if not noise else off.std() > noise


def test_a_render_that_is_no_number_is_no_photo(monkeypatch):
    monkeypatch.setattr(type(ANALYTIC), "render", lambda *_: torch.full((9, 16, 16, 3), torch.nan))
    with pytest.raises(CaptureError):
        photograph(make_material("tiles", 16), GRID, ANALYTIC)
