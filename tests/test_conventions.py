"""Pins docs/conventions.md, line by line, with closed forms and files made elsewhere."""

import functools
import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from helpers import GRID, ROOT, TWIN

from mitsvbrdf import color
from mitsvbrdf.capture import read_capture, write_capture
from mitsvbrdf.capture.capture import Capture
from mitsvbrdf.errors import CaptureError, MapsError
from mitsvbrdf.material.map_files import load_maps, save_maps
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.material.maps import flat as flat_of
from mitsvbrdf.material.resample import area_averaged, averaged_rows
from mitsvbrdf.views import Views, texel_positions

flat = functools.partial(flat_of, dtype=torch.float64)


def one(svbrdf, camera, light=None, intensity=1.0, **options):
    """The linear image of one view in float64."""
    views = Views.of([camera], None if light is None else [light], intensity, **options)
    return TWIN.render(svbrdf.to(torch.float64), views)[0]


def test_every_line_names_a_test_that_exists():
    text = (ROOT / "docs/conventions.md").read_text()
    here = Path(__file__).read_text()
    for name in re.findall(r"`(test_\w+)`", text):
        assert f"def {name}(" in here, name
    for path in re.findall(r"`(tests/[\w/]+\.py)`", text):
        assert (ROOT / path).is_file(), path


def test_texel_positions():
    p = texel_positions(4)
    assert p[0, 0].tolist() == [-0.375, 0.375, 0.0]
    assert p[3, 1].tolist() == [-0.125, -0.375, 0.0]


def test_views_above_the_plane():
    with pytest.raises(CaptureError, match="above the plane"):
        Views.of([[0, 0, -1.0]])


def test_row_zero_is_the_top():
    # A light over the top edge brightens row 0 most; one over the right edge the last column.
    top = one(flat(8, specular=0.0), (0, 0.5, 0.7))
    right = one(flat(8, specular=0.0), (0.5, 0, 0.7))
    assert top[0].mean() > 1.5 * top[-1].mean()
    assert right[:, -1].mean() > 1.5 * right[:, 0].mean()


def test_unit_of_length_does_not_matter():
    a = one(flat(8), (0.2, 0.3, 2.0), (0.3, 0.3, 2.0), 5.0)
    b = one(flat(8), (2.0, 3.0, 20.0), (3.0, 3.0, 20.0), 500.0, size=10.0)
    assert torch.allclose(a, b, rtol=1e-12)


def test_light_defaults_to_the_camera():
    views = Views.of([[0.1, 0.2, 3.0]])
    assert torch.equal(views.light, views.camera)


def test_map_shapes():
    with pytest.raises(MapsError, match="height x width x channels"):
        SVBRDF("roughconductor", {k: v.permute(2, 0, 1) for k, v in flat(8).maps.items()})


def test_white_diffuse_radiance():
    # I / (pi d^2) straight below the light; the centre of an odd map lies exactly there.
    image = one(flat(9, diffuse=1.0, specular=0.0), (0, 0, 2.5), intensity=7.0)
    assert image[4, 4, 0].item() == pytest.approx(7 / (math.pi * 2.5**2), rel=1e-12)


def test_mirror_peak():
    # n = h = l = v: D = 1 / (pi alpha^2), G = 1, so f = F0 / (4 pi r^4); radiance f I / d^2.
    image = one(flat(9, diffuse=0.0, specular=0.3, roughness=0.4), (0, 0, 2.0), intensity=3.0)
    assert image[4, 4, 1].item() == pytest.approx(0.3 / (4 * math.pi * 0.4**4) * 3 / 4, rel=1e-12)


def test_normal_leans_up():
    # A normal that leans towards +y is brighter for a light over the top than for one over the bottom.
    leaning = flat(8, specular=0.0)
    normal = torch.tensor([0.0, 0.5, math.sqrt(0.75)]).expand(8, 8, 3)
    leaning = SVBRDF("roughconductor", dict(leaning.maps) | {"normal": normal})
    assert one(leaning, (0, 1, 1)).mean() > 2 * one(leaning, (0, -1, 1)).mean()


