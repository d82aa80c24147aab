"""Whatever is valid comes out finite, clamps act where they say, and the rest is refused."""

import math

import pytest
import torch
from helpers import TWIN
from helpers.one_sweep import renderer
from hypothesis import given, settings
from hypothesis import strategies as st

from mitsvbrdf.errors import CaptureError, MapsError, MitsvbrdfError
from mitsvbrdf.material.maps import CHANNELS, SVBRDF, flat
from mitsvbrdf.measure.gradients import render_and_gradients
from mitsvbrdf.verify.stability import SWEEPS
from mitsvbrdf.verify.stability.run import CLAMPS
from mitsvbrdf.verify.stability.sweeps import GRID, Case, aimed, material
from mitsvbrdf.views import BRIGHTEST, FARTHEST, NEAREST, Views


def test_configurations_are_valid_but_those_to_be_refused():
    for key in SWEEPS.keys() - {"resolution"}:
        for case in SWEEPS[key][1]():
            assert case.sweep == key
            if case.refused:
                with pytest.raises(MitsvbrdfError):
                    case.svbrdf.check()
                    case.views.check()
            else:
                case.svbrdf.check()
                case.views.check()
    labels = [(key, case.label) for key in SWEEPS.keys() - {"resolution"} for case in SWEEPS[key][1]()]
    assert len(labels) == len(set(labels))


def test_clamps_act_where_they_say():
    for name, svbrdf in {"alpha >= 0.0001": aimed("roughconductor", GRID, 0.01),
                         "alpha >= 0.001": aimed("principled", GRID, 0.03)}.items():
        case = Case("roughness", "", None, svbrdf, GRID)
        assert [n for n, acts in CLAMPS.items() if acts(case, torch.ones(1))] == [name]
        found = render_and_gradients(TWIN, svbrdf, GRID)
        smoother = SVBRDF(svbrdf.bsdf, dict(svbrdf.maps) | {"roughness": 0.5 * svbrdf["roughness"]})
        same = render_and_gradients(TWIN, smoother, GRID)
        if svbrdf.bsdf == "roughconductor":  # principled's diffuse lobe still answers
            assert torch.equal(found.image, same.image) and found.gradients["roughness"].abs().max() == 0
    rough = Case("roughness", "", None, material(), GRID)
    assert not any(acts(rough, torch.ones(1)) for acts in CLAMPS.values())


@pytest.mark.parametrize("camera, light, intensity, size, expected", [
    ((0, 0, 0.9 * NEAREST), None, 1, 1, "patch sides away"), ((0, 0, 2), (0, 1.1 * FARTHEST, 2), 1, 1,
                                                              "patch sides away"),
    ((0, 0, 2), None, 1, 1e-30, "patch sides away"), ((0, 0, 20), None, 3000, 1e6, "patch sides away"),
    ((0, 0, 2), None, 4.1 * BRIGHTEST, 1, "squared distance"), ((3, 0, 0.01), (0.2, 0, 0.01),
                                                                2e-4 * BRIGHTEST, 1, "squared"),
])
def test_lengths_that_do_not_go_together_are_refused(camera, light, intensity, size, expected):
    with pytest.raises(CaptureError, match=expected):
        Views.of([camera], None if light is None else [light], intensity, size)


def test_lengths_at_the_ends_are_taken():
    for place in ((0, 0, NEAREST), (FARTHEST, -FARTHEST, FARTHEST)):
        Views.of([place])
        Views.of([[100 * x for x in place]], size=100.0)  # the unit does not matter
    Views.of([[0, 0, 2.0]], intensity=4 * BRIGHTEST)


@pytest.mark.parametrize("normal, expected", [((0, 0, 1e-9), "unit normals"), ((0, 0.5, 0.5), "unit normals"),
                                              ((1, 0, 5e-6), "z >= 1e-05"), ((1, 0, 0), "z > 0")])
def test_normals_that_no_renderer_can_use_are_refused(normal, expected):
    maps = dict(flat(2).maps) | {"normal": torch.tensor(normal, dtype=torch.float32).expand(2, 2, 3)}
    with pytest.raises(MapsError, match=expected):
        SVBRDF("roughconductor", maps).check()


def some(*values):
    return st.sampled_from(values)


UNIT_VALUES = st.one_of(some(0.0, 1e-30, 1e-6, 0.5, 0.9999999, 1.0), st.floats(0, 1, width=32))
ROUGHNESS = st.one_of(some(1e-30, 1e-4, 0.01, 1.0), st.floats(2**-60, 1, width=32))
HEIGHTS = st.one_of(some(NEAREST, 1.0, FARTHEST), st.floats(NEAREST, 100))


# Every other one straight above a texel, whose normal may well be upright: there a mirror's D is what
# overflows.
PLACES = st.one_of(st.tuples(st.just(0.25), st.just(0.25), HEIGHTS),
                   st.tuples(some(0.0, -0.25, 3.0, 1e3, -FARTHEST), some(0.0, -2.0, 1e4), HEIGHTS))
TILTED = st.tuples(some(1.0, 45.0, 80.0, 89.0, 89.9, 89.999), some(0.0, 30.0, 90.0, 180.0, 271.0))
NORMALS = st.one_of(st.just((0.0, 0.0)), TILTED)


@st.composite
def scenes(draw):
    bsdf, maps = draw(some(*CHANNELS)), {}
    for name, channels in CHANNELS[bsdf].items():
        if name == "normal":
            turns = [[math.radians(x) for x in draw(NORMALS)] for _ in range(4)]
            values = [[math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t)] for t, a in turns]
        else:
            number = ROUGHNESS if name == "roughness" else UNIT_VALUES
            values = draw(st.lists(st.lists(number, min_size=channels, max_size=channels), min_size=4,
                                   max_size=4))
        maps[name] = torch.tensor(values, dtype=torch.float32).reshape(2, 2, channels)
    cameras = [draw(PLACES) for _ in range(2)]
    lights = [draw(PLACES) for _ in range(2)] if draw(st.booleans()) else cameras
    brightest = 0.999 * BRIGHTEST * min(light[2] ** 2 for light in lights)
    views = Views.of(cameras, lights, min(draw(some(1e-8, 1.0, 1e8, brightest)), brightest),
                     falloff=draw(some("inverse-square", "none")))
    return SVBRDF(bsdf, maps).check(), views


@given(scenes())
@settings(max_examples=60, deadline=None, derandomize=True, database=None)
def test_whatever_is_valid_comes_out_finite(scene):
    for name in ("analytic64", "analytic", "mitsuba"):
        found = render_and_gradients(renderer(name), *scene)
        for what, tensor in {"image": found.image, **found.gradients}.items():
            assert torch.isfinite(tensor).all(), (name, what)
