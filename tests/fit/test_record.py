"""``fit.json`` of somebody else: read, or one error that names the file and what is wrong."""

import json

import pytest

from mitsvbrdf.errors import MapsError, MitsvbrdfError
from mitsvbrdf.fit.result import Fit
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.material.maps import flat

RECORD = {"schema_version": 1, "method": "direct", "renderer": "analytic", "variant": None,
    "bsdf": "roughconductor", "rerender_rmse": 0.1, "per_photo": {"00": 0.1}, "calibrated_rmse": None,
    "confidence": {"diffuse": {"median_sd": 0.1, "determined_share": 1.0}}, "burn_in": {"diffuse": 0.0},
    "warnings": [], "stopped": "iterations", "undone_steps": 0, "undone": [], "seconds": 1.0, "iterations": 1,
    "seed": 0, "config": {"fix": [], "grey_specular": False}, "command": {}, "omitted": [], "used": [],
    "capture": {"name": "shots", "photos": [0], "resolution": 8, "transfer": "srgb", "calibrated": True,
                "notes": []},
    "views": {"size": 1.0, "falloff": "inverse-square", "camera": [[0, 0, 2]], "light": [[0, 0, 2]],
              "intensity": [[1, 1, 1]]}, "flash_offset": {"x": 0.1, "y": 0.0, "unit": "patch sides"},
    "calibration": {"from": "given", "estimated": False, "refined": False, "power_told": None},
    "versions": {}, "machine": {}, "trace": [{"seconds": 1.0, "iteration": 1, "rerender_rmse": 0.1}]}
OTHERS = (None, True, -1, 1.5, 10**400, "x", [], [1], ["x"], {}, {"a": None}, ...)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("fit")
    save_maps(flat(8), place / "maps")
    return place


def test_a_record_of_an_earlier_version_has_what_pages_ask_for(folder):
    earlier = {name: value for name, value in RECORD.items() if name not in ("used", "calibrated_rmse")}
    (folder / "fit.json").write_text(json.dumps(earlier))
    fit = Fit.load(folder)
    assert (fit.record["used"], fit.record["calibrated_rmse"]) == ([], None)


def places(value, where=()):
    yield where
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in items:
        yield from places(part, (*where, key))


def with_other(place, other):
    record = inside = json.loads(json.dumps(RECORD))
    for key in place[:-1]:
        inside = inside[key]
    if other is ...:
        del inside[place[-1]]
    else:
        inside[place[-1]] = other
    return record


def test_the_record_itself_is_whole(folder):
    (folder / "fit.json").write_text(json.dumps(RECORD))
    assert Fit.load(folder).names == ["00"] and Fit.of_maps(folder).flash_offset == (0.1, 0.0)


@pytest.mark.parametrize("place", [place for place in places(RECORD) if place],
                         ids=lambda place: ".".join(map(str, place)))
def test_any_value_of_another_kind_is_read_or_one_error(place, folder):
    for other in OTHERS:
        (folder / "fit.json").write_text(json.dumps(with_other(place, other)))
        for read in (Fit.of_maps, Fit.load):
            try:
                fit = read(folder)
                used = [fit.seen, fit.side_metres, fit.record.get("warnings"), fit.small_photos]
                if read is Fit.load:
                    used += [fit.fixed, fit.names, fit.engine(), fit.svbrdf]
            except MitsvbrdfError as error:
                assert "fit.json" in str(error) or "renderer" in str(error)


@pytest.mark.parametrize("place, other, words", [
    (("views",), [], "views"), (("views", "camera"), [["x"]], "views.camera"),
    (("capture", "photos"), "0", "capture.photos"),
    (("flash_offset",), {"x": "a", "y": 1}, "could not convert"), (("calibration",), [1], "calibration"),
    (("rerender_rmse",), 10**400, "rerender_rmse is no finite number")])
def test_what_is_wrong_is_named(place, other, words, folder):
    (folder / "fit.json").write_text(json.dumps(with_other(place, other)))
    with pytest.raises(MapsError, match=f"fit.json: .*{words}"):
        Fit.of_maps(folder)
