"""The sphere at a glance: what covers it is the material and its mirror images, lit as those would be."""

import torch

from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.relight.stage import mirrored
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.testing import random_material
from mitsvbrdf.views import Views


def test_mirror_images_look_as_in_a_mirror():
    side = 8
    material = random_material("roughconductor", side).to(torch.float64)
    four, renderer = mirrored(material), AnalyticRenderer(torch.float64)
    camera, light = [0.3, -0.2, 1.5], [-0.5, 0.4, 1.0]
    truth = renderer.render(material, Views.of([camera], [light]))[0]
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        rows, columns = slice(row * side, (row + 1) * side), slice(column * side, (column + 1) * side)
        part = SVBRDF(material.bsdf,
                      {name: value[rows, columns].contiguous() for name, value in four.maps.items()})
        turned = torch.tensor([1.0 - 2 * column, 1.0 - 2 * row, 1.0])
        views = Views.of(*((torch.tensor([place]) * turned).tolist() for place in (camera, light)))
        found = renderer.render(part, views)[0]
        flipped = found.flip([axis for axis, on in ((0, row), (1, column)) if on])
        assert truth.max() > 0.05 and torch.allclose(flipped, truth, rtol=1e-6, atol=1e-9)
