"""The live viewer: what travels is what was given."""

import base64
import json
import math
import re
import zlib

import numpy as np
import pytest
import torch
from helpers.viewer_pages import changed

from mitsvbrdf import make_material
from mitsvbrdf.errors import MapsError
from mitsvbrdf.material.maps import CHANNELS, COLOURS, SVBRDF, TITLES, flat
from mitsvbrdf.report.viewer import viewer_html
from mitsvbrdf.testing import random_material


def decoded(fragment: str) -> dict[str, np.ndarray]:
    """The maps of a fragment, float64, by what ``encode`` promises."""
    about = json.loads(re.search(r'class="about">(.*?)</script>', fragment, re.S)[1])
    raw = zlib.decompress(base64.b64decode(re.search(r'class="payload">(.*?)</script>', fragment, re.S)[1]))
    at, maps = 0, {}
    for entry in about["maps"]:
        channels, shape = [], (entry["height"], entry["width"])
        count = shape[0] * shape[1]
        for low, high in zip(entry["low"], entry["high"]):
            high_bytes, low_bytes = (raw[at + k * count:at + (k + 1) * count] for k in (0, 1))
            at += 2 * count
            levels = np.array([256 * a + b for a, b in zip(high_bytes, low_bytes)],
                              dtype=np.float64).reshape(shape)
            channels.append(low + levels / entry["top"] * (high - low))
        value = np.stack(channels, axis=-1)
        if entry["coding"] == "square":
            value = value**2
        elif entry["coding"] == "octahedral":
            x, y = (value[..., 0] + value[..., 1]) / 2, (value[..., 0] - value[..., 1]) / 2
            value = np.stack((x, y, 1 - abs(x) - abs(y)), axis=-1)
            value /= np.linalg.norm(value, axis=-1, keepdims=True)
        maps[entry["name"]] = value
    assert at == len(raw)
    return maps


def steepest(resolution: int) -> SVBRDF:
    """Normals in all directions, down to the lowest z that maps may have."""
    g = torch.Generator().manual_seed(1)
    around = torch.rand(resolution, resolution, 1, generator=g, dtype=torch.float64) * 2 * math.pi
    z = 10 ** (-5 * torch.rand(resolution, resolution, 1, generator=g, dtype=torch.float64))
    across = (1 - z**2).sqrt()
    normal = torch.cat((across * around.cos(), across * around.sin(), z.clamp_min(1.001e-5)), dim=-1)
    return changed(random_material("roughconductor", resolution).to(torch.float64), normal=normal)


@pytest.mark.parametrize("material", [
    random_material("roughconductor", 32), random_material("principled", 32), steepest(32),
    make_material("inlay", 32)], ids=["roughconductor", "principled", "steepest", "inlay"])
def test_maps_survive_the_way(material):
    found = decoded(viewer_html(material))
    assert list(found) == list(CHANNELS[material.bsdf])
    for name, value in found.items():
        truth = material[name].double().numpy()
        if name == "normal":
            # Half a step of s and t is 1 / 65535 = 1.53e-5, which moves a point of |x| + |y| + |z| = 1 by
            # sqrt 2 of that at most; the sphere is at most sqrt 3 times wider there: 3.74e-5 rad. Measured:
            # 3.2e-5.
            truth = truth / np.linalg.norm(truth, axis=-1, keepdims=True)
            assert np.linalg.norm(np.cross(value, truth), axis=-1).max() < 3.8e-5
        elif name in COLOURS:
            # half a step of the square root
            assert np.abs(np.sqrt(value) - np.sqrt(truth)).max() <= 0.5 / 4095 + 1e-12
        else:
            assert np.abs(value - truth).max() <= 0.5 / 65535 + 1e-12


@pytest.mark.parametrize("bsdf", ["roughconductor", "principled"])
def test_constant_maps_travel_exactly(bsdf):
    material = flat(4, bsdf, roughness=0.3, diffuse=0.2, base_color=0.2, metallic=1.0)
    for name, value in decoded(viewer_html(material)).items():
        # the root of a square, at most
        assert np.allclose(value, material[name].double().numpy(), rtol=0, atol=1e-15), name


def test_noise_at_512_stays_below_the_limit():
    # 6 colours of 12 bits, roughness and two of the normal of 16, times 4 / 3 of base64: 5.24 MB that nothing
    # can shrink.
    size = len(viewer_html(random_material("roughconductor", 512)).encode())
    assert 5.2e6 < size < 6e6


def test_larger_maps_are_averaged_down(monkeypatch):
    monkeypatch.setattr("mitsvbrdf.report.viewer.VIEWER_SIDE", 8)
    material = random_material("roughconductor", 32)
    found, small = decoded(viewer_html(material)), material.resized(8)
    assert np.abs(found["roughness"] - small["roughness"].double().numpy()).max() < 1e-5
    assert found["normal"].shape == (8, 8, 3)


@pytest.mark.parametrize("bsdf", ["roughconductor", "principled"])
def test_nothing_comes_from_outside(bsdf):
    fragment = viewer_html(flat(4, bsdf))
    for reach in (r"https?:", r"\bsrc\s*=", r"\bhref\s*=", r"@import", r"url\(", r"\bfetch\(", "WebSocket",
                  "XMLHttpRequest", r"\beval\(", "new Function", r"\bimport\("):
        assert not re.search(reach, fragment), reach
    for name in CHANNELS[bsdf]:
        assert fragment.count(f">{TITLES[name]}</label>") == 2  # to look at alone, and to switch off


def test_maps_that_are_no_maps_are_refused():
    with pytest.raises(MapsError, match="roughness > 0"):
        viewer_html(changed(flat(4), roughness=0.0))
