"""The simulated phone's pictures and its lens."""

import numpy as np
import pytest
import torch
from helpers.phones import SMALL

from mitsvbrdf import color, make_material, make_renderer
from mitsvbrdf.capture.lens import Lens, Pose, on_plane, project
from mitsvbrdf.capture.rectify import rectified
from mitsvbrdf.material.maps import flat
from mitsvbrdf.synth import traced
from mitsvbrdf.synth.phone import HandheldPhone
from mitsvbrdf.synth.photos import developed
from mitsvbrdf.synth.traced import HandheldRenderer
from mitsvbrdf.views import Views

DOWN = np.diag([1.0, -1.0, -1.0])


def frontal(side: float, resolution: int, position, flash) -> tuple[Lens, Pose]:
    """A camera that looks straight down and whose pixels are the texels of a sample."""
    focal = resolution * position[2] / side
    centre = tuple((resolution - 1) / 2 + focal / position[2] * np.array((position[0], -position[1])))
    return Lens((resolution, resolution), focal, centre, flash=flash), Pose(np.array(position), DOWN)


@pytest.mark.parametrize("material", ["inlay", "principled"])
def test_the_scene_is_the_analytic_renderers(material):
    """Pixels that are texels, camera and flash apart: no resampling is left between the two."""
    maps = make_material("inlay", 48)
    if material == "principled":
        base = {"base_color": maps["diffuse"], "metallic": 1 - maps["roughness"]}
        maps = type(maps)("principled", base | {name: maps[name] for name in ("roughness", "normal")})
    lens, pose = frontal(12.0, 48, (1.5, -2.0, 23.0), (1.5, 0.4, -0.2))
    np.testing.assert_allclose(pose.flash(lens), (3.0, -2.4, 23.2))
    seen = HandheldRenderer(maps, 12.0, samples=1).render(lens, pose, intensity=700.0)
    views = Views.of([pose.position.tolist()], [pose.flash(lens).tolist()], 700.0, size=12.0)
    truth = make_renderer("analytic64").render(maps, views)[0].numpy()
    # Measured: 3.6e-6 of the brightest, 1.8e-6 of the mean
    assert np.abs(seen - truth).max() < 2e-5 * truth.max() and np.abs(
        seen - truth).mean() < 1e-5 * truth.mean()


def test_rays_go_where_the_lens_says():
    """Diffuse dots, tilted, turned, distorted, in closed form: tents of texels under cos / d^2."""
    maps, side, power = flat(64, diffuse=0.0, specular=0.0), 20.0, 1000.0
    at = [(5, 7), (60, 4), (31, 33), (8, 58), (50, 55)]
    for row, column in at:
        maps["diffuse"][row, column] = 1.0
    lens = Lens((400, 300), 250.0, (203.0, 146.0), (0.2, -0.1), flash=(1.0, 0.0, 0.0))
    pose = Pose.looking_at((3.0, -4.0, 22.0), (0.5, 0.3, 0), 0.4)
    seen = HandheldRenderer(maps, side, samples=1).render(lens, pose, intensity=power)[..., 0]
    pixels = np.stack(np.meshgrid(np.arange(400.0), np.arange(300.0)), axis=-1).reshape(-1, 2)
    points = np.column_stack((on_plane(lens, pose, pixels), np.zeros(len(pixels))))
    np.testing.assert_allclose(project(lens, pose, points), pixels, atol=1e-9)
    texels = np.array([((c + 0.5) / 64 - 0.5, 0.5 - (r + 0.5) / 64) for r, c in at]) * side
    tents = sum(np.prod(np.clip(1 - np.abs(points[:, :2] - texel) * 64 / side, 0, None), axis=1)
                for texel in texels)
    light = pose.flash(lens) - points
    truth = (tents / np.pi * power * light[:, 2] / np.linalg.norm(light, axis=1) ** 3).reshape(300, 400)
    dots = truth > 0
    assert dots.sum() > 250  # pixels
    # Measured: 1.2e-5 of the brightest; a hundredth of a pixel is 2e-3
    assert np.abs(seen - truth)[dots].max() < 1e-4 * truth.max()


def test_blocks_of_rows_leave_no_seam(monkeypatch):
    maps = make_material("leather", 32)
    lens, pose = SMALL.lens, Pose.looking_at((1, 2, 25), (0, 0, 0), 0.1)
    whole = HandheldRenderer(maps, 24.0, samples=1).render(lens, pose, intensity=500.0)
    monkeypatch.setattr(traced, "MOST_RAYS", 37 * lens.size[0])
    blocks = HandheldRenderer(maps, 24.0, samples=1).render(lens, pose, intensity=500.0)
    # Positions on the film are float32, rounded otherwise in a block: 1e-4 of a pixel, so 1e-4 or so of an
    # edge.
    assert np.abs(blocks - whole).max() < 2e-3 and np.abs(blocks - whole).mean() < 1e-6


def test_a_photo_rectified_shows_what_the_analytic_renderer_says():
    """Distortion, tilt, turn, flash, vignetting and sRGB, there and back."""
    maps, phone = make_material("leather", 8).resized(128), HandheldPhone(megapixels=1.0, side=12.0, grain=0)
    lens, pose = phone.lens, Pose.looking_at((2.0, -3.0, 20.0), (0.3, 0.4, 0), 0.2)
    power = 600.0
    pixels = developed(HandheldRenderer(maps, 12.0).render(lens, pose, intensity=power), lens, 0)
    points = (np.array([[x, y, 0.0] for y in (np.arange(64)[::-1] - 31.5) for x in (np.arange(64) - 31.5)])
              * 12.0 / 64)
    transmission = lens.transmission(project(lens, pose, points)).reshape(64, 64, 1)
    seen = (color.decode(torch.from_numpy(rectified(pixels, lens, pose, 12.0, 64)), "srgb").numpy()
            / transmission)
    views = Views.of([pose.position.tolist()], [pose.flash(lens).tolist()], power, size=12.0)
    truth = make_renderer("analytic64").render(maps, views)[0].numpy().clip(0, 1).reshape(
        64, 2, 64, 2, 3).mean(axis=(1, 3))
    inner = slice(1, -1)  # the outermost texels have the table beside them
    error = np.sqrt(np.square(seen - truth)[inner, inner].mean()) / truth.mean()
    assert error < 0.01  # measured: 0.0032, of 8 bits; with the vignetting of the photo left in 0.2
