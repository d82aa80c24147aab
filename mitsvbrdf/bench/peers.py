"""Errors that other methods' authors published for the same materials and captures."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..capture import Capture
from ..errors import ConfigError
from ..io.json import read_json
from .tasks import KnownMaterial, RealCapture, Task

PUBLISHED_SIDE = 256  # published numbers are for photos and maps of this size
PEERS = {"materialgan": "MaterialGAN", "gao2019": "Gao 2019", "deschaintre2019": "Deschaintre 2019",
         "deschaintre2019-gao2019": "Deschaintre + Gao 2019"}
PEERS_HELD_OUT = (7, 8)  # photos that the field's protocol holds out
PEERS_BLIND = "left_out_7_8_rmse_256"  # key in peers.json: errors of methods that did not see these
MAPS = ("diffuse", "specular", "roughness", "normal")


def published(path: Path, tasks: Sequence[Task]) -> list[dict]:
    """Errors that authors of other methods published for these tasks; only tasks of their size have some.

    MaterialGAN saw all photos of a capture: its error of those held out has the name "MaterialGAN, which saw
    them". Where photos 7 and 8 are held out, there are also errors of methods that did not see them.

    Args:
        path: ``peers.json``; a missing file has nothing.
        tasks: what is fitted.

    Returns:
        Rows like records, with ``method``, the task's key and ``errors``.

    Raises:
        ConfigError: the file cannot be understood.
    """
    if not path.is_file():
        return []
    what, fix = "peers.json with materials and captures", "mend it, or take it away"
    stated = read_json(path, ConfigError, what, fix)
    try:
        return [{"method": who, **task.key, "errors": errors}
                for task in tasks if task.photos.resolution == PUBLISHED_SIDE
                for who, errors in (_of_material(stated, task) if isinstance(task, KnownMaterial)
                                    else _of_capture(stated, task)).items()]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as reason:
        raise ConfigError(what, f"{path}: {reason!r}", fix) from None


def _of_material(stated: Mapping, task: KnownMaterial) -> dict[str, dict[str, float]]:
    found = {}
    for who, errors in (stated["materials"].get(task.name, {}) if task.folder else {}).items():
        maps = {name: float(errors[name]) for name in MAPS}
        found[PEERS.get(who, who)] = maps | {"mean": statistics.fmean(maps.values())}
    return found


def _of_capture(stated: Mapping, task: RealCapture) -> dict[str, dict[str, float]]:
    numbers = stated["captures"].get(task.name)
    if numbers is None:
        return {}

    def together(shots: Capture) -> float:
        return math.sqrt(statistics.fmean(numbers["per_view"][i] ** 2 for i in shots.index))

    found = {"MaterialGAN": {"seen": together(task.photos)}}
    if task.unseen is not None:
        if task.unseen.index == PEERS_HELD_OUT:
            for who, error in numbers.get(PEERS_BLIND, {}).items():
                found.setdefault(PEERS.get(who, who), {})["held_out"] = float(error)
        found["MaterialGAN, which saw them"] = {"held_out": together(task.unseen)}
    return found
