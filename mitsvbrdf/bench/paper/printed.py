"""What the paper prints: RMSE of result sets 4 and 5 (IV.B, tables 1 and 2)."""

from __future__ import annotations

from ..published import PUBLISHED_MAPS, Published

GUESS = "guess"  # the guessed diffuse map, among errors of maps
PAPER = "the paper"

_SETS = {
    "set 4": {"Gao 2019": (0.031, 0.054, 0.059, 0.067), "MaterialGAN": (0.031, 0.024, 0.047, 0.068),
              PAPER: (0.085, 0.208, 0.451, 0.143, 0.071)},
    "set 5": {"Gao 2019": (0.029, 0.071, 0.035, 0.039), "MaterialGAN": (0.035, 0.058, 0.102, 0.047),
              PAPER: (0.089, 0.277, 0.284, 0.157, 0.070)}}


def printed() -> Published:
    """``paper`` -> set -> whose -> map -> RMSE, as :class:`mitsvbrdf.bench.records.Benchmark` keeps published
    numbers.
    """
    names = (*PUBLISHED_MAPS, GUESS)
    return {"paper": {which: {who: dict(zip(names, values)) for who, values in rows.items()}
                      for which, rows in _SETS.items()}}
