"""From photographs to a :class:`Capture`: photos of one patch, rectified, with the views they were taken
from.

``read`` takes a folder: with a calibration in it, ``calibrated`` makes the capture; of raw photos, ``make``
does, which finds lens and poses (``align``: a ``rig``), rectifies the photos (``rectify``), finds flash,
vignetting and exposures (``light``) and leaves bad photos out (``quality``). ``guess`` makes a first diffuse
map of a capture; ``page`` shows how good a capture is.

The public names are loaded on first use: the sheet of tags needs no torch.
"""

from __future__ import annotations

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
