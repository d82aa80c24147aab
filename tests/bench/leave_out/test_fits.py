"""What leaving parts of a fit out saves and costs: pairs of stated fits, each kept in a file that a run goes
on with.
"""

import json
from dataclasses import asdict, replace

import pytest
import torch
from helpers import ANALYTIC, GRID
from helpers.bench_records import benchmark

from mitsvbrdf.bench import child
from mitsvbrdf.bench.jobs import key_of, run
from mitsvbrdf.bench.leave_out import fits
from mitsvbrdf.bench.leave_out.fits import PairJob, pair_jobs
from mitsvbrdf.bench.leave_out.parts import EXACT, FOLLOWING, OFF, OTHERS, REAL, UNLIMITED, Part, parts
from mitsvbrdf.bench.leave_out.plan import LeaveOutPlan, capture_folders
from mitsvbrdf.bench.leave_out.scenes import Scene, scenes
from mitsvbrdf.bench.methods import Fitted
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.store import Store, read_benchmark
from mitsvbrdf.bench.tasks import known_material
from mitsvbrdf.capture import write_capture
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import HierarchicalConfig
from mitsvbrdf.io.profile import profiled

USUAL = HierarchicalConfig(budget=UNLIMITED)
STARTS = Part("starts", USUAL, replace(USUAL, neighbours=False))


@pytest.fixture(scope="module")
def inlay():
    return Scene(EXACT, known_material("builtin:inlay", 16, GRID, ANALYTIC))


@pytest.fixture
def done(monkeypatch, inlay):
    """The settings of every fit; each takes 6 s and errs little where texels try neighbours, else 2 s, and
    errs much.
    """
    called = []

    def fit(photos, renderer, config):
        called.append((config.neighbours, config.iterations, len(photos)))
        truth = inlay.task.truth
        off = dict(truth.maps) | {"diffuse": (truth["diffuse"]
                                              + (0.05 if config.neighbours else 0.1)).clamp(0, 1)}
        return Fitted(replace(truth, maps=off), 0.01, lambda shots: 0.0, 0.0, 6.0 if config.neighbours
                      else 2.0, 10, "settled")

    monkeypatch.setattr(fits, "fit", fit)
    return called


@pytest.mark.parametrize("put_in", [False, True])
def test_a_pair_takes_turns_and_tells_which_is_which(put_in, done, inlay):
    job = PairJob(replace(STARTS, put_in=put_in), inlay, 2, ANALYTIC)
    record = job.key | {"config": job.settings} | job.run()
    check_benchmark(benchmark([record]), "here")
    assert [neighbours for neighbours, steps, _ in done if steps is None] == [not put_in, put_in] * 2
    assert [steps for _, steps, _ in done][:2] == [1, 1]  # nothing that counts waits for kernels
    assert record["seconds"] == ({"with": [2.0] * 2, "without": [6.0] * 2} if put_in else
                                 {"with": [6.0] * 2, "without": [2.0] * 2})
    more, less = ("with", "without") if put_in else ("without", "with")
    assert record["errors"][more]["mean"] > record["errors"][less]["mean"] > 0
    assert record["method"] == f"hierarchical {'with' if put_in else 'without'} starts" and record[
        "photos"] == 9


def test_photos_are_taken_away_from_one_side_alone(done, inlay):
    PairJob(Part("half", USUAL, USUAL, photos=lambda shots: shots.pick(shots.index[::2])), inlay, 1,
            ANALYTIC).run()
    assert [photos for _, steps, photos in done if steps is None] == [9, 5]


@pytest.mark.parametrize("put_in", [False, True])
def test_a_table_is_changed_for_one_side_alone(put_in, done, inlay, monkeypatch):
    table, seen, real = {"a": 14}, [], fits.fit

    def fit(photos, renderer, config):
        seen.append(table["a"])
        with profiled(f"rounds: {table['a']}"):
            return real(photos, renderer, config)

    monkeypatch.setattr(fits, "fit", fit)
    record = PairJob(Part("rounds", USUAL, USUAL, put_in, table=(table, {"a": 7})), inlay, 2, ANALYTIC).run()
    # with the part, without it
    assert seen[2:] == ([7, 14] if put_in else [14, 7]) * 2 and table == {"a": 14}
    assert list(record["spent"]) == ["rounds: 14"]  # of the program's own way


