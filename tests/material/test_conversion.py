"""The maps of one BSDF as those of the other, and as clients that lay the lobes show them: closed forms."""

import pytest
import torch

from mitsvbrdf.export.residual import LIGHTS, residual, three_lights
from mitsvbrdf.material.conversion import as_principled, as_shown, is_metal, layered, relative_f0, usual_f0
from mitsvbrdf.material.maps import SVBRDF, flat


def encoded(x):
    return x ** (1 / 2.2)


def half_and_half(left, right):
    """A material of two flat ones, 8 px."""
    pair = flat(8, dtype=torch.float64, **left), flat(8, dtype=torch.float64, **right)
    return SVBRDF("roughconductor", {
        name: torch.cat((pair[0][name][:, :4], pair[1][name][:, 4:]), dim=1) for name in pair[0].maps})


@pytest.mark.parametrize("diffuse, specular, metallic", [
    (0.3, 0.1, 0),  # a glossy card: as the metallic of least squares it was 0.2
    (0.3, 0.3, 0),  # a fit of wood whose F0 nobody saw
    (0.0, 0.17, 0),  # black diamond
    (0.0, 0.8, 1), (0.1, 0.56, 1),  # silver; iron with a little dust, or a fit's doubt
    (0.2, 0.5, 0)])  # a diffuse colour that no metal has
def test_only_what_clearly_is_a_metal_is_one(diffuse, specular, metallic):
    found = as_principled(flat(4, diffuse=diffuse, specular=specular, dtype=torch.float64))
    assert found["metallic"].unique().tolist() == [metallic]
    assert found["base_color"].unique().tolist() == [specular if metallic else diffuse]


def test_coloured_metals_count_by_their_strongest_channel():
    gold = torch.tensor([1.0, 0.77, 0.34], dtype=torch.float64)
    dark_red = torch.tensor([0.26, 0.01, 0.01], dtype=torch.float64)
    maps = dict(flat(4, diffuse=0.0, dtype=torch.float64).maps)
    for f0 in (gold, dark_red):
        material = SVBRDF("roughconductor", maps | {"specular": f0.expand(4, 4, 3)})
        assert bool(is_metal(material).all()) and torch.equal(as_principled(material)["base_color"],
                                                              material["specular"])


def test_what_is_no_metal_looks_the_same_from_above():
    """Clients let through 1 - F0 of the diffuse light; the way back gives our sum, of metals F0."""
    made = half_and_half({"diffuse": 0.3, "specular": 0.2}, {"diffuse": 0.01, "specular": 0.9})
    f0 = made["specular"].amax(dim=-1, keepdim=True)
    material = layered(made, f0)
    assert float(material["base_color"][0, 0, 0]) == pytest.approx(0.3 / (1 - 0.2), rel=1e-12)
    assert float(material["base_color"][0, 7, 0]) == 0.9 and float(material["metallic"][0, 7]) == 1
    back = as_shown(material, made["specular"], f0)
    assert float((back["specular"] - made["specular"]).abs().max()) < 1e-12
    assert back["diffuse"][:, :4].sub(0.3).abs().max() < 1e-12 and bool((back["diffuse"][:, 4:] == 0).all())


def test_base_colours_end_at_one():
    bright = flat(4, diffuse=0.9, specular=0.3, dtype=torch.float64)
    assert layered(bright, bright["specular"][..., :1])["base_color"].unique().tolist() == [1]


def test_one_f0_for_all_that_is_no_metal():
    made = half_and_half({"diffuse": 0.3, "specular": 0.06}, {"diffuse": 0.0, "specular": 0.9})
    assert usual_f0(made) == pytest.approx(0.06)
    assert relative_f0(made, 0.06)[..., 0].unique().tolist() == pytest.approx([1])
    assert relative_f0(made, 0.04)[0, 0, 0] == pytest.approx(1.5) and relative_f0(made, 0.04)[0, 7, 0] == 1
    # water's: the least of its kind
    assert usual_f0(flat(4, diffuse=0.3, specular=0.0)) == pytest.approx(0.02)
    assert usual_f0(flat(4, diffuse=0.0, specular=0.9)) == 0.04  # nothing but metal


def test_the_residual_of_a_constant_material_has_a_closed_form():
    """F0 of 0.01 comes out as 0.04; the flat patch mirrors the camera's light at its centre alone."""
    made = flat(5, diffuse=0.3, specular=0.01, roughness=1.0, dtype=torch.float64)
    lost = residual(made, as_principled(made))
    assert lost["diffuse"] == pytest.approx(0, abs=1e-12)
    assert lost["specular"] == pytest.approx(encoded(0.04) - encoded(0.01), rel=1e-9)
    assert set(lost) == {"diffuse", "specular", *LIGHTS} and all(0 < lost[light] < 0.1 for light in LIGHTS)
    assert all(residual(made, made)[light] < 1e-7 for light in LIGHTS)  # display values in float32


def test_the_pictures_of_a_matte_texel_have_a_closed_form():
    """At the centre every light gives half of pi: 0.15 is shown where it should be 0.1, in sRGB."""
    right, wrong = (flat(1, diffuse=diffuse, specular=0.0, roughness=1.0) for diffuse in (0.2, 0.3))
    lost = residual(right, wrong)
    for light in LIGHTS:
        assert lost[light] == pytest.approx(1.055 * (0.15 ** (1 / 2.4) - 0.1 ** (1 / 2.4)), rel=1e-4)


def test_three_lights_are_as_bright_at_the_centre():
    views = three_lights()
    distance2 = views.light.square().sum(dim=1)
    cosine = views.light[:, 2] / distance2.sqrt()
    assert (views.intensity[:, 0] * cosine / distance2).tolist() == pytest.approx([torch.pi / 2] * 3)
    assert torch.equal(views.camera[0], views.light[0])
