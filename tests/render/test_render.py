"""Renderers against the float64 twin, the twin against central differences; the replay trap."""

import copy
import math
import pickle
from dataclasses import replace

import pytest
import torch
from helpers import GRID

from mitsvbrdf.errors import CaptureError, ConfigError, MapsError
from mitsvbrdf.material.made import MATERIALS, make_material
from mitsvbrdf.material.maps import CHANNELS, SVBRDF, flat
from mitsvbrdf.measure.gradients import render_and_gradients
from mitsvbrdf.measure.metrics import gradient_error, image_error
from mitsvbrdf.render import RENDERERS, make_renderer
from mitsvbrdf.render.exclusive import using_mitsuba
from mitsvbrdf.render.needs import CONSTANT_FRESNEL_DEGREES, Needs, half_angle_bound, scene_needs
from mitsvbrdf.testing import LIMITS, assert_matches_golden, assert_renderers_agree, random_material
from mitsvbrdf.views import Views, texel_positions

APART = Views.of(GRID.camera, GRID.camera + torch.tensor([0.5, -0.3, 0.1]), GRID.intensity)
PAPER = Views.of(GRID.camera * 5, None, GRID.intensity * 25, size=5.0, falloff="none")
VIEWS = {"co-located": GRID, "apart": APART, "no falloff, cm": PAPER}


class Disturbed:
    """A renderer that is put to other work between forward and backward."""

    def __init__(self, renderer, between):
        self.name, self.renderer, self.between = renderer.name, renderer, between

    def render(self, svbrdf, views):
        image = self.renderer.render(svbrdf, views)
        if torch.is_grad_enabled():
            self.between()
        return image


@pytest.mark.parametrize("bsdf", CHANNELS)
@pytest.mark.parametrize("views", VIEWS)
@pytest.mark.parametrize("name", LIMITS)
def test_agrees_with_float64(name, views, bsdf):
    assert_renderers_agree(random_material(bsdf), VIEWS[views], [name])


@pytest.mark.parametrize("name", [*MATERIALS, "principled"])
def test_the_float64_twin_draws_what_it_drew(name):
    # One view, the light apart. The materials are drawn in float32; with torch's kernels for AVX2, AVX-512
    # and neither of them the pictures agree to 3e-6 of each value, far below the default tolerance.
    material = random_material("principled", 16) if name == "principled" else make_material(name, 16)
    assert_matches_golden(make_renderer("analytic64").render(material, APART.pick([0]))[0], name)


@pytest.mark.parametrize("bsdf", CHANNELS)
def test_float64_gradients_are_central_differences(bsdf):
    renderer, views = make_renderer("analytic64"), APART.pick([1, 4])
    material = random_material(bsdf, 3).to(torch.float64)
    names = list(material.maps)

    def render(*maps):
        return renderer.render(SVBRDF(bsdf, dict(zip(names, maps))), views)

    assert torch.autograd.gradcheck(render, [material[n].requires_grad_() for n in names], eps=1e-6,
                                    atol=1e-5, rtol=1e-3)


@pytest.mark.parametrize("name", ["analytic", "mitsuba"])
def test_gradients_of_positions_and_light(name):
    # Measured: 1.9e-6 at worst.
    def gradients(renderer, dtype):
        geometry = [t.clone().requires_grad_() for t in (APART.camera, APART.light, APART.intensity)]
        image = renderer.render(random_material("roughconductor").to(dtype), Views(*geometry))
        cotangent = torch.randn(image.shape, generator=torch.Generator().manual_seed(1)).to(image)
        return torch.autograd.grad((image * cotangent).sum(), geometry)

    truth = gradients(make_renderer("analytic64"), torch.float64)
    for found, exact in zip(gradients(make_renderer(name), torch.float32), truth):
        assert gradient_error(found, exact)["relative_l2"] < 5e-6


def test_traced_scene_refuses_gradients_it_does_not_carry():
    views = Views(GRID.camera, GRID.light.clone().requires_grad_(), GRID.intensity)
    with pytest.raises(ConfigError, match="views held fixed"):
        make_renderer("mitsuba-scene").render(flat(8), views)


@pytest.mark.parametrize("name", ["mitsuba", "mitsuba-scene"])
@pytest.mark.parametrize("bsdf", CHANNELS)
def test_replay_trap(name, bsdf):
    # Whatever is drawn between a forward and its backward pass, the gradient is that of the forward pass.
    renderer, material, other = make_renderer(name), random_material(bsdf), random_material(bsdf, seed=5)
    two = GRID.pick([0, 1])

    def preview():
        with torch.no_grad():
            renderer.render(other, GRID.pick([7]))

    def other_step():
        render_and_gradients(renderer, other, GRID.pick([3, 4]))

    for between in (preview, other_step, lambda: renderer.render(material, GRID.pick([5]))):
        assert_renderers_agree(material, two, [Disturbed(renderer, between)])


