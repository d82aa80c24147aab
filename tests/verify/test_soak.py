"""The soak: what a fit of an hour depends on, and what it is there to find. ``./run soak [steps]``."""

import gc
import itertools
import mmap
import os
from pathlib import Path

import pytest
from helpers import ANALYTIC, soaking
from helpers.soaking import SLOPE_LIMIT, WORK, resident, soak

from mitsvbrdf.material.maps import CHANNELS
from mitsvbrdf.render import RENDERERS, make_renderer
from mitsvbrdf.render.scene import SceneRenderer

STEPS = int(os.environ.get("SOAK_STEPS", "500"))
GROUPS = [*((name,) for name in RENDERERS), RENDERERS]
pytestmark = [pytest.mark.slow,
              pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")]


@pytest.mark.parametrize("bsdf", CHANNELS)
@pytest.mark.parametrize("names", GROUPS, ids=lambda names: names[0] if len(names) == 1 else "in turn")
def test_nothing_grows(names, bsdf, capsys):  # each step draws with gradients, and without
    found = soak([make_renderer(name) for name in names], bsdf, soaking.with_preview, STEPS)
    first, last = found["milliseconds"]
    with capsys.disabled():
        print(f"\n{', '.join(names)}; {bsdf}: {found['slope']:+.3f} MiB per 100 steps, {first:.1f} -> "
              f"{last:.1f} ms a step")
    assert found["slope"] <= SLOPE_LIMIT and found["late"] == [] and found["variables"] == 0


@pytest.mark.parametrize("work", WORK)
def test_mitsuba_compiles_nothing_after_the_second_turn(work):
    both = [make_renderer("mitsuba"), make_renderer("mitsuba-scene")]
    found = soak(both, "roughconductor", WORK[work], 20, 8)
    assert found["late"] == [] and found["variables"] == 0


def test_a_scene_of_before_makes_no_kernel_late_by_being_freed():
    steps = itertools.count()

    def collecting(renderer, material, views):
        if next(steps) == 10:
            gc.collect()
        soaking.without_gradients(renderer, material, views)

    gc.disable()  # else it may free the first scene at once
    try:
        soak([SceneRenderer()], "roughconductor", soaking.with_gradients, 20, 8)
        # no other test's kernels
        assert soak([SceneRenderer()], "roughconductor", collecting, 20, 8)["late"] == []
    finally:
        gc.enable()


def written_to(size):
    """New memory that is resident for sure: malloc may hand out pages that were already."""
    memory = mmap.mmap(-1, size)
    memory[:] = bytes(size)
    return memory


def test_a_leak_is_found():
    kept = [written_to(2**22)]  # once before: what it copies from stays with malloc
    before = resident()
    found = soak([ANALYTIC], "principled", lambda *_: kept.append(written_to(2**22)), 40, 8)
    assert resident() - before == pytest.approx(160, abs=8)
    assert found["slope"] == pytest.approx(400, rel=0.25) and found["slope"] > SLOPE_LIMIT


def test_a_kernel_that_changes_is_found():
    """A number that changes in a kernel makes it another one."""
    make_renderer("mitsuba")
    import drjit
    import mitsuba

    numbers = itertools.count()

    def compiling(*_):
        drjit.eval(drjit.arange(mitsuba.Float, 8) * (next(numbers) + 0.25))

    assert soak([ANALYTIC], "roughconductor", compiling, 20, 8)["late"] == list(range(4, 20))
