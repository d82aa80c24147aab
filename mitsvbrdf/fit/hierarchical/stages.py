"""The stages of the hierarchical fit."""

from __future__ import annotations

COARSE = 64  # texels a side of the first stages
# The stages: coarse and free; the same from other starts (exact photos only); coarse and tied (a phone's only); full size.
ALONE, RIVALS, TOGETHER, FINE = range(4)
# Rounds until the costs of two starts can be compared, measured: after 20 the lower one was the worse material's in 4 of 40
# fits, after 26 in none. The robust start has its first in ALONE.
TRIAL = 26
ROUNDS = {ALONE: 12, RIVALS: 3 * TRIAL - 12, TOGETHER: 12, FINE: 14}
DEADLINE = {ALONE: 0.15, RIVALS: 0.4, TOGETHER: 0.5}  # share of the run at which a stage ends at the latest
TIED_ROUNDS = 6  # of FINE, for photos of a phone
REFINED = {ALONE: (11,), TOGETHER: (2, 4, 6, 8), FINE: (4,)}  # rounds after which the views are refined

# Structure that a free fit leaves at 64 px (:meth:`Hierarchical._unexplained`): six known materials 0.0003 to 0.0009 without
# noise and up to 0.004 with noise of 0.003 in linear radiance, twelve real captures 0.009 to 0.053.
EXACT = 0.006
DAMPING = 0.01  # that Levenberg-Marquardt starts with
STEPS, OTHER_STEPS = 6, 4  # Levenberg-Marquardt steps of a round, and of another start
LAST_STEPS = 8  # and at the end