def test_replay_trap_is_real():
    # The guard is needed: Mitsuba's scene, moved between forward and backward, gives another gradient without
    # a word.
    renderer, material = make_renderer("mitsuba-scene"), random_material("roughconductor")
    renderer.render(material, GRID.pick([0]))  # compiles the wrapped function
    (drawing,) = renderer._drawings.values()
    geometry = {i: [t[i:i + 1] for t in (GRID.camera, GRID.light, GRID.intensity)] for i in (0, 4)}

    def gradient(disturbed):
        leaves = [m.clone().requires_grad_() for m in material.maps.values()]
        image = torch.stack(drawing.function.content(*geometry[0], *leaves))
        if disturbed:
            drawing.function.content(*geometry[4], *material.maps.values())
        return torch.autograd.grad(image.sum(), leaves)[0]

    assert gradient_error(gradient(True), gradient(False))["relative_l2"] > 0.05


def test_second_backward_of_a_traced_picture():
    leaves = random_material("roughconductor").map(lambda t: t.clone().requires_grad_())
    image = make_renderer("mitsuba-scene").render(leaves, GRID.pick([0, 1]))
    first = torch.autograd.grad(image.sum(), list(leaves.maps.values()), retain_graph=True)
    again = torch.autograd.grad(image.sum(), list(leaves.maps.values()))
    assert all(map(torch.equal, first, again))  # drawn anew


@pytest.mark.parametrize("name", ["mitsuba", "mitsuba-scene"])
def test_gradients_are_the_same_bits_every_time(name):
    # Of mitsuba-scene two of three were not, in roughness, by 4e-10: Dr.Jit's threads added views up as they
    # came.
    renderer, material = make_renderer(name), random_material("roughconductor", 8)
    first, *others = (render_and_gradients(renderer, material, GRID).gradients for _ in range(8))
    assert all(torch.equal(first[name], other[name]) for name in first for other in others)


def test_more_views_than_one_kernel_holds():
    many = Views.of(torch.cat([GRID.camera, GRID.camera * 1.1, GRID.camera[:2]]), intensity=10.0)
    images = make_renderer("mitsuba").render(random_material("roughconductor"), many)
    exact = make_renderer("analytic64").render(random_material("roughconductor"), many)
    assert images.shape[0] == 20
    assert image_error(images, exact)["mean"] < LIMITS["mitsuba"].image_mean


@pytest.mark.parametrize("name", LIMITS)
def test_made_material_with_global_structure(name):
    assert_renderers_agree(make_material("inlay", 64), GRID, [name])


def test_mitsubas_own_integrators_are_parsed_once_a_variant_and_stay_those_of_the_program():
    import drjit.ast  # Dr.Jit counts what it parses, and warns at 1000: "called by your program".

    with using_mitsuba() as mi:
        renderer, material = make_renderer("mitsuba"), random_material("roughconductor", 8)
        for variant in ("scalar_rgb", "llvm_ad_spectral"):
            mi.set_variant(variant)
            renderer.render(material, GRID.pick([0]))
            parsed = drjit.ast._syntax_counter
            for _ in range(3):
                renderer.render(material, GRID.pick([0]))
            assert drjit.ast._syntax_counter == parsed
        mi.set_variant("llvm_ad_mono")
        renderer.render(material, GRID.pick([0]))
        assert isinstance(mi.load_dict({"type": "prb"}), mi.ad.integrators.common.ADIntegrator)
        mi.set_variant("llvm_ad_rgb")


def test_renderers_live_side_by_side():
    # Dr.Jit traces every BSDF it knows when a ray calls one; those of an idle texel renderer must not mind.
    texels, scene = make_renderer("mitsuba"), make_renderer("mitsuba-scene")
    for _ in range(2):
        for renderer in (texels, scene):
            for bsdf in CHANNELS:
                assert_renderers_agree(random_material(bsdf, 16), GRID.pick([0, 1]), [renderer])


