"""Where the renderers stop being right: sweeps to the ends of every range against float64."""

from .run import stability
from .sweeps import SWEEPS

__all__ = ["SWEEPS", "stability"]
