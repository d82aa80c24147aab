"""The word for a fit follows the stated rule."""

import pytest
from helpers.bench_records import stiff

from mitsvbrdf.bench.stiff.scenes import CASES, SERIES
from mitsvbrdf.bench.stiff.verdict import (
    FAILED,
    PARTLY,
    RULE,
    SAID,
    SILENT,
    SOUND,
    far_off,
    faults,
    scene_of,
    verdict,
    warned,
)

LIGHT_AND_CAMERAS = "black albedo, light 4x too strong, cameras 5 % off"
OFF, LIGHT = "photo 3 fits worse than the rest: its view may be off", "specular of 0.01: the light may be weaker than stated"


@pytest.mark.parametrize("word, record", [
    (SOUND, stiff(roughness=0.09)),
    (SOUND, stiff(name=LIGHT_AND_CAMERAS)),  # sound, though it does not warn
    (SILENT, stiff(roughness=0.11)),
    (SILENT, stiff(roughness=0.4, stated={"roughness": 0.19})),
    (SAID, stiff(roughness=0.4, stated={"roughness": 0.2})),
    # of the diffuse map it is too sure
    (SILENT, stiff(roughness=0.4, diffuse=0.2, stated={"roughness": 0.2})),
    (SAID, stiff(roughness=0.4, warnings=["anything"])),
    (SILENT, stiff(name=LIGHT_AND_CAMERAS, diffuse=0.4)),
    (SILENT, stiff(name=LIGHT_AND_CAMERAS, diffuse=0.4, warnings=["anything"])),
    (PARTLY, stiff(name=LIGHT_AND_CAMERAS, diffuse=0.4, warnings=[OFF])),
    (SAID, stiff(name=LIGHT_AND_CAMERAS, diffuse=0.4, warnings=[OFF, LIGHT])),
    (FAILED, stiff(photos=0.3)),
    (FAILED, stiff(why="MapsError: not finite")),
])
def test_the_word_follows_the_rule(word, record):
    assert verdict(record) == word and word in RULE


def test_without_a_truth_no_fit_is_sound():
    record = stiff(name="constant grey photos")
    record["errors"] = {"photos": 0.1, "photos_start": 0.2}
    assert far_off(record) == ["diffuse", "specular", "roughness", "normal"] and verdict(record) == SILENT
    assert verdict(record | {"warnings": ["every photo is of one colour"]}) == SAID


def test_what_is_wrong_with_an_input_follows_from_the_scene():
    assert warned(stiff(name=LIGHT_AND_CAMERAS, warnings=[LIGHT])) == (["light power"], ["camera positions"])
    harmless = {name for name, scene in CASES.items() if not list(faults(scene))}
    assert harmless == {"nothing wrong", "metal of roughness 0.05", "black albedo", "relief 3 times as deep"}
    assert scene_of({"kind": "series", "name": "roughness: 0.1"}) == SERIES["roughness"]["0.1"]
