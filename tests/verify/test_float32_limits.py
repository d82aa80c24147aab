"""What float32 can do, against closed forms."""

import math

import pytest
import torch
from helpers import GRID, TWIN
from helpers.crosschecks import BOTH, THREE

from mitsvbrdf.material.corner_cases import as_bsdf, corner_materials
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.measure.gradients import fixed_cotangent, render_and_gradients
from mitsvbrdf.measure.metrics import image_error
from mitsvbrdf.measure.tolerances import UNIT_ROUNDOFF
from mitsvbrdf.verify.float32_limits import diffuse_radiance, float32_limit, turned_normals, why, worst_texels
from mitsvbrdf.views import Views


def limit_of(svbrdf, views):
    cotangent = fixed_cotangent(torch.Size((len(views), svbrdf.resolution, svbrdf.resolution, 3)))
    exact = render_and_gradients(TWIN, svbrdf, views, cotangent)
    return exact, float32_limit(TWIN, svbrdf, views, exact, cotangent)


@pytest.mark.parametrize("roughness", [0.05, 0.1, 0.2])
def test_limit_at_the_steepest_of_a_ggx_lobe(roughness):
    # One texel straight below camera and light, tilted by atan(alpha): |d log D / d angle| = 2 (1 - alpha^2)
    # / alpha. Masking and cosines add terms of order alpha: measured 1e-6, 2e-5 and 4e-4 of it.
    alpha = roughness**2
    tilted = torch.tensor([alpha, 0.0, 1.0]) / math.hypot(1, alpha)
    svbrdf = SVBRDF("roughconductor", {**flat(1, diffuse=0.0, roughness=roughness).maps,
                                       "normal": tilted.expand(1, 1, 3)})
    exact, limit = limit_of(svbrdf, Views.of([[0.0, 0.0, 2.0]]))
    condition = limit.image / exact.image / UNIT_ROUNDOFF
    assert condition.flatten().tolist() == pytest.approx([2 * (1 - alpha**2) / alpha] * 3, rel=2e-3)


def test_limit_is_what_a_turn_of_the_normals_does():
    # Turned by one rounding in random directions, a value changes by |dL/dn| u times a cosine whose square is
    # 1/2 on average.
    svbrdf = make_material("tiles", 24)
    exact, limit = limit_of(svbrdf, THREE)
    first, second = (m["normal"] - svbrdf["normal"].double() for m in turned_normals(svbrdf, 1.0))
    angle = (torch.rand(24, 24, 1, generator=torch.Generator().manual_seed(3), dtype=torch.float64) * 2
             * torch.pi)
    turned = svbrdf["normal"].double() + UNIT_ROUNDOFF * (angle.cos() * first + angle.sin() * second)
    moved = render_and_gradients(TWIN,
                                 SVBRDF("roughconductor", {**svbrdf.to(torch.float64).maps,
                                                           "normal": turned}), THREE)
    shares = {"image": (moved.image - exact.image) / limit.image}
    shares |= {n: (moved.gradients[n] - exact.gradients[n]) / limit.gradients[n] for n in exact.gradients}
    for name, share in shares.items():
        assert float(share.abs().max()) < 1.001, name
        assert float(share.square().mean()) == pytest.approx(0.5, rel=0.1), name


def test_limit_predicts_what_rounded_normals_cost():
    # Normals stored as (n + 1) / 2 in float32, a texture's way: measured 0.25 of the limit on average.
    svbrdf = corner_materials(32)["roughness 0.1"]
    exact, limit = limit_of(svbrdf, GRID)
    stored = ((svbrdf["normal"] + 1) / 2).double() * 2 - 1
    image = TWIN.render(SVBRDF("roughconductor", {**svbrdf.maps, "normal": stored}), GRID)
    measured = image_error(image, exact.image)
    predicted = image_error(exact.image + limit.image, exact.image)
    for name in ("mean", "p99.9"):
        assert 0.1 * predicted[name] < measured[name] < predicted[name]


