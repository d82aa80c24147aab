"""The Python API in programs with defaults and threads of their own, and with arguments that are wrong."""

import contextlib
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
import torch
from helpers import GRID, photos_of

import mitsvbrdf as mv
from mitsvbrdf.capture.guess import guess_diffuse
from mitsvbrdf.capture.rig import OnePlace
from mitsvbrdf.errors import CaptureError, OutputError
from mitsvbrdf.material.maps import flat
from mitsvbrdf.testing import random_material
from mitsvbrdf.verify.crosscheck import crosscheck

RESOLUTION = 16
DIRECT = mv.DirectConfig(iterations=2, guess="min")
pytestmark = pytest.mark.usefixtures("painted_anew")


@contextlib.contextmanager
def float64():
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


MODES = {"float64": float64, "no_grad": torch.no_grad, "inference_mode": torch.inference_mode}


def fitted(config, renderer="mitsuba"):
    """All a fit is made of, from maps to figures: tensors and numbers."""
    shots = photos_of(mv.make_material("inlay", RESOLUTION))
    found = mv.fit_svbrdf(shots, mv.make_renderer(renderer), config)
    return [found.guess, *found.svbrdf.maps.values(), found.views.camera, found.rerendered,
            torch.tensor(mv.evaluate_fit(found, shots)["rerender_rmse"], dtype=torch.float64)]


def same(found, expected):
    return (len(found) == len(expected)
            and all(a.dtype == b.dtype and torch.equal(a, b) for a, b in zip(found, expected)))


@pytest.fixture(scope="module")
def plain():
    return fitted(DIRECT)


@pytest.mark.parametrize("mode", MODES)
def test_fits_are_the_same_bits_under_any_default(mode, plain):
    with MODES[mode]():
        assert same(fitted(DIRECT), plain)


@pytest.mark.parametrize("mode", MODES)
def test_guesses_are_the_same_bits_under_any_default(mode):
    shots = photos_of(mv.make_material("inlay", 8))
    expected = guess_diffuse(shots)
    with MODES[mode]():
        assert same([guess_diffuse(shots)], [expected])


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("config", [mv.HierarchicalConfig(iterations=8),
                                    mv.HybridConfig(width=4, iterations=3),
                                    mv.GanConfig(width=4, iterations=3)], ids=lambda c: type(c).__name__)
def test_fits_of_every_method_are_the_same_bits_under_any_default(mode, config):
    expected = fitted(config)
    with MODES[mode]():
        assert same(fitted(config), expected)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", ["mitsuba", "mitsuba-scene", "analytic", "analytic64"])
def test_pictures_are_the_same_bits_under_any_default(name, mode):
    def drawn():
        return mv.make_renderer(name).render(random_material("principled", 8), GRID.pick([0, 4]))

    expected = drawn()
    with MODES[mode]():
        found = drawn()
    assert found.dtype == expected.dtype and torch.equal(found, expected) and not found.is_inference()


@pytest.mark.parametrize("mode", MODES)
def test_a_crosscheck_finds_the_same_under_any_default(mode):
    def figures():
        record = crosscheck({"flat": flat(8)}, GRID.pick([0]), ["roughconductor"],
                            [mv.make_renderer("mitsuba")])
        return [{part: each[part] for part in ("rough", "smooth") if part in each}
                for each in record["configurations"]]

    expected = figures()
    with MODES[mode]():
        assert figures() == expected


@pytest.mark.slow
@pytest.mark.parametrize("configs", [
    [replace(DIRECT, learning_rate=rate) for rate in (0.02, 0.05, 0.1)],
    [mv.HybridConfig(width=4, iterations=3, seed=1), mv.GanConfig(width=4, iterations=3),
     mv.HierarchicalConfig(iterations=8)]], ids=["direct", "other methods"])
def test_fits_in_threads_are_those_of_one(configs):
    expected = [fitted(config) for config in configs]
    with ThreadPoolExecutor(3) as pool:
        assert all(map(same, pool.map(fitted, configs), expected))


def test_the_state_of_torch_and_mitsuba_is_left_as_found():
    with mv.using_mitsuba() as mi:
        import drjit as dr
        mi.set_variant("scalar_rgb")

        def state():
            return (torch.get_default_dtype(), torch.is_grad_enabled(), torch.get_num_threads(),
                    torch.initial_seed(), torch.get_rng_state().tolist(), mi.variant(),
                    torch.are_deterministic_algorithms_enabled(), [dr.flag(flag) for flag in dr.JitFlag])

        before = state()
        fitted(DIRECT)
        fitted(mv.HybridConfig(width=4, iterations=1))
        assert state() == before


