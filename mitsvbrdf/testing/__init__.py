"""For other people's test suites: renderers that must agree, golden images, and a Z-test for noisy pictures.

A pytest plugin is included (:mod:`mitsvbrdf.testing.plugin`); ``docs/testing.md`` shows how to use all of it.
The names below are loaded on first use: a suite that does not use them loads neither torch nor Mitsuba.
"""

import importlib
from typing import Any

_HOME = {"assert_renderers_agree": ".agreement", "LIMITS": ".agreement", "Limits": ".agreement",
         "random_material": "..material.corner_cases", "assert_matches_golden": ".golden",
         "z_test": "..measure.z_test", "ZTest": "..measure.z_test"}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
