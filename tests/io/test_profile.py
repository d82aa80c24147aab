"""Parts of a step against a clock that moves where the test says so; nothing is collected unasked."""

import dataclasses
import json
from time import perf_counter

import pytest
import torch
from helpers import photos_of
from helpers.variants import mostly_slow

from mitsvbrdf import cli
from mitsvbrdf.fit import DirectConfig, FitTask, GanConfig, HybridConfig, fit_svbrdf, make_method
from mitsvbrdf.io import profile
from mitsvbrdf.io.profile import OTHER, STEP, Profile, profile_summary, profiled, profiling, switch_at
from mitsvbrdf.material.made import make_material
from mitsvbrdf.render import make_renderer

CONFIGS = {"hybrid": HybridConfig(width=8), "direct": DirectConfig(),
           "gan": GanConfig(width=8, preset="paper-one-stage", precision="float32")}


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 0.0

        def pass_(self, seconds):
            self.now += seconds

    clock = Clock()
    monkeypatch.setattr(profile, "perf_counter", lambda: clock.now)
    return clock


def taking(clock, forward, backward):
    """A function of one tensor that changes nothing and takes its time."""
    class Takes(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            clock.pass_(forward)
            return x.clone()

        @staticmethod
        def backward(ctx, gradient):
            clock.pass_(backward)
            return gradient

    return Takes.apply


@pytest.fixture
def capture():
    return photos_of(make_material("inlay", 32))


def test_a_second_counts_once(clock):
    with profiling() as found:
        clock.pass_(100)
        with profiled("setting up"):
            clock.pass_(1)
            with profiled("renderer"):
                clock.pass_(2)
        for _ in range(2):
            with profiled(STEP):
                clock.pass_(4)
                with profiled("network"):
                    clock.pass_(8)
                    with profiled("hand-over"):
                        clock.pass_(16)
                    clock.pass_(32)
                    found.switch("optimiser")
                    clock.pass_(64)
                clock.pass_(128)
    assert found.steps == [{OTHER: 132, "network": 40, "hand-over": 16, "optimiser": 64}] * 2
    assert found.beside == {"setting up": 3}


def test_autograd_goes_through_the_parts_backward(clock):
    # Two maps of one network, one renderer, and losses of the rendering and of a map: each takes its own time
    # either way.
    network, renderer, losses, about_map = (taking(clock, 2.0**i, 2.0 ** (i + 4)) for i in range(4))
    weights = [torch.ones(3, requires_grad=True) for _ in range(2)]
    with profiling() as found, profiled(STEP):
        with profiled("network"):
            maps = [network(w) for w in weights]
            switch_at("network, backward", *maps)
        with profiled("renderer"):
            rendered = renderer(maps[0] * maps[1])
            switch_at("renderer, backward", rendered, torch.zeros(3))  # without a gradient: passed over
        with profiled("losses"):
            total = losses(rendered).sum() + about_map(maps[1]).sum()
        with profiled("losses, backward"):
            total.backward()
            with profiled("optimiser"):
                clock.pass_(0.5)
    assert found.steps == [{OTHER: 0, "network": 2, "renderer": 2, "losses": 12, "losses, backward": 64 + 128,
                            "renderer, backward": 32, "network, backward": 2 * 16, "optimiser": 0.5}]
    found.switch("a hook that fires later")
    assert len(found.steps) == 1 and not found.beside


@pytest.mark.parametrize("method", mostly_slow(CONFIGS, "hybrid"))
def test_parts_sum_to_the_step_and_change_nothing(method, capture):
    renderer, config = make_renderer("mitsuba"), dataclasses.replace(CONFIGS[method], iterations=6)
    plain = fit_svbrdf(capture, renderer, config)
    assert plain.profile is None and profile_summary() is None
    with profiling() as found:
        watched = fit_svbrdf(capture, renderer, config)
        fit, spent = make_method(FitTask(capture, renderer, config, watched.guess)), 0.0
        for _ in range(6):
            started = perf_counter()
            with profiled(STEP):
                fit.step(0.5)
            spent += perf_counter() - started
    # The same seconds, taken around the steps: measured up to 3e-4 apart. Of them 0.2 to 2 % have no name.
    parts = {name: sum(step.get(name, 0) for step in found.steps[-6:]) for step in found.steps
             for name in step}
    assert sum(parts.values()) == pytest.approx(spent, rel=0.02)
    assert parts[OTHER] < 0.2 * spent
    assert all(torch.equal(value, watched.svbrdf[name]) for name, value in plain.svbrdf.maps.items())
    assert watched.profile["steps"] == 5 and len(found.steps) == 12
    assert {"setting up", "measuring", "uncertainty"} <= set(watched.profile["beside"])


def test_off_nothing_is_collected(capture):
    assert profiled("a") is profiled("b")
    fit = make_method(FitTask(capture, make_renderer("analytic"), CONFIGS["direct"],
                              torch.full((32, 32, 3), 0.3)))
    seen = []
    render = fit.renderer.render
    fit.renderer.render = lambda *a: seen.append(render(*a)) or seen[-1]
    fit.step(0.0)
    assert not seen[0]._backward_hooks
    with profiling() as found:
        fit.step(0.0)
    fit.step(0.0)
    assert not found.steps and set(found.beside) >= {"renderer", "losses"}  # outside a step


def test_a_step_that_fails_is_closed(clock):
    with profiling() as found:
        with pytest.raises(ZeroDivisionError), profiled(STEP), profiled("network"):
            clock.pass_(2)
            1 / 0  # noqa: B018
        clock.pass_(50)
        with profiled("measuring"):
            clock.pass_(3)
    assert found.steps == [{OTHER: 0, "network": 2}] and found.beside == {"measuring": 3}
    assert profile_summary() is None


def test_summary_of_known_steps():
    found = Profile()
    found.steps = [{OTHER: 0.0, "renderer": 9.0}, {OTHER: 1.0, "renderer": 1.0},
                   {OTHER: 0.0, "network": 50.0},
                   {OTHER: 1.0, "renderer": 3.0}, {OTHER: 2.0, "network": 12.0}]
    found.beside = {"measuring": 2.0}
    summary = found.summary()
    assert summary["steps"] == 3 and summary["warm_up"] == 59 and summary["beside"] == {"measuring": 2.0}
    assert summary["parts"]["renderer"] == {"median": 2, "low": 1.5, "high": 2.5, "repeats": 2, "share": 0.2}
    assert summary["parts"]["network"] == {"median": 12, "low": 12, "high": 12, "repeats": 1, "share": 0.6}
    assert summary["parts"][OTHER]["share"] == 0.2 and summary["step"]["median"] == 4
    found.steps = found.steps[:1]
    assert found.summary()["steps"] == 1 and found.summary()["warm_up"] == 0
    assert Profile().summary() == {"steps": 0, "step": None, "parts": {}, "warm_up": 0, "beside": {}}


def test_fit_prints_and_keeps_it_when_asked(tmp_path, capsys):
    shots, out = str(tmp_path / "shots"), tmp_path / "out"
    assert cli.main(["synth", "builtin:inlay", "-o", shots, "--resolution", "16"]) == 0
    fit = ["fit", shots, "-o", str(out), "--method", "direct", "--renderer", "analytic", "--resolution", "16"]
    assert cli.main([*fit, "--iterations", "4"]) == 0
    assert "profile" not in json.loads((out / "fit.json").read_text())
    capsys.readouterr()
    assert cli.main([*fit, "--iterations", "4", "--profile", "--overwrite"]) == 0
    record, said = json.loads((out / "fit.json").read_text())["profile"], capsys.readouterr().out
    assert record["steps"] == 3
    assert sum(part["share"] for part in record["parts"].values()) == pytest.approx(1)
    for name in (*record["parts"], *record["beside"], "first steps"):
        assert name in said
    # Nothing left to do: a table of no steps.
    assert cli.main([*fit, "--iterations", "4", "--profile", "--resume"]) == 0
    assert json.loads((out / "fit.json").read_text())["profile"]["steps"] == 0
