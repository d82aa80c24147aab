"""Where the renderers become wrong: sweeps to the ends of every range, compared with float64."""

from .run import stability
from .sweeps import SWEEPS

__all__ = ["SWEEPS", "stability"]
