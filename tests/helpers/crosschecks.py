"""Views and models of small cross-checks."""

from helpers import GRID

THREE = GRID.pick([0, 3, 8])
BOTH = ["roughconductor", "principled"]
