"""The live viewer in a real Chromium: its pixels are the analytic renderer's."""

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from helpers.viewer_pages import canvas_picture, changed, looked, shown

from mitsvbrdf import color, make_material
from mitsvbrdf.material.maps import CHANNELS, SVBRDF, TITLES, shown_map
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.testing import random_material
from mitsvbrdf.views import Views

# Camera and light: together above the centre; apart; on opposite sides and low, where Fresnel reflectance is
# far from F0.
PLACES = [((0.0, 0.0, 2.0), (0.0, 0.0, 2.0)), ((0.4, -0.3, 1.5), (-0.6, 0.5, 1.0)),
          ((-1.2, 0.3, 0.8), (1.3, -0.2, 0.7))]


def glossy(resolution: int = 64) -> SVBRDF:
    """Highlights of roughness 0.1 on strongly tilted normals."""
    return changed(random_material("roughconductor", resolution), roughness=0.1)


def pixels(page, **options) -> np.ndarray:
    """Row 0 at the top, four values a pixel: bytes, or floats of linear radiance with ``linear``."""
    return looked(page, **options)["data"]


def radiance(svbrdf: SVBRDF, camera, light, intensity: float) -> np.ndarray:
    return AnalyticRenderer(torch.float64).render(svbrdf, Views.of([camera], [light], intensity))[0].numpy()


def bytes_of(linear: np.ndarray) -> np.ndarray:
    return color.to_display(torch.as_tensor(linear), "srgb").numpy() * 255


def worst(page, svbrdf: SVBRDF, places=PLACES, **options) -> float:
    """Largest difference of a pixel from the analytic renderer's, in 1 / 255 of display values."""
    errors = []
    for camera, light in places:
        intensity = 2 * math.pi * sum(x * x for x in light)
        got = pixels(page, camera=camera, light=light, intensity=[intensity] * 3, **options)
        truth = bytes_of(radiance(svbrdf, camera, light, intensity))
        assert 30 < truth.mean() < 245 and (got[..., 3] == 255).all()  # neither black nor clipped
        errors.append(np.abs(got[..., :3] - truth).max())
    return max(errors)


# The viewer's limit is 2 / 255. Rounding to bytes alone is 0.5; measured with all of it: 0.55 at most.
LIMIT = 1.0


# Lower still, where the 3e-5 rad of a normal's 16 bits show. Measured: 1.1.
LOWEST = [((-2.0, 0.0, 0.4), (2.0, 0.1, 0.35))]


@pytest.mark.slow
@pytest.mark.parametrize("material", [
    make_material("inlay", 96), make_material("leather", 96), make_material("plates", 96),
    random_material("roughconductor", 64), random_material("principled", 64), glossy(),
], ids=["inlay", "leather", "plates", "random", "principled", "glossy"])
def test_pixels_are_the_analytic_renderer_s(material, tmp_path):
    with shown(material, tmp_path) as page:
        assert worst(page, material) < LIMIT
        assert worst(page, material, LOWEST) < 2


@pytest.mark.slow
def test_sliders_and_toggles_change_what_they_say(tmp_path):
    material = make_material("inlay", 64)
    camera, light = PLACES[1]
    where = {"camera": camera, "light": light, "linear": True}
    with shown(material, tmp_path) as page:
        before = pixels(page, **where)[..., :3]
        page.get_by_role("slider", name="Exposure").fill("1")
        # A multiplication by 2 is exact in floats.
        assert before.mean() > 0.05 and np.array_equal(pixels(page, **where)[..., :3], 2 * before)
        page.get_by_role("button", name="Reset").click()
        assert np.array_equal(pixels(page, **where)[..., :3], before)

        page.get_by_role("slider", name="Roughness scale").fill("2")
        assert worst(page, changed(material, roughness=(2 * material["roughness"]).clamp_max(1))) < LIMIT
        page.get_by_role("slider", name="Roughness scale").fill("0.5")
        # as narrow as 0.065; measured 1.0
        assert worst(page, changed(material, roughness=material["roughness"] / 2)) < 2
        page.get_by_role("button", name="Reset").click()

        off = {"diffuse": 0.0, "specular": 0.0, "roughness": 0.5, "normal": torch.tensor([0.0, 0.0, 1.0])}
        for name, value in off.items():
            box = page.get_by_role("checkbox", name=TITLES[name])
            box.uncheck()
            without = changed(material, **{name: value})
            assert worst(page, without) < LIMIT, name
            apart = np.abs(radiance(without, camera, light, 1.0) - radiance(material, camera, light, 1.0))
            assert apart.max() > 1e-3, name  # or the line above would say nothing
            box.check()
        assert worst(page, material) < LIMIT


@pytest.mark.slow
def test_toggles_of_principled_materials(tmp_path):
    material = random_material("principled", 48)
    off = {"base_color": 0.0, "metallic": 0.0, "roughness": 0.5, "normal": torch.tensor([0.0, 0.0, 1.0])}
    with shown(material, tmp_path) as page:
        for name, value in off.items():
            page.get_by_role("checkbox", name=TITLES[name]).uncheck()
            assert worst(page, changed(material, **{name: value}), PLACES[2:]) < LIMIT, name
            page.get_by_role("checkbox", name=TITLES[name]).check()


