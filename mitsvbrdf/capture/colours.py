"""What photos state of their colours, told once for all photos of a capture."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

from ..color import Transfer
from ..errors import InputWarning
from ..io.colour_profile import Profile


@dataclass(frozen=True)
class Converted:
    """Photos of one profile, converted to sRGB: how many, and the share of pixels that lay outside of it."""

    photos: int
    outside: float


def converted(stated: Mapping[str, Profile | None], outside: Mapping[str, float]) -> dict[str, Converted]:
    """What was converted, by the profile's name.

    Args:
        stated: profiles by name of the photo; None: sRGB.
        outside: shares of pixels outside of sRGB, by name of the photos that are used.

    Warns:
        InputWarning: a profile that cannot be used.
    """
    names: dict[Profile, list[str]] = {}
    for name in outside:
        if profile := stated.get(name):
            names.setdefault(profile, []).append(name)
    for profile, those in names.items():
        if profile.reason:
            more = f" and {len(those) - 1} more photos" if those[1:] else ""
            warnings.warn(f"{those[0]}{more}: {profile.name} cannot be used ({profile.reason}); the values "
                          "are taken as sRGB; export the photos as sRGB", InputWarning, stacklevel=2)
    return {profile.name: Converted(len(those), sum(outside[name] for name in those) / len(those))
            for profile, those in names.items() if not profile.reason}


def notes_of(colours: Mapping[str, Converted]) -> list[str]:
    """A line for each profile."""
    return [f"{found.photos} photo{'s' * (found.photos > 1)} of colour profile {name}: converted to sRGB; "
            f"{found.outside:.2%} of the pixels lie outside of sRGB and were moved to its edge"
            for name, found in colours.items()]


def used_transfer(transfer: Transfer, colours: Mapping[str, Converted]) -> tuple[Transfer, list[str]]:
    """The transfer function to use: values that were converted are those of sRGB, not linear; and a note."""
    if transfer != "linear" or not colours:
        return transfer, []
    return "srgb", [f"transfer srgb is used, not linear: the photos state the profile {', '.join(colours)}, "
                    "by which they were converted; remove it to have their values as they are"]
