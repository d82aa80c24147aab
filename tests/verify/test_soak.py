"""The soak: a record of a short one, and what it is there to find."""

from __future__ import annotations

import gc
import itertools
import json
import mmap
import sys
from pathlib import Path

import pytest
from helpers import ANALYTIC
from helpers.variants import mostly_slow

from mitsvbrdf.errors import ConfigError
from mitsvbrdf.io import timing
from mitsvbrdf.render import make_renderer
from mitsvbrdf.render.scene import SceneRenderer
from mitsvbrdf.verify import soak

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from Linux's "
                                                                              "/proc")


def written_to(size):
    """New memory that is resident for sure: malloc may hand out pages that were already."""
    memory = mmap.mmap(-1, size)
    memory[:] = bytes(size)
    return memory


class Leaking:
    """Keeps 4 MiB of every picture it draws."""

    name = "leaking"

    def __init__(self):
        self.twin, self.kept = ANALYTIC, []

    def render(self, svbrdf, views):
        self.kept.append(written_to(2**22))
        return self.twin.render(svbrdf, views)


class Compiling:
    """Puts a number that changes into a kernel, which is then another kernel."""

    name = "compiling"

    def __init__(self, changes):
        make_renderer("mitsuba")
        self.twin, self.changes, self.drawn = ANALYTIC, changes, 0

    def render(self, svbrdf, views):
        import drjit
        import mitsuba

        self.drawn += self.changes
        drjit.eval(drjit.arange(mitsuba.Float, 8) * (self.drawn + 0.25))
        return self.twin.render(svbrdf, views)


@pytest.mark.parametrize("work", mostly_slow(soak.WORK, "preview"))  # which does what the others do
def test_mitsuba_compiles_nothing_after_the_second_turn(work):
    record = soak.soak([make_renderer("mitsuba"), make_renderer("mitsuba-scene")], "roughconductor", work, 20,
                       resolution=8)
    assert record["renderers"] == ["mitsuba", "mitsuba-scene"] and record["work"] == work
    assert record["kernels"]["late_steps"] == [] and record["kernels"]["late"] == 0
    assert record["drjit"]["variables"] == 0
    assert [step for step, _ in record["memory"]["samples"]] == list(range(20))


@pytest.mark.slow
def test_a_scene_of_before_makes_no_kernel_late_by_being_freed(monkeypatch):
    steps = itertools.count()

    def collecting(renderer, material, views):
        if next(steps) == 10:
            gc.collect()
        soak.without_gradients(renderer, material, views)

    monkeypatch.setitem(soak.WORK, "images", collecting)
    gc.disable()  # else it may free the first scene at once
    try:
        soak.soak([SceneRenderer()], "roughconductor", "gradients", 20, resolution=8)
        # no other test's kernels
        record = soak.soak([SceneRenderer(samples=16)], "roughconductor", "images", 20, resolution=8)
    finally:
        gc.enable()
    assert record["kernels"] == {"first": 2, "late": 0, "late_steps": []}


def test_resident_memory_counts_what_is_written_to():
    parts = [written_to(2**22)]  # once before: what it copies from stays with malloc
    before = soak.resident()
    parts += [written_to(2**22) for _ in range(16)]
    assert soak.resident() - before == pytest.approx(64, abs=4)


def test_a_leak_is_found():
    record = soak.soak([Leaking()], "principled", "images", 40, resolution=8)
    assert record["memory"]["slope"] == pytest.approx(400, rel=0.25)  # less what is freed meanwhile
    (failure,) = record["failures"]
    assert "MiB per 100 steps, limit 0.5" in failure


def test_a_kernel_that_changes_is_found():
    record = soak.soak([Compiling(changes=1)], "roughconductor", "images", 20, resolution=8)
    assert record["kernels"] == {"first": 4, "late": 16, "late_steps": list(range(4, 20))}
    assert any("16 kernels made after the second turn, at steps 4, 5, 6" in failure
               for failure in record["failures"])
    steady = soak.soak([Compiling(changes=0)], "roughconductor", "images", 20, resolution=8)
    assert steady["kernels"]["late"] == 0


