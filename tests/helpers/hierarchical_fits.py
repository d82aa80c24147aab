"""Hierarchical fits, and the views of their photos."""

from helpers import MITSUBA
from mitsvbrdf.fit import FitTask, HierarchicalConfig, make_method
from mitsvbrdf.fit.hierarchical.stages import Stage

SIDE = 32


def method_of(capture, **settings):
    config = HierarchicalConfig(**settings)
    return make_method(FitTask(capture, MITSUBA, config))


def left_alone(capture, **settings):
    """The method after its free stage, when it knows which kind of photos it has."""
    method = method_of(capture, **settings)
    while method.stages.stage == Stage.ALONE:
        method.step(0.0)
    return method
