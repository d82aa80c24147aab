"""From photographs to a :class:`Capture`: reading, aligning, guessing the diffuse map."""

from .capture import Capture
from .guess import guess_diffuse
from .read import read_capture, write_capture

__all__ = ["Capture", "guess_diffuse", "read_capture", "write_capture"]
