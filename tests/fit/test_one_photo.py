"""One photo of a material that repeats itself: the test of it, its look classes, and the fit."""

import math
from dataclasses import replace

import pytest
import torch

from mitsvbrdf.capture import Capture
from mitsvbrdf.fit import FitTask, HierarchicalConfig, make_method
from mitsvbrdf.fit.look_classes import LookClasses, Pixels
from mitsvbrdf.fit.one_photo import OnePhoto, nodes
from mitsvbrdf.fit.repeats import repeats
from mitsvbrdf.material.maps import flat
from mitsvbrdf.render import make_renderer
from mitsvbrdf.synth import photograph
from mitsvbrdf.views import Views

VIEW = Views.of([[0.0, 0.0, 1.2]], [[0.05, 0.0, 1.2]], math.pi * 1.44)


def photo_of(diffuse, side=32):
    """A photo of a matt material, diffuse R x R."""
    maps = flat(side).maps | {"diffuse": diffuse[..., None].expand(-1, -1, 3).contiguous()}
    return photograph(type(flat(side))("roughconductor", maps), VIEW, make_renderer("analytic"))


def test_random_texels_repeat_and_a_ramp_does_not():
    random = torch.rand(32, 32, generator=torch.Generator().manual_seed(0))
    found = repeats(photo_of(0.2 + 0.3 * random))
    # 64 ranks a block, each of variance 1/12: 1/64 of it lies between blocks by chance
    assert found.stationary and found.between == pytest.approx(1 / 64, abs=0.02)
    ramp = repeats(photo_of(torch.linspace(0.1, 0.6, 32).expand(32, 32)))
    assert not ramp.stationary and ramp.between > 0.5
    assert "not taken" in ramp.said() and "taken" in found.said()
    assert repeats(photo_of(torch.linspace(0.1, 0.6, 32).expand(32, 32)), asked=True).stationary


def test_a_material_of_one_look_is_met_where_the_flash_stands_aside():
    """The renderer is another implementation of the same model: what it renders is met."""
    maps = flat(16, specular=0.3, roughness=0.4, diffuse=0.2)
    dim = replace(VIEW, intensity=VIEW.intensity / 5)  # nothing is clipped
    photo = Capture(make_renderer("analytic").render(maps, dim), dim, "linear")
    assert photo.photos.max() < 0.9
    numbers = LookClasses.start(torch.full((5, 3), 0.2 ** (1 / 2.2)), 0.4, 0.3)
    classes, pixels = LookClasses(numbers, dim, True), Pixels.of(photo)
    found = classes.posterior(pixels, torch.zeros(len(pixels.at), 1, 3))
    # Schlick's F0 without its rise, and cosines to the half vector: 0.05 sides aside they differ by 1e-3
    assert (found.diffuse - 0.2).abs().max() < 4e-3
    other = LookClasses(LookClasses.start(torch.full((5, 3), 0.2 ** (1 / 2.2)), 0.5, 0.3), dim, True)
    assert other.posterior(pixels, torch.zeros(len(pixels.at), 1, 3)).likely.mean() < found.likely.mean() - 1


def test_nodes_are_standard_normal_numbers():
    drawn = nodes(64, 64, 0)
    assert drawn.mean().abs() < 0.02 and drawn.std() == pytest.approx(1, abs=0.05)
    assert not torch.equal(drawn[0], drawn[1])


def test_the_fit_goes_on_from_its_state_bit_by_bit(monkeypatch):
    monkeypatch.setattr("mitsvbrdf.fit.one_photo.TRIED", 2)
    monkeypatch.setattr("mitsvbrdf.fit.one_photo.ITERATIONS", 2)
    random = torch.rand(32, 32, generator=torch.Generator().manual_seed(0))
    task = FitTask(photo_of(0.2 + 0.3 * random), make_renderer("analytic"), HierarchicalConfig())
    whole, parts = make_method(task), make_method(task)
    assert isinstance(whole, OnePhoto)
    for step in range(8):
        whole.step(0.0)
        parts.step(0.0)
        if step in (3, 6):
            other = make_method(task)
            other.load_state(parts.state())
            parts = other
    assert torch.equal(whole.numbers, parts.numbers) and not whole.done
    for name, value in whole.estimate()[0].maps.items():
        assert torch.equal(value, parts.estimate()[0][name]) and torch.isfinite(value).all()


def test_asked_for_or_not_the_method_follows(tmp_path):
    random = torch.rand(32, 32, generator=torch.Generator().manual_seed(0))
    photo, renderer = photo_of(0.2 + 0.3 * random), make_renderer("analytic")
    assert not FitTask(photo, renderer, HierarchicalConfig(stationary=False)).repeats.stationary
    for config in (HierarchicalConfig(fix=("roughness=0.5",)), HierarchicalConfig(bsdf="principled")):
        assert FitTask(photo, renderer, config).repeats is None
