"""Where the renderers stop being right: sweeps to the ends of every range against float64.

:mod:`.sweeps` lists the configurations, :mod:`.conditioning` has Jacobians, :mod:`.run` the verdicts and the
cuts of the model. docs/results/stability.md shows a run.
"""

from .run import stability
from .sweeps import SWEEPS

__all__ = ["SWEEPS", "stability"]