def test_a_step_that_takes_longer_and_longer_drifts(monkeypatch):
    clock = iter(range(10**9))
    now = [0.0]

    def later():
        # Called before and after each step: step k takes k seconds, 3 more where the light is apart (every
        # second step).
        call = next(clock)
        now[0] += 0 if call % 2 == 0 else call // 2 + 3 * (call // 2 % 2)
        return now[0]

    monkeypatch.setattr(timing.time, "perf_counter", later)
    step = soak.soak([ANALYTIC], "principled", "images", 100, resolution=8)["step"]
    # Warm-up ends at 20. Means of turns: 22, 24, ..., 100; the first and the last four of forty have medians
    # 25 and 97.
    assert (step["first"], step["last"]) == (25e3, 97e3)
    assert step["drift"] == pytest.approx(97 / 25 - 1)


def test_growth_is_the_slope_of_the_least_squares_line():
    assert soak.slope([3 + 0.25 * step for step in range(50)]) == pytest.approx(0.25)
    assert soak.slope([7.0] * 50) == 0
    # by hand: sum of (x - 1.5) y over sum of (x - 1.5)^2, 1.5 / 5
    assert soak.slope([0, 0, 0, 1]) == pytest.approx(0.3)


@pytest.mark.slow
def test_the_command_keeps_the_record_and_tells_by_its_exit_code(tmp_path, monkeypatch, capsys):
    options = {"steps": 20, "renderer": ("analytic",), "bsdf": ("principled",),
               "json": tmp_path / "new" / "soak.json"}
    monkeypatch.setattr(soak, "SLOPE_LIMIT", 1e6)  # twenty steps are all warm-up
    assert soak.main(**options) == 0
    kept = json.loads(options["json"].read_text())
    assert [record["work"] for record in kept["records"]] == list(soak.WORK)
    assert kept["limits"] == {"slope": 1e6, "late": 0}
    monkeypatch.undo()
    monkeypatch.setattr(soak, "make_renderer", lambda name: Leaking())
    assert soak.main(**options) == 1
    said = capsys.readouterr().out
    assert "leaking, principled, images: memory grows by" in said.replace("\n", " ")


def test_renderers_alone_then_in_turn(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(soak, "soak", lambda renderers, bsdf, work, steps: seen.append((len(renderers), bsdf))
                        or {
        "renderers": ["x"] * len(renderers), "bsdf": bsdf, "work": work,
        "memory": {"slope": 0.0, "last": 1.0}, "drjit": None,
        "kernels": {"late": 0}, "step": {"last": 1.0, "drift": 0.0}, "failures": []})
    assert soak.main(renderer=("analytic", "analytic64"), bsdf=("principled",),
                     json=tmp_path / "soak.json") == 0
    assert seen == [(1, "principled")] * 6 + [(2, "principled")] * 3


def test_the_entry_ends_with_one_line(tmp_path, monkeypatch, capsys):
    def entry(*options):
        monkeypatch.setattr(sys, "argv", ["soak", "--renderer", "analytic", "--json", *map(str, options)])
        code, said = soak.entry(), capsys.readouterr().err
        assert said.count("\n") == 1 and not list(tmp_path.iterdir())
        return code, said

    assert entry(tmp_path, "--steps", 20)[0] == 2  # a folder: refused before any work
    code, said = entry(tmp_path / "soak.json", "--steps", 19)
    assert code == 2 and said.startswith("error: expected 20 steps")

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(soak, "random_material", interrupted)
    code, said = entry(tmp_path / "soak.json", "--steps", 20)
    assert code == 130 and said.startswith("interrupted")


def test_too_few_steps():
    with pytest.raises(ConfigError, match="20 steps or more, got 19"):
        soak.soak([ANALYTIC], "principled", "images", 19)
    with pytest.raises(ConfigError, match="24 steps or more"):
        soak.soak([ANALYTIC] * 3, "principled", "images", 20)
