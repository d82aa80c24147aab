"""What float32 can do, against closed forms."""

import math

import pytest
import torch
from helpers import GRID, TWIN
from helpers.crosschecks import THREE

from mitsvbrdf.material.corner_cases import corner_materials
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.measure.gradients import fixed_cotangent, render_and_gradients
from mitsvbrdf.measure.metrics import image_error
from mitsvbrdf.measure.tolerances import UNIT_ROUNDOFF
from mitsvbrdf.verify.float32_limits import float32_limit, turned_normals
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
    moved = render_and_gradients(TWIN, SVBRDF("roughconductor",
                                 {**svbrdf.to(torch.float64).maps, "normal": turned}), THREE)
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
