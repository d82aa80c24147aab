"""A batch in virtual time against what can be worked out on paper."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import replace
from pathlib import Path

import pytest

from mitsvbrdf.batch.manifest import Manifest
from mitsvbrdf.batch.planning import simulate as module
from mitsvbrdf.batch.planning.costs import law
from mitsvbrdf.batch.planning.simulate import Load, measured_supervisor, simulate
from mitsvbrdf.batch.planning.simulate_page import figure, page
from mitsvbrdf.batch.planning.virtual import HOUR, Cluster, VirtualPool
from mitsvbrdf.batch.run import Batch
from mitsvbrdf.batch.schedule import Scheduler, Work

CALM = Cluster(workers=7, nodes=2).calm()
# All that can happen, often: some hundred deaths in 400 fits.
STORM = Cluster(workers=20, nodes=4, crashes=6.0, deaths=6.0, node_deaths=4.0, head_deaths=30.0, hangs=0.02,
                refused=0.02, timeout=200.0, slow_nodes=0.25, answer_seconds=3.0, supervisor_seconds=0.2)


def captures(*seconds: float) -> dict[str, float]:
    return {f"{number:064x}"[::-1]: value for number, value in enumerate(seconds)}


@pytest.mark.parametrize("count", [1, 7, 8, 100])
def test_equal_fits_without_failures_take_whole_rounds(count):
    found = simulate(CALM, captures(*[10.0] * count))
    assert found["makespan"] == math.ceil(count / 7) * 10 and found["attempts"] == found["done"] == count
    assert found["tail"] == 10 and found["lost"] == 0 and found["spent"] == 10 * count


def test_crashes_throw_away_what_a_process_without_memory_says():
    """Time until an deferred_signals stretch of t in a Poisson process: mean (e^(rt) - 1) / r, variance
    (e^(2rt) - 2rt e^(rt) - 1) / r^2. The tolerance is four standard errors of 4,000 captures: one seed in
    16,000 is beyond.
    """
    rate, seconds, count = 6 / HOUR, 300.0, 4000
    cluster = replace(CALM, workers=100, crashes=rate * HOUR, timeout=math.inf)
    found = simulate(cluster, captures(*[seconds] * count), retries=1000)
    x = rate * seconds
    mean, variance = (math.exp(x) - 1) / rate - seconds, (math.exp(2 * x) - 2 * x * math.exp(x) - 1) / rate**2
    assert found["lost"] / count == pytest.approx(mean, abs=4 * math.sqrt(variance / count))
    crashes = count * (math.exp(x) - 1)  # a geometric number for each capture
    assert found["ends"]["crashed"] == pytest.approx(crashes,
                                                     abs=4 * math.sqrt(count * math.exp(x) * (
                                                         math.exp(x) - 1)))
    assert found["done"] == count and found["spent"] == pytest.approx(found["lost"] + seconds * count)


@pytest.mark.parametrize("seed", range(12))
def test_largest_first_keeps_grahams_bound(seed):
    """Against the best of all ways to deal eight captures to three workers, and against the order of
    arrival.
    """
    seconds, cluster = [random.Random(seed).uniform(1, 10) for _ in range(8)], replace(CALM, workers=3)
    best = min(max(sum(s for s, w in zip(seconds, dealt) if w == worker) for worker in range(3))
               for dealt in itertools.product(range(3), repeat=8))
    largest, arrival = (simulate(cluster, captures(*seconds), order)["makespan"] for order in ("largest",
                                                                                               "arrival"))
    assert best <= largest * (1 + 1e-9) and largest <= (4 / 3 - 1 / 9) * min(best, arrival) * (1 + 1e-9)


def test_largest_first_has_the_shortest_end():
    """One of a hundred captures takes ten times as long: last come, it is waited for; first come, nobody
    waits.
    """
    found = {order: simulate(CALM, captures(*[1.0] * 99, 10.0), order) for order in module.ORDERS}
    assert found["largest"]["makespan"] == 16 and found["largest"]["tail"] == 1
    assert found["arrival"]["makespan"] == found["smallest"]["makespan"] == 24 and found["smallest"][
        "tail"] == 10


def test_nothing_is_lost_and_nothing_appears_twice():
    happened = set()
    for seed in range(6):
        found = simulate(STORM, Load(400, seconds=30).guesses(seed), seed=seed)
        assert found["done"] + found["failed"] == 400 and found["left"] == found["twice"] == 0
        assert found["published"] == found["done"] and found["attempts"] > 450
        happened |= set(found["ends"])
    assert {"crashed", "lost", "timeout", "failed", "head deaths", "node deaths"} <= happened


def test_a_result_whose_answer_was_lost_is_found():
    """The head dies between the result and the answer: the fit is not done again."""
    cluster = replace(CALM, answer_seconds=50.0, head_deaths=20.0, head_seconds=10.0)
    found = simulate(cluster, captures(*[100.0] * 300))
    assert found["done"] == found["published"] == 300 and found["ends"]["head deaths"] > 5
    # Without adoption each death would cost a new fit of all seven: it does of those that were still fitting.
    assert found["attempts"] == 300 + found["ends"].get("lost", 0)


def test_the_same_seed_gives_the_same():
    guesses = Load(200).guesses(3)
    assert simulate(STORM, guesses, seed=3) == simulate(STORM, guesses, seed=3) != simulate(STORM, guesses,
                                                                                            seed=4)


def test_fits_that_hang_fail_after_their_retries():
    found = simulate(replace(CALM, hangs=1.0, timeout=60.0), captures(*[1.0] * 14), retries=2)
    assert found["failed"] == 14 and found["makespan"] == 2 * 3 * 60 and found["lost_share"] == 1


def test_what_is_refused_is_not_tried_again():
    found = simulate(replace(CALM, refused=1.0, capture_bytes=1e9), captures(*[1.0] * 5))
    assert (found["failed"], found["attempts"]) == (5, 5)


def test_a_slow_file_system_is_the_limit():
    """Ten fits of 5 MB at 1 MB/s: 50 s of transfer behind each other, and one fit."""
    found = simulate(replace(CALM, capture_bytes=2e6, result_bytes=3e6, bandwidth=1e6), captures(*[0.5] * 10))
    assert 50 <= found["makespan"] <= 50.5


def test_a_busy_supervisor_is_the_limit():
    """With 100 workers, 1 s a fit and 0.1 s of the supervisor, a fit ends each 0.1 s; 1.1 s until the last
    round is over.
    """
    found = simulate(replace(CALM, workers=100, supervisor_seconds=0.1), captures(*[1.0] * 1000))
    assert found["makespan"] == pytest.approx(1000 * 0.1 + 1) and found["supervisor_share"] > 0.98


def test_slow_nodes_do_less():
    """Half the workers take twice as long: three quarters of the speed, but for the last fit."""
    found = simulate(replace(CALM, workers=4, slow_nodes=0.5), captures(*[1.0] * 600))
    assert 200 <= found["makespan"] <= 202


def test_what_the_loop_counts_is_what_the_manifest_has(tmp_path):
    guesses = Load(100, seconds=30).guesses()
    pool = VirtualPool(STORM, guesses)
    manifest, told = module._manifest(Path(":memory:"), guesses), []

    def tell(stands, line):
        assert stands.counts == manifest.counts() and len(stands.running) == stands.counts["running"]
        told.append(line)

    batch = Batch(tmp_path, str(tmp_path), pool, manifest, Scheduler(Work(i, s) for i, s in guesses.items()),
                  tell, clock=lambda: pool.now)
    batch.run(pool)
    assert isinstance(manifest, Manifest) and sum(": done" in line
                                                  for line in told) == manifest.counts()["done"] > 80


def test_captures_whose_identities_begin_alike_are_two():
    """Eight letters of 100,000 identities: 1.2 pairs are expected."""
    alike = {"0123abcd" + f"{number:056x}"[::-1]: 1.0 for number in range(20)}
    assert simulate(CALM, alike)["done"] == 20


def test_page_and_chart_show_the_figures(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MEASURED", 50)
    cluster = replace(STORM, workers=8)
    runs = [{"case": words} | simulate(other, Load(40).guesses(), order)
            for words, other, order in module.cases(cluster)]
    supervisor = measured_supervisor(8, 100)
    assert 0 < supervisor["fit_cpu_seconds"] < 0.1
    record = {"cluster": vars(cluster), "load": vars(Load(40)), "runs": runs, "supervisor": supervisor,
              "sweep": module.swept(cluster, Load(), (2, 4), 0)}
    text = page(record)
    assert f"{runs[0]['makespan'] / 60:.1f}" in text and "| 4 |" in text
    figure(record).savefig(tmp_path / "chart.svg")


def test_law_of_costs_is_found_again():
    rows = [{"photos": 9, "resolution": side, "cpu_seconds": 2 + 5e-5 * 9 * side**2} for side in (64, 128,
                                                                                                  256, 512)]
    found = law(rows)
    assert (found["base"], found["slope"], found["worst"]) == pytest.approx((2, 5e-5, 0), abs=1e-9)
