"""Simulated photos of known maps, and a capture of them against the truth.

``photograph`` renders a :class:`~mitsvbrdf.capture.Capture` at given views. ``phone`` plans what a hand-held
phone would take, ``traced`` renders it, ``photos`` develops it and writes the truth beside; ``truth`` and
``against_truth`` judge what a capture made of such photos brings back.
"""

from .photograph import photograph

__all__ = ["photograph"]
