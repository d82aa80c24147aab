"""From photographs to a :class:`Capture`: photos of one patch, rectified, with their views.

``read`` reads a folder. ``calibrated`` makes the capture of a folder with a calibration, ``stages`` that of
raw photos. ``stages`` finds lens and poses (``align``, ``rig``), rectifies (``rectify``), finds flash,
vignetting and exposures (``light``), and rejects bad photos (``quality``). ``guess`` makes a diffuse map.

The public names are loaded on first use, so that the sheet of tags needs no torch.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .capture import Capture
    from .guess import guess_diffuse
    from .read import read_capture, write_capture

_HOME = {"Capture": "capture", "guess_diffuse": "guess", "read_capture": "read", "write_capture": "read"}
__all__ = ["Capture", "guess_diffuse", "read_capture", "write_capture"]


def __getattr__(name: str) -> object:
    if name in _HOME:
        return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
