"""What a page says of the renderers is what they are measured to be."""

import json
import re

import pytest
import torch
from helpers import ANALYTIC, GRID
from helpers.fit_pages import SIDE, Page

from mitsvbrdf import cli
from mitsvbrdf.fit.result import Fit
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.measure.gradients import fixed_cotangent
from mitsvbrdf.render import make_renderer
from mitsvbrdf.report.checks import fit_report
from mitsvbrdf.report.page import figure, seconds


def test_the_quick_check_is_the_error_of_the_fits_renderer(fitted):
    record, svbrdf = json.loads((fitted / "report.json").read_text()), load_maps(fitted)
    check = record["crosscheck"]
    views = Fit.of_maps(fitted).views.pick([0, 1])
    exact, found = {}, {}
    for into, name, dtype in ((exact, "analytic64", torch.float64), (found, "analytic", torch.float32)):
        maps = {n: t.to(dtype).clone().requires_grad_() for n, t in svbrdf.maps.items()}
        into["image"] = make_renderer(name).render(SVBRDF(svbrdf.bsdf, maps), views)
        into["image"].backward(fixed_cotangent(into["image"].shape).to(dtype))
        into |= {n: t.grad.double() for n, t in maps.items()}
    image, truth = (part["image"].detach().double() for part in (found, exact))
    errors = (image - truth).abs() / truth.clamp_min(1e-3 * truth.mean())
    (row,) = check["rows"]
    assert check["views"] == ["00", "01"] and check["resolution"] == SIDE and row["renderer"] == "analytic"
    assert row["image"]["mean"] == pytest.approx(float(errors.mean()), rel=0.02)
    for name, figures in row["gradients"].items():
        relative = float((found[name] - exact[name]).norm() / exact[name].norm())
        assert figures["relative_l2"] == pytest.approx(relative, rel=0.02)
    assert check["violations"] == []


@pytest.mark.parametrize("value, said", [
    (None, "–"), (3.21e-7, "3.2e-07"), (0.01234, "0.0123"), (12.34, "12.3"), (999.7, "1000"),
    (-1234, "-1230"), (12345, "1.2e+04"), (float("inf"), "inf")])
def test_figures_have_three_digits(value, said):
    assert figure(value) == said and seconds(1234) == "1230 s"


@pytest.mark.slow
def test_all_renderers_are_checked_and_timed(measured):
    _, fit, record, page = measured
    assert not record["quick"] and record["crosscheck"]["views"] == list(fit["per_photo"])
    checked = record["crosscheck"]["rows"]
    assert {row["renderer"] for row in checked} == {"analytic", "mitsuba", "mitsuba-scene"}
    for row in checked:
        errors = [row["image"][name] for name in ("mean", "p99.9", "worst")]
        errors += [gradient["relative_l2"] for gradient in row["gradients"].values()]
        cells = page.row(row["renderer"])
        assert cells[:7] == [figure(error) for error in errors]
        assert len(cells) == 9 and all(re.fullmatch(r"[\d.e-]+ m?s", cell) for cell in cells[7:])
    assert record["crosscheck"]["violations"] == []


def test_of_many_photos_some_views_are_checked(monkeypatch):
    # Memory grows with texels and views; nothing is measured worse with 25 of them.
    monkeypatch.setattr("mitsvbrdf.report.checks._available", lambda *_: [])
    names = [f"{k:02d}" for k in range(60)]
    for count, quick, chosen in ((60, False, names[::3]), (25, False, names[:25]), (60, True, names[:2])):
        record = fit_report(make_material("tiles", 8), GRID.pick([k % 9 for k in range(count)]), ANALYTIC,
                            names=names[:count], transfer="gamma2.2", quick=quick)
        assert record["crosscheck"]["views"] == chosen


@pytest.mark.slow
def test_a_renderer_of_ones_own_is_not_checked(copy):
    record = json.loads((copy / "fit.json").read_text()) | {"renderer": "mine"}
    (copy / "fit.json").write_text(json.dumps(record))
    assert cli.main(["report", str(copy)]) == 0
    found = json.loads((copy / "report.json").read_text())
    assert {row["renderer"] for row in found["crosscheck"]["rows"]} == {
        "mitsuba", "mitsuba-scene", "analytic"}
    assert cli.main(["report", str(copy), "--quick"]) == 0
    assert "was not checked" in Page(copy / "report.html").text
