"""What the plan takes for granted of methods: which depend on their seed, and which fits a longer budget
repeats.
"""

from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, photos_of
from helpers.bench_records import record

from mitsvbrdf.bench.behaviour import draws, ended_for_good, record_draws
from mitsvbrdf.bench.methods import fit, method_table, settings_of
from mitsvbrdf.bench.peers_baseline import PeersConfig
from mitsvbrdf.fit import DirectConfig, GanConfig, HierarchicalConfig, HybridConfig
from mitsvbrdf.fit.hierarchical.stages import ROUNDS, Stage, Stages
from mitsvbrdf.material.made import make_material

SMALL = {"hierarchical": HierarchicalConfig(iterations=14), "hybrid": HybridConfig(iterations=2, width=4),
         "gan": GanConfig(iterations=1, width=4), "direct": DirectConfig(iterations=3),
         "peers-baseline": PeersConfig(iterations=3)}


def same(one, other):
    return all(torch.equal(value, other.maps[name]) for name, value in one.maps.items())


@pytest.mark.parametrize("name", SMALL)
def test_a_method_without_randomness_gives_the_same_bits_from_every_seed(name):
    shots, config = photos_of(make_material("inlay", 16)), SMALL[name]
    first, second = (fit(shots, ANALYTIC, replace(config, seed=seed)).svbrdf for seed in (0, 7))
    assert same(first, second) == (not draws(config))
    assert record_draws({"config": settings_of(config)}) == draws(config) == draws(method_table()[name])


def test_the_baseline_ends_alike_whatever_its_budget():
    shots = photos_of(make_material("inlay", 8))
    found = [fit(shots, ANALYTIC, PeersConfig(iterations=5, budget=budget)) for budget in (60.0, 600.0)]
    assert same(found[0].svbrdf, found[1].svbrdf) and {each.stopped for each in found} == {"iterations"}


@pytest.mark.parametrize("config, stopped, seconds, budget, good", [
    (PeersConfig(), "iterations", 84.0, 100.0, True), (PeersConfig(), "budget", 100.0, 100.0, False),
    (HierarchicalConfig(), "settled", 14.9, 100.0, True), (HierarchicalConfig(), "settled", 38.0, 100.0,
                                                           False),
    (HierarchicalConfig(), "budget", 10.0, 100.0, False), (HybridConfig(), "settled", 1.0, 100.0, False),
    (GanConfig(), "iterations", 1.0, 100.0, False)])
def test_only_an_early_end_by_itself_is_for_good(config, stopped, seconds, budget, good):
    found = record("any", budget, seconds=seconds) | {"stopped": stopped, "config": settings_of(config)}
    assert ended_for_good(found) == good


def test_before_its_first_deadline_no_stage_is_cut_short():
    # What the share of the budget in `ended_for_good` rests on: stages end by their rounds alone until then.
    for stage in (Stage.ALONE, Stage.RIVALS, Stage.TOGETHER):
        for progress, cut in ((0.149, False), (0.51, True)):
            stages = Stages(rivals=True)
            stages.enter(stage)
            stages.rounds = ROUNDS[stage] - 1
            assert stages.over(progress) == cut, (stage, progress)
