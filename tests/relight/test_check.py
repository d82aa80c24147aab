"""Curves of the error, and the check of novel pictures."""

import torch

from mitsvbrdf.cli.relight import relight
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.relight.check import check_novel
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.render.needs import Needs
from mitsvbrdf.report.charts import error_curve


def test_error_curve_is_the_same_file_in_every_run(tmp_path):
    curve = [{"seconds": 0.5 * 2**k, "samples": 2**k, "error": 0.1 / 2 ** (k / 2)} for k in range(6)]
    error_curve(tmp_path / "a.svg", [curve, curve[1:]], 0.02, "two")
    error_curve(tmp_path / "b.svg", [curve, curve[1:]], 0.02, "two")
    assert (tmp_path / "b.svg").read_bytes() == (tmp_path / "a.svg").read_bytes()
    error_curve(tmp_path / "empty.svg", [[]])
    assert "<svg" in (tmp_path / "empty.svg").read_text()


def test_novel_is_the_analytic_picture_and_has_real_fresnel(mi):
    material = make_material("leather", 32)
    assert check_novel(mi, material).passed
    assert check_novel(mi, material, frame=2, frames=5, seed=50).passed
    constant = check_novel(mi, material,
                           reference=AnalyticRenderer(torch.float64, Needs(fresnel_curve=False)))
    # 60 seen: F0 everywhere is told apart
    assert not constant.passed and float(constant.bias.abs().max()) > 20


def test_check_says_what_it_found(tmp_path, capsys):
    save_maps(make_material("inlay", 24), tmp_path)
    assert relight(str(tmp_path), check=True) == 0
    assert "the same but for noise" in capsys.readouterr().out
