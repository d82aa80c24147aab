"""Whether a fit of a stiff scene is to be trusted, and where it is not, whether it says so: one word by a
stated rule.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from ...fit.confidence import DETERMINED
from .scenes import CASES, SERIES, Scene

MAPS = ("diffuse", "specular", "roughness", "normal")
# of a map's error that its stated deviation must reach, to count as having said it: an error of two
# deviations
COVERED = 0.5

SOUND, SAID, PARTLY, SILENT, FAILED = "sound", "degraded, says so", "degraded, says part", "degraded silently", "failed"
RULE = {
    SOUND: f"every map is off by at most {DETERMINED:g} RMSE: as sure as a texel has to be that counts as "
           "determined",
    SAID: "a map is off by more; the fit warns of all that is wrong with its input, or, where nothing is, "
          "of anything; or the "
          f"deviations it states reach at least {COVERED:.0%} of the error of each such map",
    PARTLY: "a map is off by more; the fit warns of one thing that is wrong with its input, and not of "
            "another",
    SILENT: "a map is off by more, the deviations stated are too small, and no warning is of what is wrong "
            "with the input, or, "
            "where nothing is, there is none",
    FAILED: "an error message, a map or figure that is not finite or out of range, or photos met no better "
            "than by the start",
}


class Fault(NamedTuple):
    """What is wrong with an input, and what a warning of it says, one of these."""

    name: str
    words: tuple[str, ...]


def faults(scene: Scene) -> Iterator[Fault]:
    """What a fit should warn of; an extreme material is no fault."""
    if scene.clipped:
        yield Fault("clipped photos", ("pixels are clipped",))
    if scene.light != 1:
        words = ("stronger than stated",) if scene.light < 1 else ("weaker than stated",)
        yield Fault("light power", (*words, "light power or distances", "check views, light"))
    if scene.off:
        yield Fault("camera positions", ("view may be off", "check views", "distances may be off"))
    if scene.photos == 1:
        yield Fault("one photo", ("one photo",))
    if scene.same:
        yield Fault("identical photos", ("all alike", "the same picture"))
    if scene.grey:
        yield Fault("photos of one colour", ("of one colour",))


def scene_of(record: Mapping) -> Scene:
    """What a record's fit was given."""
    if record["kind"] == "case":
        return CASES[record["name"]]
    series, _, member = record["name"].partition(": ")
    return SERIES[series][member]


def warned(record: Mapping) -> tuple[list[str], list[str]]:
    """The faults of its input that a fit warns of, and those that it does not."""
    text = " ".join(record["warnings"])
    found: tuple[list[str], list[str]] = [], []
    for fault in faults(scene_of(record)):
        found[not any(words in text for words in fault.words)].append(fault.name)
    return found


def far_off(record: Mapping) -> list[str]:
    """The maps whose error is more than a sound fit's; all of them where there is no truth."""
    return [name for name in MAPS if not record["errors"].get(name, 1.0) <= DETERMINED]


def verdict(record: Mapping) -> str:
    """The word for one fit, by :data:`RULE`."""
    errors, stated = record["errors"], record["stated"]
    if record["why"] is not None or not errors["photos"] < errors["photos_start"]:
        return FAILED
    wrong = far_off(record)
    if not wrong:
        return SOUND
    said, unsaid = warned(record)
    covered = all(stated.get(name, 0.0) >= COVERED * errors.get(name, 1.0) for name in wrong)
    if covered or not unsaid and record["warnings"]:
        return SAID
    return PARTLY if said else SILENT
