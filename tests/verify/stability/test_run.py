"""Broken renderers are found out."""

import json
import math

import pytest
import torch
from helpers import ANALYTIC
from helpers.one_sweep import FEW

from mitsvbrdf import cli
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.report.stability_page import write_stability_markdown
from mitsvbrdf.verify.stability import functions, run, stability
from mitsvbrdf.verify.stability.sweeps import Case, material, tilted


class Broken(AnalyticRenderer):
    """Float32, with one thing spoilt."""

    def __init__(self, how):
        super().__init__()
        self.how = how

    def render(self, svbrdf, views):
        image = super().render(svbrdf, views)
        if self.how == "nan at grazing":
            return torch.where(svbrdf["normal"][..., 2:] < 0.2, torch.nan, image)
        if self.how == "refuses":
            raise ConfigError("something else", "this", "try again")
        keeps = {"silent": {"roughness": 0.0}, "wrong slope": {"diffuse": 1.001}}[self.how]
        maps = {n: v.detach() + keeps.get(n, 1.0) * (v - v.detach()) for n, v in svbrdf.maps.items()}
        return super().render(SVBRDF(svbrdf.bsdf, maps), views)


@pytest.mark.parametrize("how, expected", [("nan at grazing", "not finite: 1536 of image"),
                                           ("refuses", "refused: expected"),
                                           ("silent", "wrong: "), ("wrong slope", "wrong: diffuse 0.001")])
def test_a_broken_renderer_is_found_out(one_case, monkeypatch, tmp_path, how, expected):
    monkeypatch.setattr("mitsvbrdf.cli.stability.make_renderer", lambda name, variant: Broken(how))
    out = [f"--{kind}={tmp_path / kind}" for kind in ("json", "html")]
    assert cli.main(["stability", "--renderer", "analytic", "--only", "tilt", *out]) == 1
    record = json.loads((tmp_path / "json").read_text())
    (violation,) = record["violations"]
    assert violation["renderer"] == "analytic" and violation["what"].startswith(expected)
    assert violation["what"] in (tmp_path / "html").read_text().replace("&#39;", "'")
    write_stability_markdown(tmp_path / "md", record)
    assert expected.split(":")[0] in (tmp_path / "md").read_text()


def test_part_of_the_sweeps_does_not_replace_the_page_of_all(tmp_path):
    assert cli.main(["stability", "--only", "tilt", "--md", str(tmp_path / "md")]) == 2
    assert cli.main(["stability", "--renderer", "analytic", "--md", str(tmp_path / "md")]) == 2


def test_an_unbroken_renderer_passes(one_case):
    assert cli.main(["stability", "--renderer", "analytic", "--only", "tilt"]) == 0


def test_what_is_invalid_and_not_refused_is_found_out(monkeypatch):
    monkeypatch.setattr(SVBRDF, "check", lambda self: self)
    case = Case("tilt", "normals of length 2", None, material(normal=2 * tilted(0)), FEW, refused=True)
    (found,) = run.violations([run.measured(case, [ANALYTIC])])
    assert found["what"].endswith("not refused")


def test_a_function_that_lets_out_nan_is_found_out(one_case, monkeypatch):
    monkeypatch.setattr(functions, "map_rmse", lambda *_: {"mean": math.nan})
    (found,) = stability([ANALYTIC], ["tilt"])["violations"]
    assert found["renderer"] is None and found["what"] == "1 values of map_rmse are not finite"


def test_float64_that_is_off_is_found_out(one_case, monkeypatch):
    from mitsvbrdf.render import analytic

    right = analytic._smith
    monkeypatch.setattr(analytic, "_smith", lambda a2, cosine: right(a2, cosine) * (1 + 1e-5))
    (found,) = stability([], ["tilt"])["violations"]
    assert found["what"].startswith("float64 itself is off by")