@pytest.mark.slow
@pytest.mark.parametrize("bsdf", ["roughconductor", "principled"])
def test_each_map_can_be_looked_at_alone(bsdf, tmp_path):
    material = random_material(bsdf, 32)
    with shown(material, tmp_path) as page:
        for name in CHANNELS[bsdf]:
            page.get_by_role("radio", name=TITLES[name]).check()
            truth = shown_map(name, material[name].double()).expand(-1, -1, 3).numpy() * 255
            # rounding is 0.5, 12 bits of colour the rest
            assert np.abs(pixels(page)[..., :3] - truth).max() < 0.6, name
            assert page.get_by_role("slider", name="Exposure").is_disabled()
        page.get_by_role("radio", name="Lit").check()
        assert page.get_by_role("slider", name="Exposure").is_enabled()


def expected_at(svbrdf: SVBRDF, look: dict, row: int, column: int, surface: str,
                tiles: int) -> np.ndarray | None:
    """Linear radiance where this pixel's ray meets patch or sphere, in float64; None where it meets nothing.

    The point becomes a material of one texel, seen and lit from where camera and light stand in the frame of
    its surface.
    """
    right, up, back = np.array(look["axes"])
    camera, light = np.array(look["camera"]), np.array(look["light"])
    x, y = 2 * (column + 0.5) / look["size"] - 1, 1 - 2 * (row + 0.5) / look["size"]
    ray = x * right + y * up - look["zoom"] * back
    if surface == "patch":
        point, frame = camera - ray * camera[2] / ray[2], np.eye(3)
        if max(abs(point[:2])) > 0.5:
            return None
        u, v = point[0] + 0.5, 0.5 - point[1]
    else:
        roots = np.roots([ray @ ray, 2 * ray @ camera, camera @ camera - 0.25])
        if abs(roots.imag).max() > 0:
            return None
        point = camera + roots.real.min() * ray
        lon, lat = math.atan2(point[0], point[2]), math.asin(point[1] / 0.5)
        u, v = lon / math.pi + 0.5, 0.5 - lat / math.pi
        # the derivatives of the point by longitude and latitude
        frame = np.array([[math.cos(lon), 0, -math.sin(lon)],
                          [-math.sin(lat) * math.sin(lon), math.cos(lat), -math.sin(lat) * math.cos(lon)],
                          [math.cos(lat) * math.sin(lon), math.sin(lat), math.cos(lat) * math.cos(lon)]])
    u, v, flip = u * tiles, v * tiles, torch.ones(3)
    if surface == "sphere":  # every other tile is mirrored
        flip[:2] = torch.tensor([1.0 - 2 * (math.floor(u) % 2), 1.0 - 2 * (math.floor(v) % 2)])
    u, v = (1 - x % 1 if math.floor(x) % 2 and surface == "sphere" else x % 1 for x in (u, v))
    at = torch.tensor([[[[u, v]]]], dtype=torch.float64) * 2 - 1
    texel = svbrdf.to(torch.float64).map(lambda value: F.grid_sample(
        value.permute(2, 0, 1)[None], at, padding_mode="border", align_corners=False)[0].permute(1, 2, 0))
    texel = changed(texel, normal=F.normalize(texel["normal"] * flip, dim=-1))
    to_camera, to_light = frame @ (camera - point), frame @ (light - point)
    normal = texel["normal"].reshape(3).numpy()
    if surface == "sphere" and min(to_light[2], normal @ to_camera) <= 0 < normal @ to_light:
        return np.full(3, np.nan)  # the viewer leaves no holes there
    return (np.zeros(3) if to_light[2] <= 0
            else radiance(texel, to_camera.tolist(), to_light.tolist(), look["intensity"])[0, 0])


@pytest.mark.slow
@pytest.mark.parametrize("surface, tiles, turn", [("patch", 1, (0, 0)), ("patch", 2, (35, -40)),
                                                  ("sphere", 1, (0, 0)), ("sphere", 3, (-60, 30))])
def test_patch_and_sphere_at_single_points(surface, tiles, turn, tmp_path):
    material = make_material("inlay", 64)
    with shown(material, tmp_path) as page:
        options = {"view": surface, "tiles": tiles, "turn": turn, "size": 40, "light": [0.5, -0.4, 0.8],
                   "intensity": [6.0] * 3}
        look = looked(page, linear=True, **options) | {"intensity": 6.0}
    met = bright = filled = 0
    for row in range(1, 40, 3):
        for column in range(1, 40, 3):
            truth, got = expected_at(material, look, row, column, surface, tiles), look["data"][row, column]
            if truth is None:
                assert not got.any()
                continue
            assert got[3] == 1
            if np.isnan(truth).any():
                assert (got[:3] > 0).all()
                filled += 1
                continue
            # In bytes. Float32 places a point to 1e-7; at steps of steep maps that makes 0.2.
            assert np.abs(bytes_of(got[:3]) - bytes_of(truth)).max() < 0.5, (row, column)
            met, bright = met + 1, bright + (truth.max() > 0.02)
    assert met > 50 and bright > 30 and (filled > 0) == (tiles == 3)


@pytest.mark.slow
def test_the_canvas_shows_what_the_state_says(tmp_path):
    with shown(make_material("inlay", 64), tmp_path) as page:
        for change in ({}, {"light": [-0.5, 0.2, 0.6]}, {"surface": "sphere"}, {"show": "normal"}):
            page.evaluate("change => mitsvbrdfViewer.set(change)", change)
            seen, state = canvas_picture(page), page.evaluate("mitsvbrdfViewer.state")
            side = page.evaluate("document.querySelector('canvas').width")
            drawn = pixels(page, view=state["surface"], size=side, samples=3)
            assert seen.shape == (side, side, 3)
            full = drawn[..., 3] == 255
            assert 0.5 < full.mean() < 0.99 and np.abs(seen - drawn[..., :3])[full].max() <= 1
