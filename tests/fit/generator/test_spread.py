"""The spread of the maps over which photo is the input."""

import pytest
import torch
from helpers import ANALYTIC, photos_of

from mitsvbrdf import color
from mitsvbrdf.capture import guess_diffuse
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import FitTask, GanConfig, make_method
from mitsvbrdf.fit.generator.spread import input_spread, spread_of
from mitsvbrdf.material.made import make_material


def method_of(capture, kind, **settings):
    config = GanConfig(generator=kind, width=4, precision="float32", **settings)
    # the same in any order
    return make_method(FitTask(capture, ANALYTIC, config, guess_diffuse(capture, "min")))


def untrained_change(method):
    """Its last layers as they were drawn, so that photos count."""
    torch.manual_seed(0)
    for parameter in method.generator.parameters():
        if parameter.abs().max() == 0 and parameter.ndim == 4:
            torch.nn.init.normal_(parameter, std=0.1)


def test_it_is_the_standard_deviation_of_encoded_maps():
    materials = [make_material(name, 16) for name in ("inlay", "leather", "tiles")]
    found = spread_of(materials)
    stacks = {name: torch.stack([m[name].double() for m in materials]) for name in materials[0].maps}
    encoded = {name: (s + 1) / 2 if name == "normal" else s if name == "roughness" else color.encode(s)
               for name, s in stacks.items()}
    for name, value in encoded.items():
        own = value.var(dim=0, correction=0).mean().sqrt()
        assert found[name] == pytest.approx(float(own), rel=1e-9)
    assert found["mean"] == pytest.approx(sum(found[name] for name in encoded) / 4)


def test_alike_maps_have_none_and_one_map_is_refused():
    material = make_material("inlay", 16)
    assert set(spread_of([material, material]).values()) == {0.0}
    with pytest.raises(ConfigError, match="two or more"):
        spread_of([material])


@pytest.mark.parametrize("kind, spreads", [("two-stream", True), ("all-photos", True),
                                           ("variational", False)])
def test_every_generator_has_one(capture, kind, spreads):
    method = method_of(capture, kind)
    assert input_spread(method)["mean"] == 0  # it begins at the start, whichever photo it sees
    untrained_change(method)
    found = input_spread(method)
    assert all(value > 1e-3 for value in found.values()) if spreads else all(value < 1e-4
                                                                             for value in found.values())


def test_the_maps_from_a_photo_are_the_estimate_of_a_fit_that_has_it_first():
    capture = photos_of(make_material("inlay", 32)).pick([0, 1, 2, 4, 5, 6, 7, 8])  # numbers are not places
    turned = capture.pick([4, 5, 6, 7, 8, 0, 1, 2])
    for kind in ("two-stream", "all-photos"):
        one, other = method_of(capture, kind, start=False), method_of(turned, kind, start=False)
        a, b = one.maps_from(3), other.estimate()[0]
        assert all(torch.allclose(a[name], b[name], atol=1e-5) for name in a.maps)
