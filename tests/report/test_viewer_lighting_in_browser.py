"""The live viewer in its studio, in a real Chromium: against a sum over all directions in float64."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from helpers.viewer_pages import canvas_picture, changed, looked, shown

from mitsvbrdf import make_material
from mitsvbrdf.material.maps import flat
from mitsvbrdf.relight import environment
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.report import viewer_lighting
from mitsvbrdf.testing import random_material
from mitsvbrdf.views import Views

FAR = 1e4  # of the lights that stand for directions


def summed(svbrdf, camera, turn: float, rows: int = 192) -> np.ndarray:
    """Radiance of each texel, light from each of rows x 2 rows directions rendered for itself."""
    picture = (environment.studio(192) * viewer_lighting._scale()).permute(2, 0, 1)[None]
    picture = torch.cat((picture[..., -1:], picture, picture[..., :1]), dim=-1)  # around the back
    d = environment.directions(rows, 2 * rows).reshape(-1, 3)
    u, v = torch.atan2(d[:, 0], d[:, 1]) / (2 * math.pi) + 0.5, torch.acos(d[:, 2].clamp(-1, 1)) / math.pi
    width, height = picture.shape[-1], picture.shape[-2]
    at = torch.stack(((u * (width - 2) + 1) / width * 2 - 1, (v * (height - 1) + 0.5) / height * 2 - 1),
                     dim=-1)
    light = F.grid_sample(picture, at[None, None], align_corners=False, padding_mode="border")[0, :, 0].T
    solid = math.pi / (rows - 1) * math.pi / rows * (1 - d[:, 2] ** 2).clamp_min(0).sqrt()
    # From the studio's right, ahead, up to the viewer's right, up, back; the studio turns about up.
    cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    x, y = cos * d[:, 0] + sin * d[:, 1], -sin * d[:, 0] + cos * d[:, 1]
    here = torch.stack((x, d[:, 2], -y), dim=-1)
    above = (here[:, 2] > 1e-3) & (solid > 0)
    here, power = here[above] * FAR, (light * solid[:, None])[above] * FAR**2
    total = 0
    for some, its in zip(here.split(4096), power.split(4096)):
        views = Views.of([camera] * len(some), some.tolist(), its.tolist())
        total = total + AnalyticRenderer(torch.float64).render(svbrdf, views).sum(0)
    return total.numpy()


def uniform(roughness: float, specular: float, tilt=(0.0, 0.0)):
    normal = F.normalize(torch.tensor([*tilt, 1.0]), dim=0)
    return changed(flat(4), diffuse=torch.tensor([0.4, 0.2, 0.1]), specular=specular, roughness=roughness,
                   normal=normal)


ASLANT = ((0.8, -0.9, 1.1), 50.0)  # camera 48 degrees from the normal, and by how much the studio is turned
FACING = ((0.0, 0.0, 2.0), 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("material, facing, aslant", [
    # Measured: the mean's error facing and aslant. Split sums are this far from the integral.
    (uniform(0.7, 0.0), 0.012, 0.001), (uniform(0.2, 0.6), 0.011, 0.038),
    (uniform(0.35, 0.04, (0.3, 0.2)), 0.008, 0.061), (uniform(0.35, 0.9), 0.030, 0.048),
    (uniform(0.7, 0.9), 0.027, 0.296), (random_material("principled", 4), 0.037, 0.052),
], ids=["diffuse", "gloss", "dielectric", "metal", "rough metal", "principled"])
def test_radiance_is_the_sum_over_all_directions(material, facing, aslant, tmp_path):
    with shown(material, tmp_path) as page:
        for (camera, turn), limit in ((FACING, facing), (ASLANT, aslant)):
            got = looked(page, view="rectified", lighting="studio", studio=turn, camera=list(camera),
                         linear=True)["data"]
            assert got[..., :3].mean() == pytest.approx(summed(material, camera, turn).mean(),
                                                        rel=limit + 0.01)


@pytest.mark.slow
def test_the_studio_is_chosen_turned_and_left_again(tmp_path):
    with shown(make_material("leather", 32), tmp_path, width=1280) as page:
        point = canvas_picture(page)
        page.get_by_role("radio", name="Studio").check()
        assert page.get_by_role("slider", name="Light height").is_disabled()
        page.mouse.move(5, 5)
        still = canvas_picture(page)
        assert np.abs(still - point).mean() > 2 and still.std() > 5
        box = page.locator("canvas").bounding_box()
        page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 0.5 * box["height"])
        assert page.evaluate("mitsvbrdfViewer.state.studio") == pytest.approx(45, abs=0.3)
        assert "Studio 45°" in page.locator(".status").inner_text()
        assert np.abs(canvas_picture(page) - still).mean() > 1
        page.locator("canvas").focus()
        for _ in range(28):
            page.keyboard.press("ArrowRight")
        assert page.evaluate("mitsvbrdfViewer.state.studio") == pytest.approx(-175, abs=0.3)  # it goes around
        page.get_by_role("button", name="Reset").click()
        assert np.array_equal(canvas_picture(page), point)


@pytest.mark.slow
def test_a_bumpy_sphere_in_the_studio_has_no_holes(tmp_path):
    with shown(changed(random_material("roughconductor", 32), diffuse=0.8), tmp_path) as page:
        got = looked(page, view="sphere", lighting="studio", size=120, linear=True)["data"]
    inside = got[got[..., 3] == 1]
    assert len(inside) > 9000 and inside[:, :3].min() > 0.01
