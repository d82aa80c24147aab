"""Published results for the materials and captures of a benchmark, from ``peers.json`` in the folder of
data.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from ..errors import ConfigError
from ..io.json_files import load
from .schema import capture_kind
from .tasks import KnownMaterial, Task

PUBLISHED_SIDE = 256  # the published numbers are for photos and maps of this size
METHOD_NAMES = {"materialgan": "MaterialGAN", "gao2019": "Gao 2019", "deschaintre2019": "Deschaintre 2019",
         "deschaintre2019-gao2019": "Deschaintre + Gao 2019"}
PEERS_LEFT_OUT = (7, 8)  # the photos that the field's protocol leaves out of fits to 0 to 6
PEERS_BLIND = "left_out_7_8_rmse_256"  # their errors, in peers.json
BLIND = " without them"  # behind the name of a method that did not see the photos left out either
PUBLISHED_MAPS = ("diffuse", "specular", "roughness", "normal")

Published = dict[str, dict[str, dict[str, dict[str, float]]]]


def published(path: Path, tasks: Sequence[Task], resolution: int) -> Published:
    """Kind -> name -> whose -> error -> value, in the names that records use; empty at another size than the
    numbers' own.

    Materials have RMSE of each map and their ``mean``, on the publishers' own photos of them. Captures stand
    under the kind :func:`mitsvbrdf.bench.schema.capture_kind` of the photos left out and have MaterialGAN's
    errors of the photos that fits here see and leave out; it saw all of them. Where photos 7 and 8 are left
    out, they also have the errors of methods that did not see these either.

    Args:
        path: ``peers.json``; a missing file has nothing.
        tasks: what is fitted.
        resolution: of the fits.

    Raises:
        ConfigError: the file cannot be understood.
    """
    found: Published = {"material": {}}
    if not path.is_file() or resolution != PUBLISHED_SIDE:
        return found
    try:
        stated = load(path)
        for task in tasks:
            if isinstance(task, KnownMaterial):
                if task.folder is not None and task.name in stated["materials"]:
                    found["material"][task.name] = {METHOD_NAMES.get(who, who): _with_mean(maps)
                                                    for who, maps in stated["materials"][task.name].items()}
            elif task.name in stated["captures"]:
                each = stated["captures"][task.name]["per_view"]
                parts = {"seen": task.photos.index} | ({"left_out": task.unseen.index} if task.unseen else {})
                here = found.setdefault(capture_kind(task.left_out), {})
                here[task.name] = {"MaterialGAN": {
                    part: math.sqrt(sum(each[i] ** 2 for i in index) / len(index))
                    for part, index in parts.items()}}
                if parts.get("left_out") == PEERS_LEFT_OUT:
                    blind = stated["captures"][task.name].get(PEERS_BLIND, {})
                    here[task.name] |= {METHOD_NAMES.get(who, who) + BLIND: {"left_out": float(error)}
                                        for who, error in blind.items()}
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as reason:
        raise ConfigError("peers.json with materials and captures", f"{path}: {reason!r}",
                          "mend it, or take it away") from None
    return found


def predicted_by_peers(path: Path) -> list[str]:
    """The captures of which ``peers.json`` has the errors of methods that did not see photos 7 and 8.

    Raises:
        ConfigError: there is no such file, or it cannot be understood.
    """
    try:
        return [name for name, stated in load(path)["captures"].items() if PEERS_BLIND in stated]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as reason:
        raise ConfigError("peers.json with captures beside the data", f"{path}: {reason!r}",
                          "give the numbers of the photos to leave out") from None


def _with_mean(maps: dict[str, float]) -> dict[str, float]:
    values = {name: float(maps[name]) for name in PUBLISHED_MAPS}
    return values | {"mean": sum(values.values()) / len(values)}
