"""What a fit says that it leaves out, and what it says that it uses."""

import json

import pytest
from helpers import ANALYTIC

from mitsvbrdf import cli
from mitsvbrdf.errors import MapsError
from mitsvbrdf.fit import DirectConfig, FitTask, GanConfig, HierarchicalConfig, HybridConfig, left_out
from mitsvbrdf.fit.left_out import used
from mitsvbrdf.fit.record import read_whole_fit

NETWORKS = {"generator", "discriminator"}


@pytest.mark.parametrize("config, trained", [
    (HierarchicalConfig(), set()), (DirectConfig(), set()), (HybridConfig(), NETWORKS), (GanConfig(), NETWORKS),
    (GanConfig(preset="paper-one-stage"), NETWORKS), (HybridConfig(adversarial=0.0), {"generator"}),
    (GanConfig(adversarial=0.0, features=1.0), NETWORKS)])
def test_networks_are_used_or_left_out(config, trained, leather):
    task = FitTask(leather, ANALYTIC, config)
    told, without = dict(used(task)), dict(left_out(task))
    assert set(told) == trained and NETWORKS & set(without) == NETWORKS - trained
    assert ("docs/benchmark.md" in without.get("generator", "")) == (not trained)  # the measured reason


def test_how_a_network_is_used(leather):
    told = dict(used(FitTask(leather, ANALYTIC, GanConfig(preset="paper-one-stage"))))
    assert told == {"generator": "sees the first of the pictures its maps are compared with; width 64",
                    "discriminator": "adversarial loss, weight 1; game bce"}
    assert "all photos" in dict(used(FitTask(leather, ANALYTIC, GanConfig(generator="variational"))))["generator"]
    told = dict(used(FitTask(leather, ANALYTIC, GanConfig(features=2.0, width=8))))
    assert told["generator"] == "sees all photos; width 8"
    assert told["discriminator"] == "adversarial loss, weight 1 and feature matching, weight 2; game relativistic"


def test_explain_and_the_record_say_so(tmp_path, capsys):
    photos, out = str(tmp_path / "photos"), tmp_path / "out"
    assert cli.main(["synth", "builtin:leather", "-o", photos, "--resolution", "16", "--renderer", "analytic"]) == 0
    command = ["fit", photos, "-o", str(out), "--resolution", "16", "--renderer", "analytic"]
    capsys.readouterr()
    assert cli.main([*command, "--explain"]) == 0
    said = capsys.readouterr().out
    assert "left out: generator (each texel is solved by itself" in said and "used:" not in said
    command += ["--method", "gan", "--width", "4", "--iterations", "1"]
    assert cli.main([*command, "--explain"]) == 0
    said = capsys.readouterr().out
    assert "used: generator (sees all photos; width 4), discriminator (adversarial loss" in said
    assert cli.main(command) == 0
    record = json.loads((out / "fit.json").read_text())
    assert [item["what"] for item in record["used"]] == ["generator", "discriminator"]
    assert all(f"{item['what']} ({item['how']})" in said for item in record["used"])
    assert "Networks used: generator (sees all photos; width 4), discriminator (" in (out / "report.html").read_text()
    # A record of before there was such a field is read, one whose field is something else is not.
    (out / "fit.json").write_text(json.dumps({name: value for name, value in record.items() if name != "used"}))
    read_whole_fit(out)
    (out / "fit.json").write_text(json.dumps(record | {"used": "a generator"}))
    with pytest.raises(MapsError, match="used"):
        read_whole_fit(out)
