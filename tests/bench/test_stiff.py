"""Fits that are asked too much end finite and warn."""

import dataclasses
import json
import math

import pytest
import torch
from helpers import ANALYTIC, GRID
from helpers.variants import mostly_slow

from mitsvbrdf.bench import stiff
from mitsvbrdf.capture import Capture
from mitsvbrdf.errors import exit_code
from mitsvbrdf.fit import DirectConfig, GanConfig, HierarchicalConfig, HybridConfig, fit_svbrdf
from mitsvbrdf.material.maps import flat
from mitsvbrdf.synth.photograph import photograph

SIDE = 16

WARNS = {"30 % of the pixels clipped": "% of the pixels are clipped", "light stated 4x too weak": "as white as can be",
         "light stated 4x too strong": "below that of any known material", "a single photo": "one photo",
         "nine identical photos": "all alike", "constant grey photos": "one colour"}


@pytest.mark.parametrize("name", stiff.CASES)
def test_stiff_fits_end_finite_and_warn(name):
    case = stiff.CASES[name](SIDE)
    iterations = 150 if name == "light stated 4x too strong" else 40  # until specular is as low as it gets
    row = stiff.run(case, DirectConfig(iterations=iterations), ANALYTIC)
    json.dumps(row, allow_nan=False)
    # No worse than the start: what is reported is the best state met.
    assert row["rerender_rmse"] <= row["start_rmse"] and row["stopped"] == "iterations"
    assert any(WARNS.get(name, "") in warning for warning in row["warnings"]) or name not in WARNS
    if name in ("a single photo", "nine identical photos", "constant grey photos"):
        assert row["confidence"]["roughness"]["determined_share"] < 0.05


@pytest.mark.parametrize("config", [HybridConfig(width=4, iterations=12), GanConfig(width=4, iterations=12)])
@pytest.mark.parametrize("name", ["metal of roughness 0.05", "black albedo", "relief up to 60 degrees",
                                  "30 % of the pixels clipped", "light stated 4x too weak", "light stated 4x too strong",
                                  "a single photo", "constant grey photos"])
def test_the_networks_too(name, config):
    row = stiff.run(stiff.CASES[name](SIDE), config, ANALYTIC)
    json.dumps(row, allow_nan=False)
    assert row["rerender_rmse"] <= row["start_rmse"] and not row["undone"] and not row["restarts"]


def test_the_table_takes_each_method_as_it_comes():
    for config in (make(3.0, 7) for make in stiff.CONFIGS.values()):
        assert config == type(config)(budget=3.0, seed=7)


# These cases' photos are no exact ones of any material: they are fitted as a phone's, from one start.
ONE_START = {"light stated 4x too weak", "camera positions 5 % off", "nine identical photos", "constant grey photos"}


@pytest.mark.parametrize("name", mostly_slow(stiff.CASES, "nine identical photos", "black albedo", "metal of roughness 0.05"))
def test_the_default_settles_and_ends_finite(name):
    row = stiff.run(stiff.CASES[name](SIDE), HierarchicalConfig(iterations=100), ANALYTIC)
    json.dumps(row, allow_nan=False)
    assert row["stopped"] == "settled" and not row["undone"]
    # Rounds of 12, 12 and 6; of exact photos, other starts end after 40 % of the limit, and 14 rounds follow.
    assert row["iterations"] == (12 + 12 + 6 if name in ONE_START else 40 + 14)
    assert any(WARNS.get(name, "") in warning for warning in row["warnings"]) or name not in WARNS
    if name in ("a single photo", "nine identical photos", "constant grey photos"):
        assert row["confidence"]["roughness"]["determined_share"] < 0.05  # measured 0
    # The last maps are reported, whatever their error. Measured: 0.80 of that of the start (constant grey photos) and less.
    assert row["rerender_rmse"] < 0.95 * row["start_rmse"]


def test_the_table_and_its_record(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(stiff, "CASES", {"a single photo": stiff.one_photo, "none": lambda side: 1 / 0})
    monkeypatch.setitem(stiff.CASES, "none", lambda side: stiff.Case(Capture(torch.full((1, side, side, 3), math.nan),
                                                                             GRID.pick([0]))))
    assert stiff.main(tmp_path / "s.json", budget=0.2, resolution=SIDE, methods=("direct",), renderer="analytic") == 1
    single, broken = json.loads((tmp_path / "s.json").read_text())["rows"]
    assert single["case"] == "a single photo" and single["rerender_rmse"] >= 0 and single["map_rmse"]["mean"] > 0
    assert "finite" in broken["error"]  # photos of NaN: an error that says so, not a table of NaN
    assert "a single photo, direct: one photo" in capsys.readouterr().out


def test_ctrl_c_ends_the_table_and_keeps_what_is_finished(tmp_path, monkeypatch, capsys):
    fits, fit = iter(range(9)), stiff.fit_svbrdf

    def second_interrupted(*given, **options):
        if next(fits) == 0:
            return fit(*given, **options)
        return dataclasses.replace(fit(*given, **options), stopped="interrupted")  # as the loop says after Ctrl-C

    def run():
        return stiff.main(tmp_path / "s.json", budget=0.2, resolution=SIDE, methods=("direct",), renderer="analytic")

    monkeypatch.setattr(stiff, "fit_svbrdf", second_interrupted)
    assert exit_code(run, "interrupted") == 130
    (row,) = json.loads((tmp_path / "s.json").read_text())["rows"]
    assert row["stopped"] == "budget" and next(fits) == 2
    assert capsys.readouterr().err == "interrupted\n"
    assert exit_code(lambda: stiff.main(tmp_path)) == 2 and "a file to write" in capsys.readouterr().err


@pytest.mark.parametrize("strength", [1e-9, 1e9])
@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_light_far_too_weak_or_strong(strength, value):
    views = GRID
    views = dataclasses.replace(views, intensity=views.intensity * strength)
    result = fit_svbrdf(Capture(torch.full((9, SIDE, SIDE, 3), value), views), ANALYTIC, DirectConfig(iterations=11))
    result.svbrdf.check()
    assert not result.undone and all(math.isfinite(e["rerender_rmse"]) for e in result.trace)


def test_photographs_are_8_bits_and_noisy():
    truth, views = flat(8, diffuse=0.3), GRID
    clean, noisy = (photograph(truth, views, ANALYTIC, noise, seed=1, transfer="srgb") for noise in (0.0, 0.01))
    assert torch.equal((clean.photos * 255).round() / 255, clean.photos) and clean.transfer == "srgb"
    assert float((noisy.linear - clean.linear).std()) == pytest.approx(0.01, rel=0.1)