def test_files_round_trip(tmp_path):
    generator = torch.Generator().manual_seed(0)
    maps = {k: torch.rand(v.shape, generator=generator) * 0.8 + 0.1 for k, v in flat(8).maps.items()}
    maps["normal"] = torch.nn.functional.normalize(maps["normal"] - torch.tensor([0.5, 0.5, 0.0]), dim=-1)
    material = SVBRDF("roughconductor", maps)
    save_maps(material, tmp_path / "maps")
    for name, value in load_maps(tmp_path).maps.items():
        assert torch.allclose(value, material[name], atol=1e-6), name  # float32 EXR; normals pass (n + 1) / 2
    for path in (tmp_path / "maps").glob("*.exr"):
        path.unlink()
    for name, value in load_maps(tmp_path).maps.items():
        # 16 bits: half a step of 1 / 65535, times at most 2.2 for the slope of sRGB, 2 for the normals.
        assert torch.allclose(value, material[name], atol=2.2 / 65535), name
    # sRGB of linear 0.5 is 0.735357 (IEC 61966-2-1), seen with another reader.
    save_maps(flat(8, diffuse=0.5), tmp_path / "half")
    pixel = cv2.imread(str(tmp_path / "half/diffuse.png"), cv2.IMREAD_UNCHANGED)[0, 0, 0]
    assert pixel / 65535 == pytest.approx(0.735357, abs=2e-5)


def test_foreign_files_are_gamma(tmp_path):
    for name in ("diffuse", "specular", "roughness"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((8, 8, 3), 128, np.uint8))
    cv2.imwrite(str(tmp_path / "normal.png"), np.full((8, 8, 3), (255, 128, 128), np.uint8))
    material = load_maps(tmp_path)
    for name in ("diffuse", "specular", "roughness"):
        assert material[name][0, 0, 0].item() == pytest.approx((128 / 255) ** 2.2, rel=1e-5)


def test_no_falloff():
    generous = one(flat(8, specular=0.0), (0.3, 0.4, 1.0), intensity=2.0, falloff="none")
    physical = one(flat(8, specular=0.0), (0.3, 0.4, 1.0), intensity=2.0)
    d2 = ((torch.tensor([0.3, 0.4, 1.0], dtype=torch.float64) - texel_positions(8)) ** 2).sum(-1,
                                                                                              keepdim=True)
    assert torch.allclose(generous, physical * d2 / (0.3**2 + 0.4**2 + 1), rtol=1e-12)


def test_renderers_do_not_clip():
    assert one(flat(9, roughness=0.1, specular=0.9), (0, 0, 1)).max() > 10


@pytest.mark.parametrize("transfer", ["gamma2.2", "srgb", "linear"])
def test_transfer_round_trip(transfer):
    display = torch.linspace(0, 1, 1001, dtype=torch.float64)
    assert torch.allclose(color.encode(color.decode(display, transfer), transfer), display, atol=1e-12)


def test_transfer_known_values():
    half = torch.tensor(0.5, dtype=torch.float64)
    assert color.encode(half, "gamma2.2").item() == pytest.approx(0.5 ** (1 / 2.2), rel=1e-12)
    assert color.encode(half, "srgb").item() == pytest.approx(1.055 * 0.5 ** (1 / 2.4) - 0.055, rel=1e-12)
    assert color.encode(torch.tensor(0.001, dtype=torch.float64), "srgb").item() == pytest.approx(0.01292,
                                                                                                  rel=1e-12)
    zero = torch.zeros((), requires_grad=True)
    for transfer in ("gamma2.2", "srgb", "linear"):
        (slope,) = torch.autograd.grad(color.encode(zero, transfer), zero)
        assert torch.isfinite(slope) and slope > 0


