"""How methods behave, as far as a benchmark depends on it: which draw random numbers, and which fit a longer
budget repeats.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..fit import DirectConfig, FitConfig, HierarchicalConfig
from ..fit.hierarchical.stages import DEADLINE
from .peers_baseline import PeersConfig

NO_RANDOMNESS = (DirectConfig, PeersConfig)  # the same bits from every seed

# Settings -> how a fit ends by itself, and by which share of its budget it must have ended for every longer
# budget to give the same bits: steps of the baseline know no budget; those of `hierarchical` know deadlines,
# the first at this share.
ENDS = {PeersConfig: ("iterations", 1.0), HierarchicalConfig: ("settled", min(DEADLINE.values()))}


def draws(config: FitConfig) -> bool:
    """Whether a fit with these settings depends on its seed."""
    return not isinstance(config, NO_RANDOMNESS)


def record_draws(record: Mapping) -> bool:
    """The same of the settings in a record."""
    return record["config"].get("class") not in [kind.__name__ for kind in NO_RANDOMNESS]


def ended_for_good(record: Mapping) -> bool:
    """Whether a fit ended by itself, and so early that a longer budget would give the same result again."""
    for kind, (stopped, share) in ENDS.items():
        if record["config"].get("class") == kind.__name__:
            return bool(record["stopped"] == stopped and record["seconds"] <= share * record["budget"])
    return False
