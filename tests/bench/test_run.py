"""Records are kept as they come, and a run that stopped continues with the same ones."""

import json
from dataclasses import replace

import pytest
from helpers import ANALYTIC, GRID, photos_of

from mitsvbrdf.bench import run as module
from mitsvbrdf.bench.run import identity, method_table, read_records, run, settings_of
from mitsvbrdf.bench.tasks import known_material, real_capture
from mitsvbrdf.capture import write_capture
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import DirectConfig, HybridConfig
from mitsvbrdf.fit.methods import METHODS
from mitsvbrdf.material.made import make_material

METHODS_ = {"direct": DirectConfig(), "hybrid": HybridConfig()}


@pytest.fixture(scope="module")
def task():
    return known_material("builtin:inlay", 16, GRID, ANALYTIC)


def measured(task, path, methods=METHODS_, budgets=(0.1, 0.2), seeds=(0, 1)):
    return run(methods, [task], budgets, seeds, ANALYTIC, path)


@pytest.mark.slow
def test_a_run_that_was_stopped_anywhere_continues_with_the_same_records(task, tmp_path, monkeypatch):
    path, fitted, count = tmp_path / "b.jsonl", module._fitted, []

    def thrice(*arguments):
        count.append(arguments)
        if len(count) == 4:
            raise KeyboardInterrupt
        return fitted(*arguments)

    monkeypatch.setattr(module, "_fitted", thrice)
    with pytest.raises(KeyboardInterrupt):
        measured(task, path)
    first = path.read_bytes()
    assert len(read_records(path)) == 3  # one fit is lost, no other
    path.write_bytes(first + b'{"method": "direct", "ki')  # killed while it wrote
    assert len(read_records(path)) == 3
    records = measured(task, path)
    assert path.read_bytes().startswith(first) and read_records(path) == records
    # `direct` is the same from every seed; methods take turns
    assert [(r["seed"], r["budget"], r["method"]) for r in records] == [(s, b, m) for s, names in (
        (0, ("direct", "hybrid")), (1, ("hybrid",))) for b in (0.1, 0.2) for m in names]
    before = path.read_bytes()
    assert measured(task, path) == records and path.read_bytes() == before
    assert len({identity(r) for r in records}) == 6
    assert {"diffuse", "specular", "roughness", "normal", "mean", "novel_light", "photos"} <= set(
        records[0]["errors"])


@pytest.mark.parametrize("change", ["config", "version", "machine", "task", "content", "seed"])
def test_what_shapes_a_fit_is_part_of_its_key(change, task, tmp_path, monkeypatch):
    path, done = tmp_path / "b.jsonl", []
    monkeypatch.setattr(module, "_fitted", lambda job, key, *_: done.append(job) or {
        **key, "seconds": 1.0, "wall": 1.0, "iterations": 1, "stopped": "budget", "why": None, "errors": {}})
    monkeypatch.setattr(module, "_warm_up", lambda *_: None)
    measured(task, path, {"hybrid": HybridConfig()}, [1], [0])
    if change == "version":
        monkeypatch.setattr(module, "version", lambda: "another")
    if change == "machine":
        monkeypatch.setattr(module, "machine", lambda: {"cores": 1000})
    method = HybridConfig(smooth=0.123) if change == "config" else HybridConfig()
    other = known_material("builtin:tiles", 16, GRID, ANALYTIC) if change == "task" else task
    if change == "content":  # other maps in a folder of the same name
        other = replace(task, truth=make_material("inlay", 16, seed=1))
    again = measured(other, path, {"hybrid": method}, [1], [3 if change == "seed" else 0])
    assert len(done) == 2 and len(again) == 1 and len(read_records(path)) == 2


def test_a_fit_that_cannot_be_done_is_a_result_that_says_why(task, tmp_path):
    (record,) = measured(task, tmp_path / "b.jsonl", {"direct": DirectConfig(fix=("metallic=0",))}, [0.1],
                         [0])
    assert record["stopped"] == "failed" and record["errors"] == {} and "metallic" in record["why"]


@pytest.mark.slow
def test_real_photos_are_judged_by_those_held_out(tmp_path):
    write_capture(photos_of(make_material("inlay", 16)), tmp_path / "wood")
    task = real_capture(tmp_path / "wood", 16)
    (record,) = run({"direct": DirectConfig()}, [task], [0.3], [0], ANALYTIC, tmp_path / "b.jsonl")
    assert record["held_out"] == [4, 7] and {"seen", "held_out"} <= set(record["errors"])


@pytest.mark.parametrize("content", ["[]\n", '{"schema_version": 2}\n', '{"a": NaN}\n', "\xff\n", "[]",
                                     "mine"])
def test_a_file_of_something_else_is_refused_and_kept(content, task, tmp_path):
    path = tmp_path / "b.jsonl"
    path.write_text(content)
    with pytest.raises(ConfigError, match="line"):
        measured(task, path)
    assert path.read_text() == content
    with pytest.raises(ConfigError, match="JSON"):
        read_records(tmp_path / "none.jsonl")


def test_every_method_and_preset_has_settings():
    assert list(METHODS) == [name for name in method_table() if name in METHODS]
    assert method_table()["gan-two-stage"].preset == "paper-two-stage"
    assert settings_of(HybridConfig(budget=3, seed=2)) == {"class": "HybridConfig"}
    assert json.dumps(settings_of(HybridConfig(smooth=0.25))) == '{"class": "HybridConfig", "smooth": 0.25}'
