"""The rig: one lens, and where it stood in each photo, however that was found; and its JSON."""

from collections.abc import Mapping, Sized
from dataclasses import dataclass, field
from typing import Literal

import msgspec
import numpy as np

from ..errors import CaptureError
from .lens import Lens, Pose

LEAST_PHOTOS = 3  # from which views can be found


class OnePlace(CaptureError):
    """Photos that show everything in the same place: rectified already, or taken from a tripod."""


@dataclass(frozen=True)
class Rig:
    """A lens and where it stood in each photo. The patch is the square around the world's origin."""

    lens: Lens  # what all photos share
    poses: dict[str, Pose]  # by name of the photo, of the photos that are used
    size: float  # side of the patch, in unit
    # of all lengths: cm where a sheet of known size was seen, else patch sides (size is 1)
    unit: Literal["cm", "patch sides"]
    # source of the poses; none: photos rectified to their sheet, of which only the patch is known
    source: Literal["sheet", "photos", "none"]
    # RMS reprojection error in pixels of the photo, by name
    errors: dict[str, float] = field(default_factory=dict)
    rejected: dict[str, str] = field(default_factory=dict)  # reason, by name of each photo that is not used
    # standard deviation of a camera's position in unit, by name, where it is known
    deviations: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # what the user should know about it
    # how many of the sheet's 16 tags each photo shows, by name; not in the JSON
    tags: dict[str, int] = field(default_factory=dict)


def rig_to_json(rig: Rig) -> dict:
    """A rig as numbers, lists and texts, for ``capture.json["rig"]``."""
    return {key: value for key, value in msgspec.to_builtins(rig, enc_hook=np.ndarray.tolist).items()
            if key != "tags"}


def check_enough(kept: Sized, rejected: Mapping[str, str], what: str = "that can be used",
                 fix: str = "take more photos from different places, flash on") -> None:
    """Raise CaptureError, with the reasons, where fewer than three photos are left; ``fix``: the way out."""
    if len(kept) >= LEAST_PHOTOS:
        return
    named: dict[str, list[str]] = {}
    for name, reason in rejected.items():
        named.setdefault(reason, []).append(name)
    reasons = "".join(f"; {', '.join(names)}: {reason}" for reason, names in named.items())
    raise CaptureError(f"{LEAST_PHOTOS} photos or more {what}",
                       f"{len(kept)} of {len(kept) + len(rejected)}{reasons}", fix)
