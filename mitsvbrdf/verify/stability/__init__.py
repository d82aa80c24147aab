"""Where the renderers stop being right: sweeps to the ends of every range, held against float64, fifty digits
and what float32 can do at all.

:mod:`.sweeps` lists the configurations, :mod:`.reference` has the fifty digits, :mod:`.conditioning`
Jacobians and step sizes, :mod:`.clamps` every cut of the model, :mod:`.functions` the other public functions,
:mod:`.verdict` the verdicts. docs/stability.md explains and shows a run.
"""

from .run import stability
from .sweeps import SWEEPS

__all__ = ["SWEEPS", "stability"]
