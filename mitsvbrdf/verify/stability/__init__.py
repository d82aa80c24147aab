"""Where the renderers stop being right: sweeps to the ends of every range against float64.

:mod:`.sweeps` lists the configurations, :mod:`.conditioning` has Jacobians and step sizes, :mod:`.clamps` the
cuts of the model, :mod:`.verdict` the verdicts. docs/results/stability.md shows a run.
"""

from .run import stability
from .sweeps import SWEEPS

__all__ = ["SWEEPS", "stability"]
