"""Scene files of ``scenes/`` as the dictionaries that ``mitsuba.load_dict`` takes, to be filled in."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from ..export.mitsuba import SCENES


def read_scene(mi: ModuleType, name: str, **values: str) -> dict[str, Any]:
    """A scene file as a dictionary; names are ids, else kinds (``sensor``, ``film``).

    References stay references, so that what they name can be replaced.
    """
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_file(config, str(SCENES / name), **values)
    return _described(mi, state, 0)


def _described(mi: ModuleType, state: Any, index: int) -> dict[str, Any]:
    """A node of a parsed file, and those below it."""
    props = state.nodes[index].props
    described: dict[str, Any] = {"type": props.plugin_name()}
    for key, value in props.items():
        if isinstance(value, mi.Properties.ResolvedReference):
            child = state.nodes[value.index()]
            name = (child.props.id() or child.type.name.lower()) if key.startswith("_arg_") else key
            described[name] = _described(mi, state, value.index())
        elif isinstance(value, mi.Properties.Reference):
            described["bsdf" if key.startswith("_arg_") else key] = {"type": "ref", "id": value.id()}
        elif "Color" in type(value).__name__:
            described[key] = {"type": "rgb", "value": list(value)}
        elif "Transform" in type(value).__name__:  # parsed in double precision
            described[key] = mi.ScalarTransform4f(np.array(value.matrix, dtype=np.float32))
        elif key == "filename":
            described[key] = str(SCENES / value)
        else:
            described[key] = value
    return described
