"""From photographs to a :class:`Capture`: photos of one patch, rectified, with the views they were taken from.

``read`` takes a folder: with a calibration in it, ``calibrated`` makes the capture; of raw photos, ``make`` does, which finds
lens and poses (``align``: a ``rig``), rectifies the photos (``rectify``), finds flash, vignetting and exposures (``light``) and
leaves bad photos out (``quality``). ``guess`` makes a first diffuse map of a capture; ``page`` shows how good a capture is.
"""

from .capture import Capture
from .guess import guess_diffuse
from .read import read_capture, write_capture

__all__ = ["Capture", "guess_diffuse", "read_capture", "write_capture"]