@pytest.mark.parametrize("bsdf", BOTH)
def test_diffuse_radiance(bsdf):
    views = Views.of(GRID.camera[:2], GRID.camera[:2] + torch.tensor([0.4, 0.0, 0.0]), 10.0)
    svbrdf = as_bsdf(make_material("plates", 16), bsdf).to(torch.float64)
    diffuse = diffuse_radiance(TWIN, svbrdf, views)
    if bsdf == "roughconductor":  # Lambert's closed form, by way of a material that has no other lobe
        wanted = TWIN.render(SVBRDF(bsdf, {**svbrdf.maps, "specular": torch.zeros_like(svbrdf["specular"])}),
                             views)
    else:  # the lobes of dielectric and metal, each alone, are what is left
        def alone(metallic, **maps):
            held = {"metallic": torch.full_like(svbrdf["metallic"], metallic)}
            return TWIN.render(SVBRDF(bsdf, {**svbrdf.maps, **held, **maps}), views)
        metallic = svbrdf["metallic"]
        glass = alone(0.0, base_color=torch.zeros_like(svbrdf["base_color"]))
        wanted = TWIN.render(svbrdf, views) - (1 - metallic) * glass - metallic * alone(1.0)
    # F0 is cut at 1e-6 away from the camera
    assert float((diffuse - wanted).abs().max()) < 1e-5 * float(wanted.max())


def test_worst_texels_are_found_and_placed():
    svbrdf, views = make_material("leather", 16), THREE
    from mitsvbrdf.verify.float32_limits import Truth
    exact, limit = limit_of(svbrdf, views)
    truth = Truth(svbrdf, views, ["a", "b", "c"], exact.image, diffuse_radiance(TWIN, svbrdf, views),
                  limit.image / exact.image)
    image = exact.image.clone()
    image[1, 4, 9, 2] *= 1.5
    image[2, 11, 3, 0] *= 0.8
    image[0, 11, 3, 0] *= 1.1  # the same texel in another view: named once, by its worst
    first, second = worst_texels(truth, image, torch.ones(16, 16, dtype=torch.bool), count=2)
    assert (first["view"], first["row"], first["column"], first["channel"]) == ("b", 4, 9, "b")
    assert first["relative_error"] == pytest.approx(0.5, rel=1e-9) and "not explained" in first["why"]
    assert (second["view"], second["row"], second["column"], second["channel"]) == ("c", 11, 3, "r")
    # Angles by hand: camera and light are at one place, so all three are the angle to the normal.
    at = torch.tensor([(9 + 0.5) / 16 - 0.5, 0.5 - (4 + 0.5) / 16, 0.0], dtype=torch.float64)
    to_light = torch.nn.functional.normalize(views.camera[1] - at, dim=0)
    degrees = math.degrees(math.acos(float(to_light @ svbrdf["normal"][4, 9].double())))
    for name in ("half_vector_angle", "incidence_angle", "camera_angle"):
        # normals are float32: 6e-8 rad, and acos near 1
        assert first[name] == pytest.approx(degrees, abs=1e-3)


@pytest.mark.parametrize("change, words", [
    ({}, "rounding, 2 times"), ({"value": None}, "not finite"), ({"reference": 0.0}, "faces away"),
    ({"relative_error": 1e-4}, "not explained by float32: 839 times"),
    ({"incidence_angle": 89.5}, "grazing, 89.50 degrees"),
    ({"camera_angle": 89.5}, "grazing"), ({"share_of_mean": 1e-5}, "dark: value 1.0e-05 of the mean"),
    ({"specular_share": 0.9, "limit": 3e-6, "roughness": 0.12}, "low roughness 0.12, 4 degrees beside the "
                                                                "mirror direction: "
                                                                "float32 limit 3.0e-06"),
    ({"specular_share": 0.9, "limit": 3e-6, "roughness": 0.5}, "roughness 0.5,")])
def test_why(change, words):
    texel = {"value": 1.0, "reference": 1.0, "relative_error": 2 * UNIT_ROUNDOFF, "share_of_mean": 1.0,
             "roughness": 0.5, "half_vector_angle": 4.0, "incidence_angle": 4.0, "camera_angle": 4.0,
             "specular_share": 0.1, "limit": 2 * UNIT_ROUNDOFF}
    assert words in why(texel | change)
