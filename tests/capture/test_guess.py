"""The guessed diffuse map: the paper's, the blurred baseline, and the robust one."""

import math

import numpy as np
import pytest
import torch
from helpers import GRID

from mitsvbrdf import color
from mitsvbrdf.capture import Capture, guess, guess_diffuse
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.views import Views, nine_view_grid, texel_positions

METHODS = ("robust", "min", "mean-blur")
SIDE = 32


def colours(seed=0, low=0.1, high=0.6):
    return low + (high - low) * torch.rand((SIDE, SIDE, 3), generator=torch.Generator().manual_seed(seed))


def shot(diffuse, f0=0.0, roughness=0.3, views=GRID, normal=(0.0, 0.0, 1.0)):
    """A capture of a material under co-located light: Lambert plus a GGX lobe, clipped, gamma 2.2, 8 bit."""
    photos = []
    for view in views:
        to = torch.tensor(view.light) - texel_positions(diffuse.shape[0]) * views.size
        square = to.square().sum(dim=-1, keepdim=True)
        c = (to * torch.as_tensor(normal)).sum(dim=-1, keepdim=True).div(square.sqrt()).clamp_min(1e-4)
        square = square if views.falloff != "none" else np.dot(view.light, view.light)
        a2 = roughness**4
        d = a2 / (math.pi * (a2 * c**2 + 1 - c**2) ** 2)
        g = 2 * c / (c + (a2 + (1 - a2) * c**2).sqrt())
        brdf = diffuse / math.pi + d * g**2 * f0 / (4 * c**2)
        radiance = brdf * c / square * torch.tensor(view.intensity)
        photos.append((color.to_display(radiance) * 255).round() / 255)
    return Capture(torch.stack(photos).float(), views)


def rms(a, b):
    return float((color.encode(a.double()) - color.encode(b.double())).square().mean().sqrt())


def test_min_is_the_minimum_radiance_times_one_constant():
    capture = shot(colours(), f0=0.04)
    intensity, light = capture.views.intensity.numpy(), capture.views.light.numpy()
    irradiance = np.mean(intensity * light[:, 2:] / (light**2).sum(1, keepdims=True) ** 1.5, axis=0)
    wanted = np.clip(np.min(capture.photos.numpy() ** 2.2, axis=0) * math.pi / irradiance, 0, 1)
    # below the toe of the transfer curve
    assert np.abs(guess_diffuse(capture, "min").numpy() - wanted).max() < 2e-6


def test_mean_blur_keeps_a_constant_and_blurs_the_rest():
    views = nine_view_grid(spread=0)
    level = torch.tensor([0.2, 0.4, 0.6])
    # white has radiance 1 at the centre
    capture = Capture(color.encode(level).expand(9, SIDE, SIDE, 3), views)
    assert torch.allclose(guess_diffuse(capture, "mean-blur"), level.expand(SIDE, SIDE, 3), atol=1e-6)
    noisy = shot(colours())
    assert guess_diffuse(noisy, "mean-blur").std() < 0.5 * guess_diffuse(noisy, "min").std()


@pytest.mark.parametrize("falloff", ["inverse-square", "none"])
def test_robust_undoes_falloff_where_min_does_not(falloff):
    near = nine_view_grid(distance=1.0)
    views = Views.of(near.camera, intensity=near.intensity, falloff=falloff)
    diffuse = colours()
    capture = shot(diffuse, views=views)
    # Measured: 0.0013 and 0.0012, the rounding of 8 bits (1 / (255 sqrt 12) = 0.0011); `min`: 0.157, and
    # 0.079 without falloff, for the cosine that is left.
    assert rms(guess_diffuse(capture), diffuse) < 0.002
    assert rms(guess_diffuse(capture, "min"), diffuse) > 0.05


@pytest.mark.parametrize("roughness", [0.2, 0.35, 0.5])
def test_robust_takes_the_highlight_away(roughness):
    diffuse = colours(low=0.02, high=0.3)
    capture = shot(diffuse, f0=0.04, roughness=roughness, views=nine_view_grid(distance=2.5))
    # Measured: 0.003 to 0.007 against 0.024 to 0.030.
    assert rms(guess_diffuse(capture), diffuse) < 0.5 * rms(guess_diffuse(capture, "min"), diffuse)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("value", [0.0, 0.25, 1.0])
@pytest.mark.parametrize("count", [1, 2, 9])
def test_finite_for_constant_black_and_white_photos(method, value, count):
    views = GRID.pick(range(count))
    found = guess_diffuse(Capture(torch.full((count, 8, 8, 3), value), views), method)
    assert found.shape == (8, 8, 3) and found.dtype == torch.float32
    assert torch.isfinite(found).all() and found.min() >= 0 and found.max() <= 1
    if value == 0:
        assert found.max() < 1e-3


@pytest.mark.parametrize("strength", [1e-9, 1e9])
@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_light_far_too_weak_or_strong(value, strength):
    # The albedo is cut to what it can be; from grazing lights too, where the falloff is largest.
    for views in (GRID, Views.of([[5, 0, 0.01], [-5, 0, 0.01]], [[-5, 0, 0.01], [5, 0, 0.01]])):
        views = Views(views.camera, views.light, views.intensity * strength)
        found = guess_diffuse(Capture(torch.full((len(views), 8, 8, 3), value), views))
        assert torch.isfinite(found).all() and 0 <= found.min() and found.max() <= 1
        if value == 0.5 and torch.equal(views.camera, views.light):
            assert (found > 0.99).all() if strength < 1 else (found < 1e-6).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_light_without_blue(method):
    views = Views.of([[0, 0, 2.0], [0.5, 0, 2.0]], intensity=[10.0, 10.0, 0.0])
    found = guess_diffuse(Capture(torch.full((2, 8, 8, 3), 0.5), views), method)
    assert torch.isfinite(found).all() and found[..., 2].max() == 0


def test_robust_is_repeatable_and_large_photos_are_fitted_small(monkeypatch):
    monkeypatch.setattr(guess, "FIT_SIZE", SIDE)
    diffuse = colours().repeat_interleave(3, 0).repeat_interleave(3, 1)
    found = guess_diffuse(shot(diffuse))
    assert found.shape == (3 * SIDE, 3 * SIDE, 3) and torch.equal(found, guess_diffuse(shot(diffuse)))
    assert rms(found, diffuse) < 0.005


def test_unknown_method():
    with pytest.raises(ConfigError, match="median"):
        guess_diffuse(shot(colours()), "median")


def test_robust_on_known_materials(data_folder):
    """The six known materials from nine real views, at 48 pixels, by mean RMSE of the diffuse map."""
    from mitsvbrdf.capture import read_capture
    from mitsvbrdf.material.map_files import load_maps

    views = read_capture(data_folder / "captures" / "cards-blue", resolution=8).views
    errors = {"robust": [], "min": []}
    for folder in sorted((data_folder / "materials").iterdir()):
        maps = load_maps(folder).resized(48).as_roughconductor()
        parts = (maps[k].double() for k in ("diffuse", "specular", "roughness"))
        capture = shot(*parts, views, maps["normal"].double())
        for method, found in errors.items():
            found.append(rms(guess_diffuse(capture, method), maps["diffuse"]))
    assert np.mean(errors["robust"]) < 0.05 < 0.08 < np.mean(errors["min"])
