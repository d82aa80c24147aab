"""The figures of the finish are those of the pictures, and the page says what the record says."""

import dataclasses
import json
from pathlib import Path

import pytest
from helpers import ANALYTIC, photos_of

from mitsvbrdf.bench import finish as bench
from mitsvbrdf.bench.finish import figures, page, passes, write
from mitsvbrdf.fit import HierarchicalConfig, fit_svbrdf
from mitsvbrdf.fit.finish_config import FinishConfig
from mitsvbrdf.material.made import make_material
from mitsvbrdf.measure.metrics import photo_rmse

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def row():
    truth = make_material("tiles", 32)
    shots = photos_of(truth)
    kept = shots.pick((0, 1, 2, 3))
    solved = fit_svbrdf(kept, ANALYTIC, HierarchicalConfig(iterations=3))
    # A look that is the truth: its photos are the photos but for 8 bits.
    look = dataclasses.replace(solved, look=truth, flash_offset=None, finish={"rerender_rmse": 0.0,
                                                                              "seconds": 1.0})
    left = shots.pick((4, 7))
    by_hand = photo_rmse(ANALYTIC.render(solved.svbrdf, left.views), left.photos, left.transfer)[0]
    return figures(look, left, ANALYTIC), by_hand


def test_figures_tell_the_truth_from_a_short_fit(row):
    found, by_hand = row
    assert found["maps"]["rmse"] == pytest.approx(by_hand, rel=1e-6)
    # rounding to 8 bits: 0.0011 rms
    assert found["look"]["rmse"] < 0.002 and found["look"]["patches"] < 0.002
    assert found["look"]["patches"] < 0.5 * found["maps"]["patches"] and found["look"]["flip"] < found[
        "maps"]["flip"]
    assert 0 < found["highlights"] < 1 and passes(found)


@pytest.mark.parametrize("folder, count", [("docs/results", 18), ("docs/results/finish-256", 4)])
def test_the_published_page_is_that_of_the_published_record(folder, count):
    record, path = json.loads((ROOT / folder / "finish.json").read_text()), ROOT / folder / "finish.md"
    assert path.read_text() == page(record) and len(record["captures"]) == count


def test_the_bar_asks_for_both():
    maps = {"patches": 0.1, "rmse": 0.1}
    for patches, rmse, met in ((0.08, 0.11, True), (0.081, 0.1, False), (0.05, 0.111, False)):
        assert passes({"maps": maps, "look": {"patches": patches, "rmse": rmse}}) == met


def test_the_page_counts_what_the_record_holds(row, tmp_path):
    other = json.loads(json.dumps(row[0]))
    other["look"] = other["maps"]
    write({"one": row[0], "other": other}, FinishConfig(), (32, 32), tmp_path)
    record = json.loads((tmp_path / "finish.json").read_text())
    text = (tmp_path / "finish.md").read_text()
    assert text == page(record) and "**1 of 2 captures meet the bar**" in text
    assert f"| other | {other['highlights']:.0%} | {other['maps']['patches']:.4f} |" in text and "| 1.00 |" in text


@pytest.mark.parametrize("why", [None, "the photos have one view"])
def test_a_capture_without_a_look_is_left_out_and_ctrl_c_ends_all(why, tmp_path, monkeypatch, capsys):
    shots = photos_of(make_material("tiles", 16))
    solved = fit_svbrdf(shots, ANALYTIC, HierarchicalConfig(iterations=1))
    for name, value in {"read_capture": shots, "fit_svbrdf": solved, "finished": solved, "why_not": why,
                        "make_renderer": ANALYTIC}.items():
        monkeypatch.setattr(bench, name, lambda *args, value=value, **settings: value)
    (tmp_path / "captures/one").mkdir(parents=True)
    if why is None:
        with pytest.raises(KeyboardInterrupt):
            bench.main(tmp_path / "captures", tmp_path / "out", 16, 16)
    else:
        assert bench.main(tmp_path / "captures", tmp_path / "out", 16, 16) == 0
        assert "one: left out, the photos have one view" in "".join(capsys.readouterr())
    assert not (tmp_path / "out").exists()
