"""Recover the maps of a material from a few flash photos, through a physically based differentiable renderer.

The public names below are loaded on first use: importing the package loads neither torch nor Mitsuba, and
sets no variant. The first use sets ``OMP_WAIT_POLICY=PASSIVE``, if torch is not loaded and the variable is
not set. ``__init__.pyi`` beside this file has the same names for type checkers and editors.
"""

import importlib
import os
import sys

__version__ = "2.0.0"

_HOME = {
    "SVBRDF": "material.maps", "load_maps": "material.map_files", "save_maps": "material.map_files",
    "View": "views", "Views": "views",
    "Capture": "capture", "read_capture": "capture", "write_capture": "capture", "guess_diffuse": "capture",
    "make_renderer": "render", "using_mitsuba": "render.exclusive",
    "HierarchicalConfig": "fit", "HybridConfig": "fit", "GanConfig": "fit", "DirectConfig": "fit",
    "Fit": "fit", "FitResult": "fit", "fit_svbrdf": "fit",
    "evaluate_fit": "evaluate.photos", "evaluate_maps": "evaluate", "evaluate_capture": "evaluate",
    "write_fit": "report.folder", "write_scene": "export.mitsuba",
    "ExportSettings": "export", "export_material": "export",
    "make_material": "material.made",
    "Progress": "io.progress",
    "MitsvbrdfError": "errors",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> object:
    if name in _HOME:
        from .io.signals import PROCESS
        with PROCESS:  # loading torch or Mitsuba is not thread-safe
            if "torch" not in sys.modules:  # its idle threads leave the cores to Mitsuba
                os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
            found = globals()[name] = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
        return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__


if "IPython" in sys.modules:
    importlib.import_module(".report", __name__).show_in_notebooks()
