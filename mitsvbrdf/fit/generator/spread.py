"""How much the maps depend on which photo is the input: the fault that the paper names of its own method
(IV.C).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from ...errors import ConfigError
from ...material.maps import SVBRDF
from ...measure.metrics import map_rmse
from .gan import Gan


def input_spread(method: Gan) -> dict[str, float]:
    """:func:`spread_of` the maps that a generator, as it is trained now, makes with each photo in turn in the
    first place.

    The two-stream generator sees that photo alone; the others see all photos, in the order i, i + 1, ..., i -
    1.
    """
    return spread_of([method.maps_from(photo) for photo in range(len(method.capture))])


def spread_of(materials: Sequence[SVBRDF]) -> dict[str, float]:
    """Standard deviation over the materials, rooted mean square over texels and channels, encoded as map
    errors are.

    Args:
        materials: two or more, of one size.

    Returns:
        ``diffuse``, ``specular``, ``roughness``, ``normal`` and their ``mean``.

    Raises:
        ConfigError: fewer than two materials.
    """
    count = len(materials)
    if count < 2:
        raise ConfigError("two or more materials", str(count), "the spread is that between several photos")
    # The variance around the mean is the mean squared distance of all pairs, over 2.
    pairs = [map_rmse(a, b) for a, b in itertools.combinations(materials, 2)]
    found = {name: math.sqrt(sum(pair[name] ** 2 for pair in pairs)) / count for name in pairs[0]
             if name != "mean"}
    return found | {"mean": sum(found.values()) / len(found)}