GREY = torch.full((9, 8, 8, 3), 0.5)
WRONG = {
    "no views": lambda: GRID.pick([]), "no rows": lambda: mv.Views.of([]),
    "no tensors": lambda: mv.Views(GRID.camera[:0], GRID.light[:0], GRID.intensity[:0]),
    "lists for tensors": lambda: mv.Views([[0, 0, 1]], [[0, 0, 1]], [[1, 1, 1]]),
    "a view too far": lambda: GRID.pick([9]), "a view before the first": lambda: GRID.pick([-1]),
    "a fraction of a view": lambda: GRID.pick([0.0]), "a truth for a view": lambda: GRID.pick([True, False]),
    "text for a view": lambda: GRID.pick("01"), "one number for views": lambda: GRID.pick(1),
    "another BSDF of a fit": lambda: mv.fit_svbrdf(mv.Capture(GREY, GRID), mv.make_renderer("analytic"),
                                                   mv.DirectConfig(bsdf="x", iterations=1)),
    "another BSDF of maps": lambda: mv.SVBRDF("x", dict(flat(8).maps)),
    "another BSDF of a constant": lambda: flat(8, "x"),
    "another guess": lambda: mv.fit_svbrdf(mv.Capture(GREY, GRID), mv.make_renderer("analytic"),
                                           mv.DirectConfig(guess="x", iterations=1)),
    "NaN in photos": lambda: mv.Capture(GREY * torch.nan, GRID),
    "infinite photos": lambda: mv.Capture(GREY * torch.inf, GRID),
    "negative photos": lambda: mv.Capture(GREY - 0.6, GRID),
    "photos in steps of 8 bits": lambda: mv.Capture(GREY * 255, GRID),
    "photos of 32 bits": lambda: mv.Capture((GREY * 255).int(), GRID),
    "oblong photos": lambda: mv.Capture(GREY[:, :4], GRID), "no photos": lambda: mv.Capture(GREY[:0], GRID),
    "views below the plane": lambda: mv.Capture(GREY, mv.Views(-GRID.camera, GRID.light, GRID.intensity)),
    "another calibration": lambda: mv.Capture(GREY, GRID, calibration="x"),
    "a mask of numbers": lambda: mv.Capture(GREY, GRID, measured=GREY[..., 0].byte()),
    "a mask of other photos": lambda: mv.Capture(GREY, GRID, measured=GREY[..., :1] > 0),
    "a mask that hides all": lambda: mv.fit_svbrdf(mv.Capture(GREY, GRID, measured=GREY[..., 0] < 0),
                                                   mv.make_renderer("analytic"), DIRECT),
    "one texel for a traced scene": lambda: mv.make_renderer("mitsuba-scene").render(flat(1), GRID),
    "another transfer": lambda: mv.Capture(GREY, GRID, "x"),
    "numbers for fewer photos": lambda: mv.Capture(GREY, GRID, index=(0, 1)),
    "a number for two photos": lambda: mv.Capture(GREY, GRID, index=(0, 0, 1, 2, 3, 4, 5, 6, 7)),
    "a photo that is not there": lambda: mv.Capture(GREY, GRID).pick([9]),
    "a fraction of a photo": lambda: mv.Capture(GREY, GRID).pick([1.0]),
    "a truth for a photo": lambda: mv.Capture(GREY, GRID).pick([True]),
    "text for a photo": lambda: mv.Capture(GREY, GRID).pick("12"),
    "a photo twice": lambda: mv.Capture(GREY, GRID).pick([1, 1]),
    "one number for photos": lambda: mv.Capture(GREY, GRID).pick(1),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_argument_is_one_error_of_the_package(what):
    with pytest.raises(mv.MitsvbrdfError):
        WRONG[what]()


def test_numbers_of_any_whole_kind_pick_photos():
    views = replace(GRID, camera=GRID.camera.clone().requires_grad_())
    shots = mv.Capture(GREY.double().requires_grad_(), views, index=range(9))
    assert shots.photos.dtype == torch.float32
    assert not (shots.photos.requires_grad or shots.views.camera.requires_grad)
    for index in ([2, 0], (2, 0), torch.tensor([2, 0]), torch.tensor([2, 0]).numpy()):
        assert shots.pick(index).index == (2, 0) and torch.equal(GRID.pick(index).camera, GRID.camera[[2, 0]])


@pytest.mark.parametrize("kind", [CaptureError, OutputError, OnePlace])
def test_errors_reach_other_processes(kind):
    error = pickle.loads(pickle.dumps(kind("a", "b", "c")))
    assert type(error) is kind and (error.expected, error.got, error.fix) == ("a", "b", "c")
    assert str(error) == "expected a, got b; c"
