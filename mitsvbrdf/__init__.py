"""Recover the maps of a material from a few flash photos, through a physically based differentiable renderer.

The public names below are loaded on first use: importing the package loads neither torch nor Mitsuba, and sets no variant.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what __getattr__ finds at run time, for type checkers and editors
    from .capture import Capture as Capture
    from .capture import guess_diffuse as guess_diffuse
    from .capture import read_capture as read_capture
    from .capture import write_capture as write_capture
    from .errors import MitsvbrdfError as MitsvbrdfError
    from .evaluate import evaluate_capture as evaluate_capture
    from .evaluate import evaluate_fit as evaluate_fit
    from .evaluate import evaluate_maps as evaluate_maps
    from .export import export_material as export_material
    from .export.mitsuba import write_scene as write_scene
    from .fit import DirectConfig as DirectConfig
    from .fit import FitResult as FitResult
    from .fit import GanConfig as GanConfig
    from .fit import HierarchicalConfig as HierarchicalConfig
    from .fit import HybridConfig as HybridConfig
    from .fit import fit_svbrdf as fit_svbrdf
    from .material.made import make_material as make_material
    from .material.map_files import load_maps as load_maps
    from .material.map_files import save_maps as save_maps
    from .material.maps import SVBRDF as SVBRDF
    from .render import make_renderer as make_renderer
    from .report.folder import write_fit as write_fit
    from .system.progress import Progress as Progress
    from .views import View as View
    from .views import Views as Views

__version__ = "0.1.0"

_HOME = {
    "SVBRDF": "material.maps", "load_maps": "material.map_files", "save_maps": "material.map_files",
    "View": "views", "Views": "views",
    "Capture": "capture", "read_capture": "capture", "write_capture": "capture", "guess_diffuse": "capture",
    "make_renderer": "render",
    "HierarchicalConfig": "fit", "HybridConfig": "fit", "GanConfig": "fit", "DirectConfig": "fit",
    "FitResult": "fit", "fit_svbrdf": "fit",
    "evaluate_fit": "evaluate", "evaluate_maps": "evaluate", "evaluate_capture": "evaluate",
    "write_fit": "report.folder", "write_scene": "export.mitsuba",
    "export_material": "export",
    "make_material": "material.made",
    "Progress": "system.progress",
    "MitsvbrdfError": "errors",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
