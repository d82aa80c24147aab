"""From photographs to a :class:`Capture`: reading, aligning, guessing the diffuse map."""

from .capture import Capture

__all__ = ["Capture"]
