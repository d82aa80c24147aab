"""What a step breaks is taken back, and said."""

import math

import pytest
import torch
from helpers import ANALYTIC

from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import DirectConfig, FitTask, make_method
from mitsvbrdf.fit.loop import MAX_UNDONE, Loop

SIDE = 16


def loop_of(capture, config, renderer=ANALYTIC, **options):
    method = make_method(FitTask(capture, renderer, config, torch.full((SIDE, SIDE, 3), 0.2)))
    return Loop(method, **options)


def poison_parameters(loop, value=math.inf):
    loop.method.raw["roughness"].data[0, 3, 3] = value


def poison_averages(loop):
    # as a gradient of 1e20 does
    loop.method.optimizer.state[loop.method.raw["roughness"]]["exp_avg_sq"][0, 3, 3] = math.inf


@pytest.mark.parametrize("poison, word", [(poison_parameters, "raw.roughness"),
                                          (poison_averages, "exp_avg_sq")])
@pytest.mark.parametrize("at", [19, 23])  # seen where a measurement is due, and at the very end of the run
def test_what_a_step_leaves_behind_is_checked(poison, word, at, leather):
    # The losses of this step are fine, and a raw number of infinity even renders: only the state shows it.
    loop = loop_of(leather, DirectConfig(iterations=24))
    step = loop.method.step

    def poisoned(progress):
        losses = step(progress)
        if loop.iteration == at and not loop.undone:
            poison(loop)
        return losses

    loop.method.step = poisoned
    assert loop.run() == "iterations"
    assert len(loop.undone) == 1 and word in loop.undone[0]["reason"] and loop.method.pace == 0.5
    assert all(torch.isfinite(value).all() for value in loop.method.state().values())
    assert [entry["iteration"] for entry in loop.trace] == [0, 10, 20, 24]
    loop.best[1].check()


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_photo_that_is_not_finite_is_never_the_best(value, leather):
    # Infinity is white once clipped: the error of such a picture is finite, and could be the lowest.
    class Broken:
        name, variant, calls = "analytic", None, 0

        def render(self, svbrdf, views):
            image = ANALYTIC.render(svbrdf, views)
            self.calls += not torch.is_grad_enabled()
            if not torch.is_grad_enabled() and self.calls == 2:
                image = image.clone()
                image[0, 0, 0, 0] = value
            return image

    loop = loop_of(leather, DirectConfig(iterations=20), Broken())
    loop.run()
    assert [event["reason"] for event in loop.undone] == ["a re-rendered photo not finite"]
    assert loop.undone[0]["iteration"] == 10 and math.isfinite(loop.best[0])


def test_a_start_that_is_not_finite_is_one_error(leather):
    loop = loop_of(leather, DirectConfig(iterations=5))
    poison_parameters(loop, math.nan)
    with pytest.raises(ConfigError, match="finite start"):
        loop.run()


def test_a_fit_that_breaks_for_good_keeps_its_best(leather, tmp_path):
    loop = loop_of(leather, DirectConfig(iterations=1000), checkpoint=tmp_path / "c.safetensors")
    step = loop.method.step
    loop.method.step = lambda progress: step(progress) if loop.iteration < 25 else {"photometric": math.nan}
    assert loop.run() == "unstable" and len(loop.undone) == MAX_UNDONE + 1
    assert loop.best[0] < loop.trace[0]["rerender_rmse"] and (tmp_path / "c.safetensors").is_file()


def test_a_broken_state_is_not_saved(leather, tmp_path):
    loop = loop_of(leather, DirectConfig(iterations=3), checkpoint=tmp_path / "c.safetensors")
    poison_parameters(loop)
    loop.save()
    assert not loop.checkpoint.exists()
