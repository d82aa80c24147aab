"""Seconds to errors, of one method and of a ladder, against numbers counted by hand."""

import math

import pytest
from helpers.bench_records import benchmark, record

from mitsvbrdf.bench.summary import protocols
from mitsvbrdf.bench.times import STEP, ladder, ladders, passing, wall_time


def blind(name, method, budget, error, **more):
    return (record(method, budget, 0, name, "capture", seen=error / 2, left_out=error) | {"left_out": [7, 8]}
            | more)


RECORDS = [blind(name, "hierarchical", budget, error, seconds=seconds) for name, budget, error, seconds in (
    ("a", 10.0, 0.10, 9.0), ("a", 30.0, 0.05, 25.0), ("b", 10.0, 0.09, 8.0), ("b", 30.0, 0.08, 21.0),
    ("c", 10.0, 0.20, 9.5), ("c", 30.0, 0.15, 22.0))]
GIVEN = {"capture 7,8": {"a": {"Gao 2019 without them": {"left_out": 0.06}, "MaterialGAN": {"seen": 0.01,
                                                                                            "left_out": 0.11}},
                         "b": {"Gao 2019 without them": {"left_out": 0.30}},
                         "c": {"Gao 2019 without them": {"left_out": 0.10}}}}


def test_the_default_passes_what_was_published_at_its_shortest_budget_below():
    table = passing(protocols(benchmark(RECORDS, GIVEN))[1])
    assert table.heads == ["", "`hierarchical` after 30 s", "below Gao 2019, published",
                           "below *MaterialGAN, which saw them*"]
    assert table.rows == [["a", "0.0500", "25 s (0.0600)", "9 s (0.1100)"], ["b", "0.0800", "8 s (0.3000)",
                                                                             "not published"],
                          ["c", "0.1500", "not in 30 s (0.1000)", "not published"],
                          # 8, 25 and never
                          ["median", "of the seconds", "25 s (2 of 3 passed)", "9 s (1 of 1 passed)"]]
    few = passing(protocols(benchmark([r for r in RECORDS if r["name"] != "b"], GIVEN))[1])
    assert few.rows[-1][2] == "not passed by half (1 of 2 passed)"


def test_a_ladder_covers_all_errors_in_equal_steps():
    rungs = ladder([0.30, 0.02, 0.1])
    assert rungs[0] <= 0.30 and rungs[-1] > 0.02 and rungs[-1] < 0.02 * STEP
    assert all(math.log(one / other) == pytest.approx(math.log(2) / 2) for one, other in zip(rungs,
                                                                                             rungs[1:]))
    assert ladder([]) == [] and ladder([0.0]) == [] and ladder([1.7e308]) == []
    assert len(ladder([1.0, 1e-300])) == 12  # a table that can be read


def test_each_method_has_its_seconds_to_each_rung():
    records = [record(m, b, 0, "a", mean=e, seconds=b - 1) for m, b, e in (
        ("hybrid", 10.0, 0.10), ("hybrid", 30.0, 0.03), ("direct", 10.0, 0.2))] + [
        record("gan", 30.0, 0, "a") | {"stopped": "failed", "why": "no step | stays finite"}]
    table = ladders(benchmark(records))[0]
    rows = {row[0]: dict(zip(table.heads[1:], row[1:])) for row in table.rows}
    assert rows["`hybrid`"]["0.18"] == "9 s" and rows["`hybrid`"]["0.045"] == "29 s"
    assert rows["`direct`"]["0.18"] == "not in 10 s" and rows["`gan`"][
        "0.18"] == "fails: no step / stays finite"


def test_seconds_on_the_wall_stand_beside_the_loops():
    (table,) = wall_time(protocols(benchmark(RECORDS, GIVEN))[1])
    # Walls are the budgets and a second; loops 9, 8 and 9.5 s, and 25, 21 and 22 s.
    assert table.rows == [["`hierarchical`", "11 / 8.83", "31 / 22.7"]]


def test_the_last_column_is_of_one_budget_and_says_where_it_lacks():
    table = passing(protocols(benchmark([r for r in RECORDS if (r["name"], r["budget"]) != ("a", 30.0)],
                                        GIVEN))[1])
    assert table.heads[1] == "`hierarchical` after 30 s"
    assert table.rows[0] == ["a", "not run", "not in 10 s (0.0600)",
                             "9 s (0.1100)"] and table.rows[1][1] == "0.0800"
