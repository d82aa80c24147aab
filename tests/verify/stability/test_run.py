"""Broken renderers are found out."""

import json
from typing import get_args

import pytest
import torch
from helpers import ANALYTIC
from helpers.one_sweep import FEW

from mitsvbrdf import cli
from mitsvbrdf.cli.stability import VERDICT_COLOURS, Sweep
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.measure.tolerances import SWEEP_TOLERANCES
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.verify.stability import SWEEPS, run
from mitsvbrdf.verify.stability.run import VERDICTS, verdict
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
def test_a_broken_renderer_is_found_out(one_case, monkeypatch, tmp_path, capsys, how, expected):
    monkeypatch.setattr("mitsvbrdf.cli.stability.make_renderer", lambda name, variant: Broken(how))
    out = tmp_path / "record.json"
    assert cli.main(["stability", "--renderer", "analytic", "--only", "tilt", "--json", str(out)]) == 1
    (violation,) = json.loads(out.read_text())["violations"]
    assert violation["renderer"] == "analytic" and violation["what"].startswith(expected)
    assert f"worse than expected: tilt, 85 degrees, analytic: {expected}" in capsys.readouterr().out


def test_an_unbroken_renderer_passes(one_case, tmp_path):
    out = tmp_path / "record.json"
    assert cli.main(["stability", "--renderer", "analytic", "--only", "tilt", "--json", str(out)]) == 0
    record = json.loads(out.read_text())
    (row,) = record["rows"]
    found = row["renderers"]["analytic"]
    assert record["violations"] == [] and found["verdict"] == "exact" and max(found["errors"].values()) < 1e-5
    assert set(row["limit"]) == set(found["errors"]) and row["condition"]["unknowns"] == 9


def test_the_command_knows_every_sweep_and_verdict(tmp_path, capsys):
    assert get_args(Sweep) == tuple(SWEEPS) and set(VERDICT_COLOURS) == set(VERDICTS)
    assert cli.main(["stability", "--only", "flat", "--json", str(tmp_path)]) == 2
    assert "a file to write" in capsys.readouterr().err


def test_what_is_invalid_and_not_refused_is_found_out(monkeypatch):
    monkeypatch.setattr(SVBRDF, "check", lambda self: self)
    case = Case("tilt", "normals of length 2", None, material(normal=2 * tilted(0)), FEW, refused=True)
    (found,) = run.violations([run.measured(case, [ANALYTIC])])
    assert found["what"].endswith("not refused")


IMAGE, GRADIENT = SWEEP_TOLERANCES["image"], SWEEP_TOLERANCES["gradient"]
GOOD = {"errors": {"image": IMAGE / 3, "roughness": GRADIENT / 3}, "not_finite": {"image": 0},
        "silenced": {"roughness": 0}}


def changed(**errors):
    return GOOD | {"errors": GOOD["errors"] | errors}


@pytest.mark.parametrize("expected, why, figures, options", [("exact", "", GOOD, {}),
    ("clamped", "alpha", GOOD, {"clamps": ["alpha"]}),
    ("degraded", "roughness", changed(roughness=5 * GRADIENT), {"limit": {"roughness": 6 * GRADIENT}}),
    ("degraded", "image", changed(image=5 * IMAGE), {"limit": {"image": 6 * IMAGE}, "clamps": ["alpha"]}),
    ("wrong", "roughness", changed(roughness=5 * GRADIENT), {"limit": {"roughness": 4 * GRADIENT}}),
    ("wrong", "image", changed(image=2 * IMAGE), {}),
    ("wrong", "inf", changed(image=None), {"known": (1.0, "cause")}),
    ("limited", "cause", changed(image=2 * IMAGE), {"known": (3 * IMAGE, "cause")}),
    ("wrong", "image", changed(image=4 * IMAGE), {"known": (3 * IMAGE, "cause")}),
    ("wrong", "7 of roughness come back as 0", GOOD | {"silenced": {"roughness": 7}}, {}),
    ("not finite", "2 of image", GOOD | {"not_finite": {"image": 2}}, {"known": (1.0, "cause")}),
    ("refused", "no", {"refused": "no"}, {}),
])
def test_verdicts(expected, why, figures, options):
    kind, reason = verdict(figures, options.pop("limit", {}), **options)
    assert kind == expected and kind in VERDICTS and why in reason
