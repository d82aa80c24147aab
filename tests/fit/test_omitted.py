"""What a fit says that it leaves out, and what it says that it uses."""

import json
from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, MITSUBA, ROOT

from mitsvbrdf import cli
from mitsvbrdf.capture import guess_diffuse
from mitsvbrdf.errors import MapsError
from mitsvbrdf.fit import FitTask, GanConfig, fit_svbrdf, losses, make_method
from mitsvbrdf.fit.config import DirectConfig, HierarchicalConfig, HybridConfig
from mitsvbrdf.fit.hierarchical import omitted as parts
from mitsvbrdf.fit.hierarchical.stages import ROUNDS, Stage, Stages
from mitsvbrdf.fit.omitted import explained, omitted_by, used
from mitsvbrdf.fit.result import Fit
from mitsvbrdf.material.maps import CHANNELS

NETWORKS = {"generator", "discriminator"}


@pytest.mark.parametrize("config, trained", [
    (HierarchicalConfig(), set()), (DirectConfig(), set()), (HybridConfig(), NETWORKS),
    (GanConfig(), NETWORKS),
    (GanConfig(preset="paper-one-stage"), NETWORKS), (HybridConfig(adversarial=0.0), {"generator"}),
    (GanConfig(adversarial=0.0, features=1.0), NETWORKS)])
def test_networks_are_used_or_omitted(config, trained, leather):
    task = FitTask(leather, ANALYTIC, config)
    told, without = dict(used(task)), dict(omitted_by(task))
    assert set(told) == trained and NETWORKS & set(without) == NETWORKS - trained
    # the measured reason
    assert ("docs/results/benchmark.md" in without.get("generator", "")) == (not trained)


def test_how_a_network_is_used(leather):
    told = dict(used(FitTask(leather, ANALYTIC, GanConfig(preset="paper-one-stage"))))
    assert told == {"generator": "sees the first of the pictures its maps are compared with; width 64",
                    "discriminator": "adversarial loss, weight 1; game bce"}
    told = dict(used(FitTask(leather, ANALYTIC, GanConfig(features=2.0, width=8))))
    assert told["generator"] == "sees all photos; width 8"
    assert told["discriminator"].startswith("adversarial loss, weight 1 and feature matching, weight 2")


def claims(leather):
    """Every name by which a fit says that it omits something."""
    said = {"plausible detail"}  # of the command itself
    fixed = {"roughconductor": {"diffuse": "0.3", "specular": "0.04", "roughness": "0.5", "normal": "flat"},
             "principled": {"base_color": "0.3", "metallic": "0"}}
    configs = [kind(bsdf=bsdf, fix=(f"{name}={value}",)) for kind in (HierarchicalConfig, HybridConfig)
               for bsdf, values in fixed.items() for name, value in values.items()]
    configs += [HierarchicalConfig(fix=("diffuse=0", "normal=flat")),
                HierarchicalConfig(fix=("specular=0", "roughness=1")),
                HierarchicalConfig(grey_specular=True), DirectConfig(),
                HierarchicalConfig(exact=True), HierarchicalConfig(exact=False, noise=0.1),
                HierarchicalConfig(multi_start=False),
                HierarchicalConfig(flash_offset=False, calibrate=False), HybridConfig(photometric=0.0),
                HybridConfig(adversarial=0.0, diffuse=0.0, smooth=0.0, flat=0.0), GanConfig(features=0.0),
                GanConfig(adversarial=0.0, features=1.0)]
    unlit = replace(leather, views=replace(leather.views, falloff="none"))
    for shots, config in [*((leather, config) for config in configs), (unlit, HierarchicalConfig())]:
        for renderer in (ANALYTIC, MITSUBA):
            said |= {each.what for found in explained(FitTask(shots, renderer, config)) for each in found}
    return said


def test_every_claim_has_a_measured_row(leather):
    record, gan, bench = (json.loads((ROOT / "docs" / "results" / f"{name}.json").read_text())
                          for name in ("omitted", "gan", "benchmark"))
    measured = {record["earlier"]["part"]} | {each["method"] for each in record["fits"]}
    measured |= {each["part"].split(",")[0] for each in record["renders"]}
    measured |= {each["method"].removeprefix("no ") for each in gan["records"]}
    assert record["detail"] and record["guess"]["seconds"] and {"ray tracing", "adversarial loss"} <= measured
    assert {"hybrid", "hierarchical"} <= {each["method"] for each in bench["records"]}
    # of these the lines above know other names, or tables without a row for each part
    measured |= {"plausible detail", "guessed diffuse map", "texture look-ups", "discriminator", "generator"}
    said = claims(leather)
    assert said <= measured
    # The claims are all that the sources can make: each of these names, and one for each map and each loss.
    assert said >= {"Fresnel curve", "interreflection and path depth", "shadow rays", "environment",
                    "ray tracing", "texture look-ups", "light falloff", "specular lobe", "diffuse lobe",
                    "colour of the specular map", "metallic map", "normal map", "guessed diffuse map",
                    "flash offset", "generator", "discriminator", parts.TIED, parts.LOBE, parts.MULTI_START,
                    parts.VIEWS, parts.CROSS_VALIDATION}
    assert said >= {f"gradient of {name}" for names in CHANNELS.values()
                    for name in names} | set(losses.NAMES.values())


