"""The methods by name: a method is added here."""

from __future__ import annotations

import importlib
from typing import NamedTuple

from ..errors import ConfigError
from .config import DirectConfig, FitConfig, HierarchicalConfig, HybridConfig
from .gan_config import GanConfig
from .method import Method
from .task import Config, FitTask


class MethodEntry(NamedTuple):
    """Settings of a method, and where its class or maker is, which is loaded on first use."""

    config: type[FitConfig]
    module: str
    name: str


METHODS = {  # the default first
    "hierarchical": MethodEntry(HierarchicalConfig, ".hierarchical.rounds", "Hierarchical"),
    "hybrid": MethodEntry(HybridConfig, ".generator.hybrid", "Hybrid"),
    "gan": MethodEntry(GanConfig, ".solved_gan", "gan_of"),
    "direct": MethodEntry(DirectConfig, ".direct", "Direct"),}

# of hierarchical, for one photo of a material that repeats itself
ONE_PHOTO = MethodEntry(HierarchicalConfig, ".one_photo", "OnePhoto")


def method_name(config: FitConfig) -> str:
    """The name of the method that settings belong to.

    Raises:
        ConfigError: they belong to none.
    """
    for name, entry in METHODS.items():
        if isinstance(config, entry.config):
            return name
    raise ConfigError(f"a {', '.join(entry.config.__name__ for entry in METHODS.values())}",
                      type(config).__name__, "use one of these")


def make_method(task: FitTask[Config]) -> Method:
    """The method that a task's settings belong to, ready to step.

    Raises:
        ConfigError: they belong to none.
    """
    entry = METHODS[method_name(task.config)]
    if isinstance(task.config, HierarchicalConfig) and task.repeats and task.repeats.stationary:
        entry = ONE_PHOTO
    return getattr(importlib.import_module(entry.module, __package__), entry.name)(task)
