"""The rig: one lens, and its pose in each photo, from any source; and the rig as JSON."""

from collections.abc import Mapping, Sized
from dataclasses import dataclass, field
from typing import Literal

import msgspec
import numpy as np

from ..errors import CaptureError
from .lens import Lens, Pose

LEAST_PHOTOS = 3  # fewest photos from which views can be estimated


class OnePlace(CaptureError):
    """Photos that show everything in the same place: rectified already, or taken from a tripod."""


@dataclass(frozen=True)
class Rig:
    """A lens and its pose in each photo. The patch is the square around the world's origin."""

    lens: Lens  # what all photos share
    poses: dict[str, Pose]  # photo name to pose, of the photos that are used
    size: float  # side of the patch, in unit
    # unit of all lengths: cm with a sheet of known size, else patch sides (size is 1)
    unit: Literal["cm", "patch sides"]
    # source of the poses; none: the photos were rectified to their sheet before, so poses are unknown
    source: Literal["sheet", "photos", "none"]
    # photo name to RMS reprojection error, in pixels of the photo
    errors: dict[str, float] = field(default_factory=dict)
    rejected: dict[str, str] = field(default_factory=dict)  # photo name to reason, of the other photos
    # photo name to the standard deviation of its camera's position, in unit; only where it is known
    deviations: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # what the user should know about it
    # photo name to the number of the sheet's 16 tags that it shows; not in the JSON
    tags: dict[str, int] = field(default_factory=dict)


def rig_to_json(rig: Rig) -> dict:
    """A rig as numbers, lists and texts, for ``capture.json["rig"]``."""
    return {key: value for key, value in msgspec.to_builtins(rig, enc_hook=np.ndarray.tolist).items()
            if key != "tags"}


def check_enough(kept: Sized, rejected: Mapping[str, str], what: str = "that can be used",
                 fix: str = "take more photos from different places, flash on") -> None:
    """Raise CaptureError, with the reasons, if fewer than three photos are left; ``fix``: what to do."""
    if len(kept) >= LEAST_PHOTOS:
        return
    named: dict[str, list[str]] = {}
    for name, reason in rejected.items():
        named.setdefault(reason, []).append(name)
    reasons = "".join(f"; {', '.join(names)}: {reason}" for reason, names in named.items())
    raise CaptureError(f"{LEAST_PHOTOS} photos or more {what}",
                       f"{len(kept)} of {len(kept) + len(rejected)}{reasons}", fix)
