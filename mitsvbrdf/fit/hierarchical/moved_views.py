"""How the fit moves camera and flash."""

from __future__ import annotations

LEVELLED, DAMPED = (4, 6, 8), 0.65  # rounds of ALONE after which the flash moves to level the patch, and by how much of it
TILTED = 0.03  # patch sides by which the flash seems moved where the patch is not level
FEW_STEPS = 10  # of refining views that were not stated: they move far, and will again after the next rounds
