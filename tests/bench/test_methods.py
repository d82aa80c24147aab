"""The table of methods and their variants."""

import json
from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, photos_of

from mitsvbrdf.bench.methods import VARIANTS, method_table, settings_of, variant_table
from mitsvbrdf.bench.stiff import cameras_off
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import HierarchicalConfig, HybridConfig, fit_svbrdf
from mitsvbrdf.fit.methods import METHODS
from mitsvbrdf.material.made import make_material


def test_the_table_has_every_method_and_preset():
    table = method_table()
    assert {"hierarchical", "hybrid", "direct", "gan-one-stage", "gan-two-stage", "peers-baseline"} <= set(table)
    assert next(iter(table)) == next(iter(METHODS))  # the default first
    assert table["gan-two-stage"].preset == "paper-two-stage"
    assert "seed" not in settings_of(HybridConfig()) and settings_of(HybridConfig()) == json.loads(
        json.dumps(settings_of(HybridConfig())))


def test_every_variant_is_one_of_the_default_method():
    default = next(iter(method_table().values()))
    table = variant_table(default, VARIANTS)
    assert list(table) == ["full", *VARIANTS]
    for name, changes in VARIANTS.items():
        assert table[name] != default and {key: getattr(table[name], key) for key in changes} == changes
    with pytest.raises(ConfigError, match="no_such_setting"):
        variant_table(default, {"wrong": {"no_such_setting": 1}})
    with pytest.raises(ConfigError, match="tails >= 0"):
        variant_table(default, {"wrong": {"tails": -1.0}})


@pytest.mark.slow
def test_every_ingredient_changes_real_fits_and_two_of_them_exact_ones(monkeypatch):
    # What VARIANTS of methods.py says. The largest change of a map's value was 0.01 or more, and exactly 0 where it must be.
    monkeypatch.setattr("mitsvbrdf.fit.hierarchical.rounds.CHANCE", 0.0)  # they hold hardly any burn-in

    def maps(shots, config):
        return torch.cat(list(fit_svbrdf(shots, ANALYTIC, config).svbrdf.maps.values()), dim=-1)

    full, off = HierarchicalConfig(iterations=12), cameras_off(16).capture
    whole = maps(off, full)
    for name, changes in VARIANTS.items():
        assert (maps(off, replace(full, **changes)) - whole).abs().max() > 1e-3, name
    both = {"materials", "neighbours"}
    assert [set(changes) <= both for changes in VARIANTS.values()] == [True, True] + [False] * (len(VARIANTS) - 2)
    exact = photos_of(make_material("inlay", 16))
    others = {key: value for changes in VARIANTS.values() for key, value in changes.items() if key not in both}
    assert torch.equal(maps(exact, replace(full, **others)), maps(exact, full))
