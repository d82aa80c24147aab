"""The record of a cross-check and its page."""

import json
import re

import pytest
from helpers import ANALYTIC, TWIN
from helpers.crosschecks import THREE
from helpers.tables import words_at_the_right

from mitsvbrdf.material.made import make_material
from mitsvbrdf.measure.gradients import render_and_gradients
from mitsvbrdf.measure.metrics import image_error
from mitsvbrdf.measure.tolerances import TOLERANCES
from mitsvbrdf.report.crosscheck_page import write_crosscheck_page
from mitsvbrdf.verify.crosscheck import crosscheck


def test_the_record_is_json_and_counts_every_texel(real):
    record = json.loads(json.dumps(real[0], allow_nan=False))
    assert record["reference"] == "analytic64" and record["tolerances"] == TOLERANCES
    assert record["versions"]["torch"] and record["machine"]["cores"]
    assert record["materials"]["leather"]["converted"].keys() == {"principled"}
    for c in record["configurations"]:
        assert sum(c[k]["texels"] for k in ("rough", "smooth") if c[k]) == 24 * 24
        assert c["worst_view"] in record["views"]["names"] and c["worst_texels"]
        assert ("ray tracing" in {each["what"] for each in c["omitted"]}) == (
            c["renderer"] != "mitsuba-scene")


def test_figures_are_those_of_the_metrics():
    # All texels of leather are rough, so the figures have to be those of the plain comparison.
    svbrdf, renderer = make_material("leather", 16), ANALYTIC
    (c,) = crosscheck({"leather": svbrdf}, THREE, ["roughconductor"], [renderer], repeats=1)["configurations"]
    exact, got = render_and_gradients(TWIN, svbrdf, THREE), render_and_gradients(renderer, svbrdf, THREE)
    assert c["rough"]["image"] == pytest.approx(image_error(got.image, exact.image) | {"not_finite": 0},
                                                rel=1e-9)
    worst = c["worst_texels"][0]
    assert worst["relative_error"] == pytest.approx(c["rough"]["image"]["worst"], rel=1e-9)
    at = (int(worst["view"]), worst["row"], worst["column"], "rgb".index(worst["channel"]))
    assert (worst["value"], worst["reference"]) == (float(got.image[at]), float(exact.image[at]))
    for name, g in c["rough"]["gradients"].items():
        off = (got.gradients[name].double() - exact.gradients[name]).norm() / exact.gradients[name].norm()
        assert g["relative_l2"] == pytest.approx(float(off), rel=1e-9)


def test_page_shows_every_configuration_and_needs_no_network(real, tmp_path):
    record, maps = real
    record = record | {"violations": [{"material": "leather", "bsdf": "principled", "renderer": "mitsuba",
                                       "what": "made <up>",
                                       "value": 1.25e-3, "tolerance": 1e-6, "limit": None}]}
    write_crosscheck_page(tmp_path / "page.html", record, maps)
    page = (tmp_path / "page.html").read_text()
    references = re.findall(r"""(?:src|href)=["']?([^"'\s>]+)""", page) + re.findall(r"url\(([^)]+)\)", page)
    assert references and all(target.startswith(("data:", "#")) for target in references)
    assert "<script" not in page and "@import" not in page
    for c in record["configurations"]:
        assert f'alt="error map of {c["material"]}, {c["renderer"]} · {c["bsdf"]}"' in page
    assert "made &lt;up&gt;" in page and "0.00125" in page
    assert "made <up>" not in page
    assert "<td" in page and not words_at_the_right(page)
