"""Previews of a material: new cameras, lights and shapes, in Mitsuba's own path tracer."""

from .environment import ENVIRONMENTS
from .stage import PRESETS, Stage, make_stage

__all__ = ["ENVIRONMENTS", "PRESETS", "Stage", "make_stage"]
