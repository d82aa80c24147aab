"""The hierarchical fit, and the solver of texels that it is made of."""

from .rounds import Hierarchical
from .solver import Observations, TexelSolver

__all__ = ["Hierarchical", "Observations", "TexelSolver"]
