"""Renderers and views of small sweeps."""

import functools

from mitsvbrdf.render import make_renderer
from mitsvbrdf.verify.stability.sweeps import APART

FEW = APART.pick([0, 3])
renderer = functools.cache(make_renderer)