def test_half_angle_bound_is_one():
    # Against the angle at 33 x 33 points of the patch: never below; and no wasteful bound where phones stand.
    g = torch.Generator().manual_seed(0)
    positions = texel_positions(33)
    for spread, slack in ((0.05, 1.05), (3.0, math.inf)):
        for _ in range(100):
            camera = torch.cat((torch.randn(2, generator=g), 0.05 + 3 * torch.rand(1, generator=g))).double()
            light = camera + spread * torch.randn(3, generator=g).double()
            light[2] = light[2].abs() + 0.01
            to_camera, to_light = (torch.nn.functional.normalize(p - positions, dim=-1)
                                   for p in (camera, light))
            across = torch.linalg.cross(to_camera, to_light).norm(dim=-1)
            largest = float(torch.rad2deg(torch.atan2(across, (to_camera * to_light).sum(-1)) / 2).max())
            bound = half_angle_bound(Views.of([camera.tolist()], [light.tolist()]))
            assert bound >= largest
            if camera[2] > 1 and bool((camera[:2].abs() < 0.4).all()) and abs(light[2] - camera[2]) < 0.01:
                assert bound < slack * largest + 0.1
    # one behind the other above the centre, wide apart from its corners
    line = Views.of([[0, 0, 10.0]], [[0, 0, 0.1]])
    assert scene_needs(random_material("roughconductor"), line, "mitsuba").fresnel_curve


def test_needs():
    material = random_material("roughconductor")
    together, apart = (scene_needs(material, v, "mitsuba") for v in (GRID, APART))
    assert not together.fresnel_curve and apart.fresnel_curve
    assert "Fresnel curve" in dict(together.omitted) and "Fresnel curve" not in dict(apart.omitted)
    assert "ray tracing" not in dict(scene_needs(material, GRID, "mitsuba-scene").omitted)


def test_leaving_out_the_fresnel_curve_costs_less_than_it_says():
    # Just under the stated half angle, wherever that lies; F0 down to where the refractive index is cut.
    half = 2 * math.tan(math.radians(0.99 * CONSTANT_FRESNEL_DEGREES))  # of their distance, 2 sides up
    views = Views.of([[-half, 0.0, 2.0]], [[half, 0.0, 2.0]])
    assert half_angle_bound(views) == pytest.approx(0.99 * CONSTANT_FRESNEL_DEGREES, rel=1e-6)
    assert not scene_needs(random_material("roughconductor"), views, "mitsuba").fresnel_curve
    # the truth is not cut short
    assert scene_needs(random_material("roughconductor"), views, "analytic64").fresnel_curve
    for f0 in (1e-4, 0.001, 0.02, 0.04, 0.2, 0.6, 0.95):
        material = flat(8, diffuse=0.0, specular=f0, dtype=torch.float64)
        constant = make_renderer("analytic64", needs=Needs(fresnel_curve=False)).render(material, views)
        assert image_error(constant, make_renderer("analytic64").render(material, views))["worst"] < 5e-7


@pytest.mark.parametrize("name", ["mitsuba", "mitsuba-scene", "analytic"])
def test_faint_reflectance_beside_the_camera_keeps_its_digits(name):
    # Mitsuba's own formula was 9e-3 off at F0 = 1e-6. Measured: 3.8e-7 on average at worst, at F0 = 1.
    for f0 in (1e-6, 1e-4, 0.04, 0.99, 1.0):
        material = flat(16, diffuse=0.0, specular=f0)
        exact = make_renderer("analytic64").render(material, APART)
        assert image_error(make_renderer(name).render(material, APART), exact)["mean"] < 8e-7


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
@pytest.mark.parametrize("name", [*RENDERERS, "analytic64"])
def test_what_is_not_finite_is_refused(name, bad):
    """Mitsuba would draw plausible light of it, with finite gradients."""
    renderer, made = make_renderer(name), random_material("principled", 8)
    for key in made.maps:
        value = made[key].clone()
        value[3, 5, 0] = bad
        wrong = SVBRDF(made.bsdf, dict(made.maps) | {key: value.requires_grad_()})
        with pytest.raises(MapsError, match=rf"finite values, got 1 .* {key}, .*\(3, 5, 0\)"):
            renderer.render(wrong, GRID)
    for key in ("camera", "light", "intensity"):
        value = getattr(GRID, key).clone()
        value[4, 1] = bad
        with pytest.raises(CaptureError, match=f"finite .*, got {key} 4 at"):
            renderer.render(made, replace(GRID, **{key: value}))


@pytest.mark.parametrize("name", [*RENDERERS, "analytic64"])
def test_renderers_can_be_copied_and_pickled(name):
    renderer, made = make_renderer(name), random_material("roughconductor", 8)
    drawn = renderer.render(made, GRID)  # with a kernel of its own by now
    for again in (copy.copy(renderer), copy.deepcopy(renderer), pickle.loads(pickle.dumps(renderer))):
        assert (again.name, again.variant) == (renderer.name, renderer.variant)
        assert torch.equal(again.render(made, GRID), drawn)