def test_photos_shrink_by_area(tmp_path):
    checker = torch.zeros(1, 16, 16, 3)
    checker[:, ::2, ::2] = 1.0  # a quarter of every 2 x 2 block
    write_capture(Capture(checker, Views.of([[0, 0, 2.0]])), tmp_path)
    small = read_capture(tmp_path, resolution=8)
    assert torch.allclose(small.photos, torch.full((1, 8, 8, 3), 0.25), atol=1e-6)
    whole, by_opencv = read_capture(tmp_path), read_capture(tmp_path, resolution=12).photos
    assert torch.allclose(whole.averaged(12).photos, by_opencv, atol=1e-6)
    rows = averaged_rows(lambda part: whole.photos[:, part], 16, 12)
    assert torch.allclose(rows, by_opencv, atol=1e-6)
    white = torch.ones(1000, 1000, 1)
    assert area_averaged(white, 256).max() <= 1  # a map stays in its range
    white[4, 4] = torch.nan
    assert area_averaged(white, 256).isnan().sum() == 1


def test_closed_form():
    # One texel, everything by hand with math.*: camera and light apart, normal up, F within 4e-7 of F0
    # (needs.py).
    r, rho, f0 = 0.5, 0.4, 0.25
    camera, light = (0.0, 0.0, 2.0), (0.02, 0.0, 2.0)
    image = one(flat(1, diffuse=rho, specular=f0, roughness=r), camera, light, 3.0)
    d = math.hypot(0.02, 2.0)
    n_l, n_v = 2.0 / d, 1.0
    n_h = (1 + n_l) / math.hypot(0.02 / d, 1 + n_l)
    a2 = r**4
    D = a2 / (math.pi * (n_h**2 * (a2 - 1) + 1) ** 2)
    g = [2 * c / (c + math.sqrt(a2 + (1 - a2) * c * c)) for c in (n_l, n_v)]
    f = rho / math.pi + D * g[0] * g[1] * f0 / (4 * n_l * n_v)
    assert image[0, 0, 0].item() == pytest.approx(f * n_l * 3.0 / d**2, rel=1e-9)


def test_fresnel_at_the_camera():
    # The specular part is proportional to F0 at any tilt and distance when camera and light coincide.
    dark, bright = (TWIN.render(flat(8, diffuse=0.0, specular=s), GRID) for s in (0.1, 0.8))
    assert torch.allclose(bright, 8 * dark, rtol=1e-12)


def test_fresnel_away_from_the_camera():
    # Camera and light 60 degrees to either side of the normal: unpolarised reflectance of eta = 1.5 at 60
    # degrees, from Fresnel's equations (Rs 0.17696, Rp 0.00180, their mean 0.08938); against F0 = 0.04 seen
    # from straight above.
    x = math.sqrt(3)
    material = flat(1, diffuse=0.0, specular=0.04, roughness=0.5)
    apart = one(material, (x, 0, 1), (-x, 0, 1))[0, 0, 0].item()
    a2, cosine = 0.5**4, 0.5
    g = 2 * cosine / (cosine + math.sqrt(a2 + (1 - a2) * cosine**2))
    f = apart * 4 / cosine * (4 * cosine**2) * math.pi * a2 / g**2
    cos_t = math.sqrt(1 - 0.75 / 2.25)
    rs = ((0.5 - 1.5 * cos_t) / (0.5 + 1.5 * cos_t)) ** 2
    rp = ((1.5 * 0.5 - cos_t) / (1.5 * 0.5 + cos_t)) ** 2
    assert f == pytest.approx((rs + rp) / 2, rel=1e-9)


def test_facing_away_is_black():
    tilted = SVBRDF("roughconductor", dict(flat(1).maps)
                    | {"normal": torch.tensor([[[-0.995, 0.0, 0.0999]]])})
    normal = tilted["normal"].double().requires_grad_()
    maps = {k: v.double() for k, v in tilted.maps.items()} | {"normal": normal}
    image = TWIN.render(SVBRDF("roughconductor", maps), Views.of([[5.0, 0, 0.4]]))
    assert image.abs().max() == 0
    (gradient,) = torch.autograd.grad(image.sum(), normal)
    assert gradient.abs().max() == 0
