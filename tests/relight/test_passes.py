"""Renders in passes: their error against repeated renders, and their samples."""

import gc
import math

import numpy as np
import pytest
import torch
from helpers.stages import srgb

from mitsvbrdf.errors import MapsError
from mitsvbrdf.material.made import make_material
from mitsvbrdf.relight.passes import SAMPLES_AT_ONCE, GroupedMean, render_frame, render_passes
from mitsvbrdf.relight.stage import make_stage


def rmse(a, b):
    return float(np.sqrt(np.mean((srgb(a) - srgb(b)) ** 2)))


@pytest.fixture(scope="module")
def scenes(mi):
    """Small frames of three presets; leather shows highlights, clipped ones too."""
    material = make_material("leather", 64)
    kinds = {"sphere": "studio", "turntable": "studio", "sweep": "none"}
    return {name: make_stage(mi, material, name, environment=environment, size=(48, 48), frames=4).at(mi, 1)
            for name, environment in kinds.items()}


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["sweep", "turntable", "sphere"])
def test_estimated_error_is_the_scatter_of_repeated_renders(mi, scenes, preset):
    truth = render_frame(mi, scenes[preset], 2048, seed=99).image.numpy()
    for samples in (8, 32):
        renders = [render_frame(mi, scenes[preset], samples, seed=seed) for seed in range(6)]
        true = math.sqrt(np.mean([rmse(each.image.numpy(), truth) ** 2 for each in renders]))
        estimated = math.sqrt(np.mean([each.error ** 2 for each in renders]))
        # 0.97 to 1.04 seen; the few pixels at the edge of a patch that is swept scatter most
        assert estimated == pytest.approx(true, rel=0.12)


def test_estimate_knows_clipping_and_the_dark():
    # A pixel that is dark but for one sample in 32 that is 100 times too bright for the display; others near
    # black.
    noise = np.random.default_rng(3)

    def draw(call, samples):
        rare = (noise.random((samples, 96, 96, 1)) < 1 / 32) * 100.0
        dark = noise.exponential(0.002, (samples, 96, 96, 1))
        return torch.from_numpy(np.concatenate((rare, dark, dark), axis=-1).mean(axis=0)).float()

    truth = np.broadcast_to([100 / 32, 0.002, 0.002], (96, 96, 3))
    found = render_passes(draw, 32, pixels=96 * 96)
    # 0.97 to 0.99 in four runs; half the difference of two halves of 16 samples gives 0.57 to 0.58
    assert found.error == pytest.approx(rmse(found.image.numpy(), truth), rel=0.06)


@pytest.mark.parametrize("counts", [(1, 1, 1, 1), (4, 4, 4, 4, 4, 4, 4, 4), (7, 1, 2, 4, 8, 1, 1, 1)])
def test_groups_of_any_size_give_the_standard_error_of_a_mean(counts):
    # Mid-grey with little noise: there display values are as good as linear, and the textbook's sigma /
    # sqrt(n) holds.
    torch.manual_seed(1)
    mean, sigma = GroupedMean(), 0.004
    for count in counts:
        mean.add(0.5 + sigma / math.sqrt(count) * torch.randn(200, 200, 3), count)
    slope = 1.055 / 2.4 * 0.5 ** (1 / 2.4 - 1)  # of the sRGB curve at 0.5
    assert mean.samples == sum(counts)
    # 0.3 to 1.1 % seen
    assert mean.error() == pytest.approx(slope * sigma / math.sqrt(sum(counts)), rel=0.02)


def test_mean_is_that_of_all_samples():
    pictures = [torch.rand(5, 4, 3, generator=torch.Generator().manual_seed(k)) for k in range(12)]
    mean = GroupedMean()
    for k, picture in enumerate(pictures):
        mean.add(picture, 1 + k % 3)
    weights = [1 + k % 3 for k in range(12)]
    expected = sum(w * p.double() for w, p in zip(weights, pictures)) / sum(weights)
    assert torch.allclose(mean.image.double(), expected, atol=1e-6)


def test_exposure_counts_in_the_error():
    torch.manual_seed(2)
    mean = GroupedMean()
    for _ in range(8):
        mean.add(0.01 + 0.001 * torch.randn(100, 100, 3), 1)
    brighter = GroupedMean()
    for one in mean.sums:
        brighter.add(one * 8, 1)
    assert mean.error(exposure=3) == pytest.approx(brighter.error(), rel=1e-6)
    assert mean.error(exposure=3) > 1.5 * mean.error()
    assert mean.error(exposure=12) == 0  # all white


def test_number_of_samples_is_kept_and_calls_are_independent():
    calls = []

    def draw(call, samples):
        calls.append((call, samples))
        return torch.full((4, 4, 3), 0.375)

    for wanted in (1, 2, 3, 8, 37, 100):
        calls.clear()
        found = render_passes(draw, wanted, pixels=16)
        assert found.samples == wanted == sum(count for _, count in calls) and found.stopped == "samples"
        assert [call for call, _ in calls] == list(range(len(calls)))  # no random numbers twice
        assert all(count & (count - 1) == 0 for _, count in calls)  # powers of two: one kernel
        assert (found.error is None) == (wanted == 1) and not found.error and (found.image == 0.375).all()
    calls.clear()
    render_passes(draw, 64, pixels=SAMPLES_AT_ONCE // 3)  # a large picture: Ctrl-C is looked at in between
    assert {count for _, count in calls} == {2}


def test_all_numbers_of_samples_share_one_kernel(mi, scenes):
    import drjit as dr
    # a kernel calls every BSDF that lives: scenes of before, freed on the way, would have it made again
    gc.collect()
    render_frame(mi, scenes["sphere"], 2)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        render_frame(mi, scenes["sphere"], 93, seed=5)
        kernels = [each for each in dr.kernel_history() if each["type"] == dr.KernelType.JIT]
    assert len(kernels) > 8 and all(each["cache_hit"] for each in kernels)


def test_radiance_that_is_not_finite_is_refused():
    with pytest.raises(MapsError, match="NaN"):
        render_passes(lambda call, samples: torch.tensor([math.nan]).expand(4, 4, 3), 4, pixels=16)
