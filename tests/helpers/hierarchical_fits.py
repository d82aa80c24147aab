"""Hierarchical fits, and the views of their photos."""

from helpers import MITSUBA
from mitsvbrdf.fit import FitTask, HierarchicalConfig, make_method
from mitsvbrdf.fit.hierarchical.stages import Stage
from mitsvbrdf.fit.loop import Loop

SIDE = 32


def method_of(capture, **settings):
    return make_method(FitTask(capture, MITSUBA, HierarchicalConfig(**settings)))


def saving_loop(capture, config, folder):
    """A loop that saves a checkpoint before each step; and stage and state before it, by iteration."""
    loop = Loop(make_method(FitTask(capture, MITSUBA, config)))
    step, before = loop.method.step, {}

    def saving_step(progress):
        loop.checkpoint = folder / f"{loop.iteration}.safetensors"
        loop.save()
        before[loop.iteration] = loop.method.stages.stage, loop.method.state()
        return step(progress)

    loop.method.step = saving_step
    return loop, before


def reached(stage, method):
    """The method after its first round in a stage."""
    while method.stages.stage != stage:
        method.step(0.0)
    return method


def left_alone(capture, **settings):
    """The method after its free stage, when it knows which kind of photos it has."""
    method = method_of(capture, **settings)
    while method.stages.stage == Stage.ALONE:
        method.step(0.0)
    return method
