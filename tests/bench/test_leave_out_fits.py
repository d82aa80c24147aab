"""What leaving parts of a fit out saves and costs, reckoned from stated fits; and the page made of it."""

import json
from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, GRID, ROOT

from mitsvbrdf.bench import leave_out_fits
from mitsvbrdf.bench.leave_out_fits import EXACT, REAL, Part, Scene, capture_folders, measure_fits, parts, scenes, verdict
from mitsvbrdf.bench.methods import Fitted
from mitsvbrdf.bench.tasks import known_material
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import HierarchicalConfig
from mitsvbrdf.verify.leave_out_page import fits_section, write_leave_out_markdown

USUAL = HierarchicalConfig(budget=leave_out_fits.UNLIMITED)


def stated(seconds, error):
    """A fit that takes this long, by whether texels try neighbours, and errs by so much in each diffuse texel."""
    def fit(photos, renderer, config):
        truth = known_material("builtin:inlay", 16, GRID, ANALYTIC).truth
        off = dict(truth.maps) | {"diffuse": (truth["diffuse"] + error[config.neighbours]).clamp(0, 1)}
        return Fitted(replace(truth, maps=off), 0.01, lambda shots: 0.0, 0.0, seconds[config.neighbours], 10, "settled")
    return fit


@pytest.mark.parametrize("put_in", [False, True])
def test_the_ratios_are_those_of_the_fits(put_in, monkeypatch):
    monkeypatch.setattr(leave_out_fits, "fit", stated({True: 6.0, False: 2.0}, {True: 0.05, False: 0.1}))
    scene = Scene(EXACT, known_material("builtin:inlay", 16, GRID, ANALYTIC))
    record = measure_fits([Part("starts", USUAL, replace(USUAL, neighbours=False), put_in)], [scene], 2)
    (item,), (about,) = record["items"], record["scenes"]
    assert item["ratio"] == {"median": 1 / 3 if put_in else 3.0, "low": 1 / 3 if put_in else 3.0,
                             "high": 1 / 3 if put_in else 3.0, "repeats": 2}
    assert (item["errors"]["maps"]["worst"] > 1.5) != put_in and item["errors"]["seen"]["median"] == 1
    assert item["verdict"] == ("no time saved" if put_in else "needed") and about["seconds"]["median"] == 6
    assert f"| starts | hierarchical | exact{', by itself' if put_in else ''} | 1 |" in fits_section(record)


@pytest.mark.parametrize("ratio, worst, word", [(2.0, 1.05, "needed"), (2.0, 1.01, "not needed"), (1.02, 0.9, "no time saved")])
def test_verdicts(ratio, worst, word):
    errors = {"new light": {"median": 1.0, "worst": worst}, "seen": {"median": 3.0, "worst": 9.0}}
    assert verdict(ratio, errors) == word


def test_a_table_is_as_before_even_after_an_error():
    table = {"a": 1, "b": 2}
    with pytest.raises(ZeroDivisionError), leave_out_fits.changed(table, {"a": 3}):
        table["a"] / (table["a"] - 3)
    assert table == {"a": 1, "b": 2}


def test_what_is_fitted(tmp_path):
    made = list(scenes(16))
    assert {scene.kind for scene in made} == {*leave_out_fits.FOLLOWING, *leave_out_fits.OTHERS} - {REAL}
    matte = next(scene.task for scene in made if scene.kind == leave_out_fits.MATTE)
    assert not matte.truth["specular"].any() and torch.isfinite(matte.photos.photos).all()
    assert all((part.other != part.config) + bool(part.photos) + bool(part.rounds) == 1 for part in parts())
    (tmp_path / "captures" / "bamboo").mkdir(parents=True)
    assert capture_folders(None, tmp_path) == capture_folders("bamboo", tmp_path) == [tmp_path / "captures" / "bamboo"]
    with pytest.raises(ConfigError, match="none called oak"):
        capture_folders("bamboo, oak", tmp_path)


def test_the_page_is_made_of_the_record(tmp_path):
    record = json.loads((ROOT / "docs" / "results" / "leave-out.json").read_text())
    write_leave_out_markdown(tmp_path / "page.md", record)
    assert (tmp_path / "page.md").read_text() == (ROOT / "docs" / "leave-out.md").read_text()