@pytest.mark.parametrize("structure, without", [
    (0.0005, {parts.TIED, parts.VIEWS, parts.CROSS_VALIDATION}), (0.02, {parts.MULTI_START})])
def test_what_the_free_stage_decides_is_said_with_its_figure(structure, without, leather):
    task = FitTask(leather, MITSUBA, HierarchicalConfig())
    method = make_method(task)
    assert method.omitted == []  # nobody has looked yet
    method.stages.unexplained = torch.tensor([structure, 0.01])
    told = dict(method.omitted)
    assert set(told) == without <= set(dict(explained(task)[1]))
    assert all(f"{structure:g}" in why for what, why in told.items() if what != parts.CROSS_VALIDATION)


def test_explain_and_the_record_say_so(tmp_path, capsys):
    photos, out = str(tmp_path / "photos"), tmp_path / "out"
    assert cli.main(["synth", "builtin:leather", "-o", photos, "--resolution", "16", "--renderer",
                     "analytic"]) == 0
    command = ["fit", photos, "-o", str(out), "--resolution", "16", "--renderer", "analytic"]
    capsys.readouterr()
    assert cli.main([*command, "--explain"]) == 0
    said = capsys.readouterr().out
    assert "omitted: generator (each texel is solved by itself" in said and "used:" not in said
    assert "may be omitted: tied stage (if a free" in said and "may be omitted: multi-start (unless" in said
    assert cli.main([*command, "--explain", "--exact", "--no-multi-start"]) == 0
    said = capsys.readouterr().out
    assert "omitted: tied stage (the photos follow the model: stated by --exact)" in said
    assert said.count("may be") == 1 and "may be omitted: search for a specular lobe (if" in said
    assert "omitted: multi-start (not asked for)" in said
    assert cli.main([*command, "--explain", "--no-exact"]) == 0
    said = capsys.readouterr().out
    assert "omitted: multi-start (the photos do not follow" in said and "may be" not in said
    command += ["--method", "gan", "--width", "4", "--iterations", "1"]
    assert cli.main([*command, "--explain"]) == 0
    said = capsys.readouterr().out
    assert "used: generator (sees all photos; width 4), discriminator (adversarial loss" in said
    assert cli.main(command) == 0
    record = json.loads((out / "fit.json").read_text())
    assert [item["what"] for item in record["used"]] == ["generator", "discriminator"]
    assert all(f"{item['what']} ({item['how']})" in said for item in record["used"])
    assert "Networks used: generator (sees all photos; width 4), discriminator (" in (
        out / "report.html").read_text()
    # A record of before there was such a field is read, one whose field is something else is not.
    (out / "fit.json").write_text(json.dumps({name: value for name, value in record.items()
                                              if name != "used"}))
    Fit.load(out)
    (out / "fit.json").write_text(json.dumps(record | {"used": "a generator"}))
    with pytest.raises(MapsError, match="used"):
        Fit.load(out)


@pytest.mark.parametrize("stage, structure, said", [(Stage.TOGETHER, 0.02, parts.CROSS_VALIDATION),
    (Stage.MULTI_START, 0.001, f"further {parts.MULTI_START}")])
@pytest.mark.parametrize("hurried", [True, False])
def test_what_time_was_too_short_for_is_said(hurried, stage, structure, said, leather):
    stages, again = Stages(multi_start=True), Stages(multi_start=True)
    stages.unexplained = torch.tensor([structure, 0.01])
    stages.enter(stage)
    for _ in range(1 if hurried else ROUNDS[stage]):
        stages.begin_round()
    stages.enter(Stage.FINE)
    again.load_state(stages.state())
    task = FitTask(leather, ANALYTIC, HierarchicalConfig())
    assert [said in dict(parts.omitted_stages(task, each)) for each in (stages, again)] == [hurried] * 2


@pytest.mark.parametrize("config", [
    pytest.param(HierarchicalConfig(iterations=4), marks=pytest.mark.slow), DirectConfig(iterations=4)])
def test_the_guess_is_made_once(config, leather, monkeypatch):
    made = []
    monkeypatch.setattr("mitsvbrdf.fit.task.guess_diffuse",
                        lambda *asked: made.append(guess_diffuse(*asked)) or made[-1])
    result = fit_svbrdf(leather, MITSUBA, config)
    assert len(made) == 1 and torch.equal(result.guess, made[0])
