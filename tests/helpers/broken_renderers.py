"""Views and renderers of small cross-checks."""

import importlib

from helpers import GRID

command = importlib.import_module("mitsvbrdf.cli.crosscheck")  # the package has the function under this name
THREE = GRID.pick([0, 3, 8])
BOTH = ["roughconductor", "principled"]
