"""The table of methods and their variants."""

import json
from dataclasses import fields, replace

import pytest
import torch
from helpers import ANALYTIC, photos_of

from mitsvbrdf.bench.code import own_code
from mitsvbrdf.bench.methods import method_table, settings_of
from mitsvbrdf.bench.stiff.scenes import CASES, StiffTask
from mitsvbrdf.bench.variants import GAN_VARIANTS, NO_GAME, PAPERS_LOSSES, VARIANTS, ablations, variant_table
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import GanConfig, HierarchicalConfig, HybridConfig, fit_svbrdf
from mitsvbrdf.fit.hierarchical import Hierarchical
from mitsvbrdf.fit.hierarchical.stages import ROUNDS, Stage
from mitsvbrdf.fit.methods import METHODS
from mitsvbrdf.material.made import make_material


def test_the_table_has_every_method_and_preset():
    table = method_table()
    assert set(table) == {*METHODS, "gan-one-stage", "gan-two-stage", "peers-baseline"}
    assert next(iter(table)) == next(iter(METHODS))  # the default first
    assert table["gan"] == GanConfig() and table["gan-two-stage"] == GanConfig(preset="paper-two-stage")


def test_a_record_says_what_differs_from_the_settings_of_the_method():
    code = {"code": own_code("mitsvbrdf.fit.generator.hybrid")}
    assert settings_of(HybridConfig(seed=3, budget=2.0)) == {"class": "HybridConfig",
                                                             "guess": "robust"} | code
    found = settings_of(HybridConfig(width=8, fix=("normal=flat",), guess="min"))
    assert found == {"class": "HybridConfig", "guess": "min", "fix": ["normal=flat"], "width": 8} | code
    assert found == json.loads(json.dumps(found))


@pytest.mark.parametrize("suite", ["ablation", "gan"])
def test_every_variant_differs_from_the_method_it_is_of(suite):
    method, variants = ablations()[suite]
    default = method_table()[method]
    table = variant_table(default, variants)
    assert list(table) == ["full", *variants]
    for name, changes in variants.items():
        assert table[name] != default and {key: getattr(table[name], key) for key in changes} == changes


def test_variants_that_are_none_are_refused():
    default = HierarchicalConfig()
    with pytest.raises(ConfigError, match="no_such_setting"):
        variant_table(default, {"wrong": {"no_such_setting": 1}})
    with pytest.raises(ConfigError, match="tails >= 0"):
        variant_table(default, {"wrong": {"tails": -1.0}})


def test_the_papers_losses_alone_are_its_preset_at_our_step_sizes():
    ours, paper = GanConfig(), GanConfig(preset="paper-one-stage")
    alone = replace(ours, **GAN_VARIANTS[PAPERS_LOSSES])
    differ = {f.name for f in fields(GanConfig) if getattr(alone, f.name) != getattr(paper, f.name)}
    assert differ == {"preset", "width", "learning_rate", "discriminator_rate", "decay"}
    assert replace(ours, **GAN_VARIANTS[NO_GAME]).weights["adversarial"] == 0


@pytest.mark.parametrize("name", [n for n in GAN_VARIANTS if n != "networks in bfloat16"])
def test_every_variant_of_the_gan_fits(name):
    config = replace(GanConfig(width=4), **GAN_VARIANTS[name])
    found = fit_svbrdf(photos_of(make_material("inlay", 16)), ANALYTIC, replace(config, iterations=2))
    assert found.stopped == "iterations" and not found.undone


@pytest.mark.slow
def test_every_ingredient_changes_real_fits_and_three_of_them_exact_ones(monkeypatch):
    # What VARIANTS of variants.py says. The largest change of a map's value was 0.01 or more, and exactly 0
    # where it must be.
    monkeypatch.setattr("mitsvbrdf.fit.hierarchical.highlights.CHANCE", 0.0)  # they hold hardly any burn-in

    def maps(shots, config):
        return torch.cat(list(fit_svbrdf(shots, ANALYTIC, config).svbrdf.maps.values()), dim=-1)

    # Only after all rounds of the stage before it is asked how far detail is to be believed; other photos
    # have answered this.
    monkeypatch.setitem(ROUNDS, Stage.TOGETHER, 4)
    monkeypatch.setattr(Hierarchical, "_noise_of_detail", lambda self, fine: self.config.noise or 0.08)
    off = StiffTask("case", "", CASES["camera positions 5 % off"], 16).photos
    full = HierarchicalConfig(iterations=12)
    whole = maps(off, full)
    for name, changes in VARIANTS.items():
        assert (maps(off, replace(full, **changes)) - whole).abs().max() > 1e-3, name
    all_fits = {"materials", "integrated", "neighbours"}
    assert [set(changes) <= all_fits for changes in VARIANTS.values()] == [True, True,
                                                                           True] + [False] * (len(VARIANTS) - 3)
    exact = photos_of(make_material("inlay", 16))
    others = {key: value for changes in VARIANTS.values() for key, value in changes.items()
              if key not in all_fits}
    assert torch.equal(maps(exact, replace(full, **others)), maps(exact, full))