def test_a_table_is_as_before_even_after_an_error():
    table = {"a": 1, "b": 2}
    with pytest.raises(ZeroDivisionError), fits.changed(table, {"a": 3}):
        table["a"] / (table["a"] - 3)
    assert table == {"a": 1, "b": 2}


def test_an_interrupted_run_goes_on_with_the_pair_that_it_lost(tmp_path, done, inlay, monkeypatch):
    listed = [STARTS, replace(STARTS, what="others"), replace(STARTS, what="thirds")]
    jobs, shared = pair_jobs(listed, [inlay], 1, ANALYTIC), LeaveOutPlan().settings()
    real = fits.fit

    def interrupted(photos, renderer, config):
        if len(done) == 6:  # in the middle of the second pair: its warm-up and one side are over
            raise KeyboardInterrupt
        return real(photos, renderer, config)

    monkeypatch.setattr(fits, "fit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(jobs, Store(tmp_path / "l.json", shared))
    first = read_benchmark(tmp_path / "l.json")["records"]
    assert [r["part"] for r in first] == ["starts"]
    monkeypatch.setattr(fits, "fit", real)
    store = Store(tmp_path / "l.json", shared)
    assert [job.part.what for job in store.pending(jobs)] == ["others", "thirds"]
    assert run(jobs, store) == {}
    assert read_benchmark(tmp_path / "l.json")["records"][:1] == first and len(store.records) == 3


def test_other_code_of_leaving_out_or_other_turns_are_refused(tmp_path):
    shaping = ("bench/leave_out/fits.py",)
    Store(tmp_path / "l.json", LeaveOutPlan().settings(), shaping=shaping).write()
    # renders first, fits later
    Store(tmp_path / "l.json", LeaveOutPlan(fits=True).settings(), shaping=shaping)
    with pytest.raises(ConfigError, match="code"):
        Store(tmp_path / "l.json", LeaveOutPlan().settings())
    for changed, word in (({"fit_repeats": 1}, "repeats"), ({"resolution": 64}, "renders_resolution")):
        with pytest.raises(ConfigError, match=f"{word}.*--anew forgets it"):
            Store(tmp_path / "l.json", LeaveOutPlan(**changed).settings(), shaping=shaping)


def test_what_is_fitted():
    made = scenes(16, ANALYTIC)
    assert {scene.kind for scene in made} == {*FOLLOWING, *OTHERS} - {REAL}
    matte = next(scene.task for scene in made if scene.kind == "exact, matte")
    assert not matte.truth["specular"].any() and torch.isfinite(matte.photos.photos).all()
    listed = parts()
    assert all((part.other != part.config) + bool(part.photos) + bool(part.table) == 1 for part in listed)
    names = [part.name for part in listed]
    assert len(set(names)) == len(names)  # a file has one setting of each
    assert not any(REAL in part.kinds for part in listed if part.put_in)
    assert {kind for part in listed for kind in part.kinds} == {*FOLLOWING, *OTHERS}


def test_captures_are_those_named(tmp_path, monkeypatch):
    monkeypatch.delenv("MITSVBRDF_DATA", raising=False)
    (tmp_path / "captures" / "bamboo").mkdir(parents=True)
    assert capture_folders(None, tmp_path) == [] and capture_folders("bamboo",
                                                                     tmp_path) == [str(tmp_path / "captures/bamboo")]
    for data in (tmp_path, None):
        with pytest.raises(ConfigError, match="none called oak"):
            capture_folders("oak", data)


def test_another_process_makes_the_same_jobs(tmp_path, monkeypatch, done):
    write_capture(scenes(16, ANALYTIC)[0].task.photos, tmp_path / "inlaid")
    plan = LeaveOutPlan(True, fit_resolution=16, fit_repeats=1, parts=["look-alikes", "tied stage"],
                        captures=[str(tmp_path / "inlaid")])
    jobs = plan.jobs()[0]
    kinds = [job.scene.kind for job in jobs]
    # the tied stage is put in for no real photo
    assert kinds.count(EXACT) == 2 and kinds.count(OFF) == kinds.count(REAL) == 1
    told = json.loads(json.dumps(["LeaveOutPlan", asdict(plan)]))
    monkeypatch.setattr(child, "_made", [])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(PairJob, "run", lambda self: {"ran": self.title})
    for job in jobs:
        assert child.measure({"folder": str(tmp_path), "plan": told,
                              "key": key_of(job)}) == {"ran": job.title}
    with pytest.raises(ConfigError, match="rounding"):
        LeaveOutPlan(True, parts=["rounding"]).jobs()
