"""The maps of one BSDF as those of the other: closed forms for grey ones, a dense search for coloured ones."""

import math

import numpy as np
import pytest
import torch

from mitsvbrdf.export.textures import residual
from mitsvbrdf.material.conversion import as_principled
from mitsvbrdf.material.corner_cases import as_bsdf
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.testing import random_material


def encoded(x):
    return x ** (1 / 2.2)


@pytest.mark.parametrize("diffuse, specular", [(0.3, 0.1), (0.5, 0.04), (0.0, 0.8), (0.2, 0.5)])
def test_grey_materials_convert_exactly(diffuse, specular):
    """d = b u and s = b (1 - u) + 0.04 u, u = 1 - m, give 0.04 u^2 - (d + s) u + d = 0: one equation for u."""
    both = diffuse + specular
    glass = 2 * diffuse / (both + math.sqrt(both**2 - 4 * 0.04 * diffuse))
    made = flat(4, diffuse=diffuse, specular=specular, dtype=torch.float64)
    found = as_principled(made)
    assert float(found["metallic"][0, 0]) == pytest.approx(1 - glass, abs=1e-5)  # the search ends at 1e-6
    assert float(found["base_color"][0, 0, 0]) == pytest.approx(both - 0.04 * glass, abs=1e-5)
    # Diffuse as linear^(1/2.2) has slope 10 at 0.0005, and a search to 1e-6 near 0.
    assert max(residual(made, found).values()) < 1e-5


def test_the_residual_of_a_constant_material_has_a_closed_form():
    """F0 below 0.04 is out of reach: m = 0, b = diffuse, and F0 comes out as 0.04."""
    made = flat(4, diffuse=0.3, specular=0.01, dtype=torch.float64)
    found = as_principled(made)
    assert float(found["metallic"].max()) == 0
    lost = residual(made, found)
    assert lost["diffuse"] == pytest.approx(0, abs=1e-12)
    assert lost["specular"] == pytest.approx(encoded(0.04) - encoded(0.01), rel=1e-9)


def test_no_other_metallic_is_nearer():
    """Against a dense search by numpy, over colours of all kinds; base colour by its own grid for the best."""
    made = random_material("roughconductor", resolution=16).to(torch.float64)
    found = as_principled(made)
    d, s = (made[name].numpy().reshape(-1, 3, 1) for name in ("diffuse", "specular"))
    b, m = (found[name].numpy().reshape(256, -1) for name in ("base_color", "metallic"))

    def cost(b, m):
        return ((b * (1 - m) - d[..., 0]) ** 2 + (b * m + 0.04 * (1 - m) - s[..., 0]) ** 2).sum(axis=1)

    least = np.full(256, np.inf)
    grid = np.linspace(0, 1, 201)
    for metallic in np.linspace(0, 1, 401):
        errors = (grid * (1 - metallic) - d) ** 2 + (grid * metallic + 0.04 * (1 - metallic) - s) ** 2
        least = np.minimum(least, errors.min(axis=2).sum(axis=1))
    assert (cost(b, m) <= least + 1e-12).all()
    assert cost(b, m).mean() > 0.8 * least.mean()  # nor does it cheat: the grids are nearly as good


def test_grey_maps_come_back():
    """Grey ones with F0 of 0.04 and more that reflect no more than arrives are the image of base colour and metallic."""
    rng = torch.Generator().manual_seed(0)
    diffuse, specular = torch.rand(2, 16, 16, 1, generator=rng, dtype=torch.float64)
    diffuse, specular = diffuse * (1 - 0.04), 0.04 + (0.96 - 0.96 * diffuse) * specular
    grey = {"diffuse": diffuse.expand(-1, -1, 3), "specular": specular.expand(-1, -1, 3)}
    back = as_principled(SVBRDF("roughconductor", {**flat(16, dtype=torch.float64).maps, **grey})).check().as_roughconductor()
    for name in grey:
        assert float((back[name] - grey[name]).abs().max()) < 1e-5


def test_as_bsdf():
    made = make_material("inlay", 8)
    metal = as_bsdf(made, "principled")
    assert as_bsdf(made, "roughconductor") is made and as_bsdf(metal, "principled") is metal
    assert metal.check().bsdf == "principled" and as_bsdf(metal, "roughconductor").bsdf == "roughconductor"
    for name in ("roughness", "normal"):
        assert torch.equal(metal[name], made[name])
    black = flat(4, diffuse=0.0, specular=0.0)
    assert bool((as_principled(black)["metallic"] == 1).all())
    assert 0.999 < float(as_bsdf(black, "principled")["metallic"].max()) < 1
