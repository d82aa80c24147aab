"""Simulated photos of known maps.

``photograph`` renders a :class:`~mitsvbrdf.capture.Capture` at given views. ``phone`` plans the photos that a
hand-held phone would take, ``traced`` renders them, ``photos`` develops them and writes the truth beside.
"""

from .photograph import photograph

__all__ = ["photograph"]
