"""Photos too large to be rendered together are rendered one by one, and give the same figures."""

import torch
from helpers import ANALYTIC, GRID, photos_of

from mitsvbrdf.evaluate.photos import Entry, compare
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import flat
from mitsvbrdf.measure import rerender

SIDE = 32


def test_pictures_that_are_rendered_one_by_one(monkeypatch):
    capture = photos_of(make_material("inlay", SIDE), GRID.pick([0, 1, 3]))
    entries, found = [Entry("flat", "x", flat(SIDE))], []
    for pixels in (rerender.PIXELS, SIDE**2):
        monkeypatch.setattr(rerender, "PIXELS", pixels)
        found.append(compare(entries, capture, ANALYTIC))
    (record, (pictures,)), (again, (others,)) = found
    assert record == again and torch.equal(pictures, others) and len(pictures) == 3
