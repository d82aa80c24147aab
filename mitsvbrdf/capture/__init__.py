"""From photographs to a :class:`Capture`: photos of one patch, rectified, with their views.

``read`` takes a folder. ``calibrated`` makes the capture where the folder states a calibration, ``stages``
where it holds raw photos: lens and poses (``align``, a ``rig``), rectified photos (``rectify``), flash,
vignetting and exposures (``light``), bad photos rejected (``quality``). ``guess`` makes a first diffuse map.

The public names are loaded on first use: the sheet of tags needs no torch.
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
