"""What texels share: highlights of look-alikes, and how far they may go alone."""

import math

import pytest
import torch
import torch.nn.functional as F
from helpers import MITSUBA, photos_of
from helpers.hierarchical_fits import SIDE, method_of, reached
from helpers.variants import mostly_slow

from mitsvbrdf import color
from mitsvbrdf.fit import HierarchicalConfig, fit_svbrdf
from mitsvbrdf.fit.hierarchical import stages
from mitsvbrdf.fit.hierarchical.stages import Stage
from mitsvbrdf.fit.hierarchical.texel_prior import VAGUE
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.measure.burn_in import cubic, explained_share
from mitsvbrdf.views import Views, coverage_angle, texel_positions


def striped():
    """Two paints in stripes; the photos' highlights all lie left, none reaches the right columns."""
    stripe = ((torch.arange(SIDE) // 4) % 2 == 0).float()[:, None, None].expand(SIDE, SIDE, 1)
    truth = SVBRDF("roughconductor", {
        "diffuse": stripe * torch.tensor([0.4, 0.1, 0.05]) + (1 - stripe) * torch.tensor([0.05, 0.1, 0.4]),
        "specular": (0.04 * stripe + 0.06 * (1 - stripe)).expand(SIDE, SIDE, 3).contiguous(),
        "roughness": 0.25 * stripe + 0.35 * (1 - stripe), "normal": flat(SIDE)["normal"]})
    views = Views.of([[-0.5, 0.0, 1.5], [-0.4, 0.3, 1.5], [-0.45, -0.3, 1.5], [-0.3, 0.2, 1.6],
                      [-0.35, -0.1, 1.5]], intensity=math.pi * 1.5**2)
    return stripe[..., 0] > 0, truth, photos_of(truth, views)


# Measured: up to 0.013 (exact) and 0.003 (phone); alone 0.061 and 0.084, and worse by 5 times on average.
@pytest.mark.parametrize("kind", mostly_slow(["exact", "phone"], "phone"))
def test_a_highlight_that_no_photo_shows_is_that_of_look_alikes(kind, monkeypatch):
    if kind == "phone":
        monkeypatch.setattr(stages, "EXACT", 0.0)
    stripe, truth, shots = striped()
    unseen = torch.zeros(SIDE, SIDE, dtype=torch.bool)
    unseen[:, -8:] = True
    assert coverage_angle(shots.views, SIDE)[unseen].min() > math.radians(16)  # many widths of either lobe
    found = fit_svbrdf(shots, MITSUBA, HierarchicalConfig()).svbrdf
    off = torch.cat((color.encode(found["specular"]) - color.encode(truth["specular"]),
                     found["roughness"] - truth["roughness"]), dim=-1)
    for stuff in (stripe, ~stripe):
        assert off[unseen & stuff][:, [0, 3]].square().mean(dim=0).sqrt().max() < 0.025


def test_independent_weakens_a_cubic_trend_and_leaves_the_pattern(capture, phone, monkeypatch):
    method = method_of(capture)
    method.stages.unexplained = torch.tensor([0.02, 0.02])
    method.stages.enter(Stage.FINE)
    assert method.stages.tied
    angle = coverage_angle(capture.views, SIDE)
    pattern = torch.rand(2, SIDE, SIDE, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 0.2
    # has no trend at all
    pattern = pattern - torch.cat([*cubic(angle.flatten(), pattern.flatten(1))], 1).reshape(pattern.shape)
    a = angle / angle.max()
    trend = torch.stack((0.3 - 0.8 * a + 0.4 * a**2, 0.1 + 0.6 * a**3))
    given = (pattern + trend).float()

    # By hand: how near a photo's mirror direction the texel lies, in lobe widths of twice alpha, whatever the
    # photo.
    place = texel_positions(SIDE)
    to_camera = F.normalize(capture.views.camera[:, None, None] - place, dim=-1)
    tan2 = 1 / to_camera[..., 2] ** 2 - 1
    alpha = method.scale.solver.svbrdf(method.answer.mean)["roughness"][..., 0] ** 2
    trust = (1 / (1 + tan2 / (2 * alpha) ** 2)).clamp_min(0.03).amax(dim=0)
    # Pattern and trend are uncorrelated, so of the variance k^2 |trend|^2 + |pattern|^2 the first is 8 % for
    # this k.
    size = [(t - t.mean()).square().mean().sqrt() for t in (*trend, *pattern)]
    kept = torch.tensor([(0.08 / 0.92) ** 0.5 * size[2 + i] / size[i] for i in range(2)])[:, None, None]
    out = (1 - kept) * trend
    level = (trust * out).sum(dim=(1, 2), keepdim=True) / trust.sum()

    def corrected(planes):
        return method.seen.without_burn_in(planes, method.scale, method.answer)

    found = corrected(given)
    # float32 of numbers up to 1
    assert torch.allclose(found, (pattern + trend - out + level).float(), atol=1e-5)
    assert all(explained_share(p, angle) > 0.4 for p in given)
    assert all(abs(explained_share(p, angle) - 0.08) < 1e-4 for p in found)
    # A trend that is less than CHANCE of the variance is the material's own, and nothing is done to it.
    slight = (pattern + 0.01 * a).float()
    assert 1e-4 < min(explained_share(p, angle) for p in slight) and torch.equal(corrected(slight), slight)
    monkeypatch.setattr(stages, "EXACT", 0.021)
    assert method.stages.exact and torch.equal(corrected(given), given)


def striped_material():
    """Left half dark, right half bright; everything else alike."""
    material = make_material("leather", SIDE)
    diffuse = torch.full_like(material["diffuse"], 0.05)
    diffuse[:, SIDE // 2:] = 0.5
    return SVBRDF(material.bsdf, {**material.maps, "diffuse": diffuse})


def test_enlarged_maps_follow_the_look_alikes(two_stages, phone):
    method = method_of(photos_of(striped_material()), materials=2)
    coarse, fine, shared = method.scales.of(Stage.TOGETHER), method.scales.of(Stage.FINE), method.prior.shared
    bright = torch.zeros(SIDE // 2, SIDE // 2)
    bright[:, SIDE // 4:] = 1
    level, off = torch.tensor([0.2, 0.3, 0.4, 0.5]), torch.tensor([0.3, 0.2, 0.1, 0.25])
    # within each stuff, so that is kept beside it
    ramp = torch.linspace(-0.1, 0.1, SIDE // 2)[:, None].expand(-1, SIDE // 2)
    method.answer.x[shared] = level[:, None, None] + off[:, None, None] * bright + ramp
    found = method.prior.enlarge(method.answer, coarse, fine, tied=True)
    bright = torch.zeros(SIDE, SIDE)
    bright[:, SIDE // 2:] = 1
    ramp = F.interpolate(ramp[None, None], (SIDE, SIDE), mode="bilinear")[0, 0]
    # Looks differ by more than ten widths, so a texel is of one stuff only; bilinear enlarging is off by a
    # quarter of the step.
    assert torch.allclose(found.x[shared], level[:, None, None] + off[:, None, None] * bright + ramp,
                          atol=1e-5)


def deviations_of(method, answer):
    """Standard deviation of the prior of each map, from its last number."""
    return {name: float(answer.precision[i].mean() ** -0.5)
            for i, name in enumerate(method.prior.unknowns.names)}


@pytest.mark.parametrize("went, normal, specular", [(0.0, 0.05, 0.06), (0.05, 0.07071, 0.07071),
                                                    (0.5, 0.15, 0.15)])
def test_texels_may_go_as_far_as_they_went(went, normal, specular, capture):
    """Deviations: root mean square of the distance gone and of what is left unknown, within bounds."""
    method = method_of(capture, detail_spread=0.06)
    free, unknown = method.prior.free(method.answer), 0.05
    sign = torch.where(torch.rand(free.x.shape, generator=torch.Generator().manual_seed(1)) < 0.5, -1.0, 1.0)
    loose = method.prior.loosen(free._replace(x=free.mean + sign * went), torch.full_like(free.x, unknown**2))
    deviation = deviations_of(method, loose)
    assert deviation["normal"] == pytest.approx(normal, rel=1e-4)
    assert deviation["specular"] == pytest.approx(specular, rel=1e-4)
    assert deviation["diffuse"] == pytest.approx(VAGUE["diffuse"])


@pytest.mark.slow
def test_at_full_size_texels_are_free_and_pixels_alike(two_stages, phone, capture):
    method = reached(Stage.TOGETHER, method_of(capture))
    seen = method.seen.observations(method.scale, method.answer)
    assert seen.weights is not None and seen.robust == pytest.approx(3 * 0.03)
    reached(Stage.FINE, method)
    seen = method.seen.observations(method.scale, method.answer)
    assert seen.weights is None and seen.robust == pytest.approx(10 * float(method.stages.detail))
    # The first round has loosened them: normals by what this leather needs, the others by their start at
    # least.
    deviation = deviations_of(method, method.answer)
    assert 0.0102 <= deviation["normal"] <= 0.15 and deviation["specular"] >= 0.0599 and deviation[
        "roughness"] >= 0.0299
    answer, slopes = method.answer, method.prior.slopes
    assert (answer.x - answer.mean)[slopes].abs().max() > 1e-3 and answer.mean[slopes].abs().max() > 1e-3


def test_what_comes_out_follows_no_highlights(two_stages, phone, capture):
    """Also where the fit ends before full size; the maps themselves do, by far."""
    method = method_of(capture, detail_spread=0.06)
    angle = coverage_angle(capture.views, SIDE)
    roughness = method.prior.unknowns.of("roughness")
    for stage in (Stage.TOGETHER, Stage.FINE):
        method.stages.enter(stage)
        method.scale = method.scales.of(stage, free=stage == Stage.FINE)
        x = method.start().x
        lie = F.interpolate(angle[None, None].float(), x.shape[1:], mode="area")[0, 0]
        x[roughness] = (x[roughness] + 3 * (lie - lie.mean())).clamp(0.05, 1)
        method.answer = method.start()._replace(x=x, mean=x.clone())
        assert explained_share(x[roughness][0].double(), lie.double()) > 0.5
        svbrdf, _ = method.estimate()
        assert svbrdf.resolution == SIDE and explained_share(svbrdf["roughness"][..., 0].double(),
                                                             angle) < 0.1
