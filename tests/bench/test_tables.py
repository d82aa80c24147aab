"""What is counted and shown, against hand-computed numbers."""

import re

import pytest
from helpers.bench_records import GIVEN, METHODS, benchmark, record

from mitsvbrdf.bench import summary
from mitsvbrdf.bench.commands import commands
from mitsvbrdf.bench.plots import each_figure
from mitsvbrdf.bench.readme import results
from mitsvbrdf.bench.tables import each_one, equal_time, looks
from mitsvbrdf.bench.times import equal_error

TWO = [record("hybrid", b, s, n, mean=e) for b, s, n, e in (
    (10.0, 0, "a", 0.30), (10.0, 0, "b", 0.10), (10.0, 1, "a", 0.20), (10.0, 1, "b", 0.10),
    (10.0, 2, "a", 0.50),
    (10.0, 2, "b", 0.30), (30.0, 0, "a", 0.08), (30.0, 0, "b", 0.04), (30.0, 1, "a", 0.02))]


def test_curves_are_medians_over_seeds_of_means_over_materials():
    ten, thirty = summary.curves(TWO, "mean")["hybrid"]
    # Seeds: 0.20, 0.15, 0.40; their inclusive quartiles are 0.175 and 0.30.
    assert (ten.median, ten.low, ten.high, ten.seeds) == pytest.approx((0.20, 0.175, 0.30, 3))
    # Seed 1 has no record of b at 30 s and does not count.
    assert (thirty.median, thirty.seeds) == (pytest.approx(0.06), 1)
    assert [p.median for p in summary.curves(TWO, "mean", ["a"])["hybrid"]] == pytest.approx([0.30, 0.05])
    assert summary.curves(TWO, "specular") == {}


def test_seconds_are_the_loops_own():
    fits = [record("peers-baseline", 100.0, s, n, seconds=t, mean=0.1) for s, n, t in (
        (0, "a", 40.0), (0, "b", 44.0), (1, "a", 50.0), (1, "b", 52.0), (2, "a", 10.0), (2, "b", 20.0))]
    assert summary.curves(fits, "mean")["peers-baseline"][0].seconds == 42.0  # of 42, 51 and 15


def test_first_below_and_published_means():
    points = summary.curves(TWO, "mean")["hybrid"]
    assert summary.first_below(points, 0.1).budget == 30.0 and summary.first_below(points, 0.3).budget == 10.0
    assert summary.first_below(points, 0.06) is None
    given = {"material": {"a": {"X": {"mean": 0.1}, "Y": {"mean": 0.3}}, "b": {"X": {"mean": 0.3}}}}
    assert summary.published_mean(given, "material", ["a", "b"], "mean") == {"X": pytest.approx(0.2)}
    assert summary.with_published(given, "material", ["a", "b"], "Y", "mean") == ["a"]
    assert summary.published_mean({}, "material", ["a"], "mean") == {}


def test_differences_are_paired():
    fits = [record(m, 10.0, s, n, suite="ablation", mean=e) for m, s, n, e in (
        ("full", 0, "a", 0.10), ("full", 1, "a", 0.20), ("full", 0, "b", 0.50),
        ("less", 0, "a", 0.11), ("less", 1, "a", 0.25), ("less", 0, "b", 0.49), ("less", 1, "b", 9.0))]
    found = summary.differences(fits, "mean")["less"][10.0]  # +0.01, +0.05, -0.01; the last has no partner
    assert (found["median"], found["low"], found["high"]) == pytest.approx((0.01, 0.0, 0.03))
    assert found["repeats"] == 3


def test_tables_show_the_medians_and_mark_the_lowest():
    table = equal_time(benchmark(METHODS, GIVEN))[0]
    # hybrid at 30 s: 0.05, 0.055, 0.06 times the mean of 1 and 1.5.
    cells = {row[0]: row[1:] for row in table.rows}
    assert table.heads == ["", "10 s", "30 s"] and cells["`hybrid`"][1] == "**0.0688 (0.0656–0.0719)**"
    assert cells["`direct`"][1].startswith("0.1100")
    assert not any("MaterialGAN" in name for name in cells)  # it is known of a alone
    seen = next(t for t in equal_time(summary.protocols(benchmark(METHODS, GIVEN))[1]) if "seen" in t.title)
    assert ["MaterialGAN, published", "0.0100", "0.0100"] in seen.rows


def test_equal_error_names_the_shortest_budget():
    material, capture = (table for view in summary.protocols(benchmark(METHODS, GIVEN))
                         for table in equal_error(view))
    # The baseline ends at 0.2 * 1.1 * 1.25 = 0.275; hybrid has 0.1191 after 10 s, direct 0.1905.
    assert material.heads[1] == "maps, below `peers-baseline` (0.2750)" and material.heads[2].endswith(
        "on a (0.0600)")
    rows = {row[0]: row[1:] for row in material.rows}
    assert rows["`hybrid`"][:2] == ["10 s", "30 s"]  # on a alone: 0.055 after 30 s
    assert rows["`direct`"][:2] == ["10 s",
                                    "not in 30 s (best 0.0880)"] and rows["`peers-baseline`"][
                                        0] == "its own error"
    assert not any("0.0200" in head for head in capture.heads)  # MaterialGAN saw the photos left out
    assert {row[0]: row[-1] for row in capture.rows}["`hybrid`"] == "not in 30 s (best 0.0688)"


def cells_of(records, given=None):
    table = equal_time(benchmark(records, given))[0]
    return {row[0]: dict(zip(table.heads[1:], row[1:])) for row in table.rows} | {"note": table.note}


def test_every_cell_has_a_number_or_a_reason():
    def fits(method, budget, seed, names="ab", **more):
        return [record(method, budget, seed, name, mean=0.1 * (seed + 1), novel_light=0.2) | more
                for name in names]

    failed = {"stopped": "failed", "why": "no step stays finite", "errors": {}}
    cells = cells_of([*fits("hybrid", 10.0, 0), *fits("hybrid", 10.0, 1), *fits("hybrid", 30.0, 0),
                      *fits("gan", 10.0, 0, "a"),
                      *fits("gan", 30.0, 0, "a"), *fits("gan", 30.0, 0, "b", **failed),
                      *fits("direct", 10.0, 0, config={"class": "DirectConfig"}),
                      *fits("peers-baseline", 10.0, 0, config={"class": "PeersConfig"}, stopped="iterations",
                            seconds=4.0)])
    assert cells["`hybrid`"] == {"10 s": "0.1500 (0.1250–0.1750)", "30 s": "**0.1000 (1 of 2 seeds)**"}
    assert cells["`gan`"] == {"10 s": "only 1 of 2", "30 s": "fails on 1 of 2"}
    assert cells["`direct`"] == {"10 s": "**0.1000**", "30 s": "not run"}
    assert cells["note"] == ("Median of 2 seeds, quartiles in brackets. Without randomness: `direct`, "
                             "`peers-baseline`. † "
                             "ended by itself: `peers-baseline` after 4 s. Not run, for the time it takes: "
                             "`direct` at 30 s "
                             "(2 fits, 60 s).")
    # It ended by itself: the longer budget would give the same.
    assert cells["`peers-baseline`"] == dict.fromkeys(("10 s", "30 s"), "**0.1000 †**")


def test_flip_stands_in_a_table_of_its_own_where_it_was_measured():
    assert looks(benchmark([record("hybrid", mean=0.1)]), "material") is None
    table = looks(benchmark([record("hybrid", mean=0.1, flip_photos=0.03), record("direct", mean=0.1)]),
                  "material")
    assert table.rows == [["`hybrid`", "not measured", "**0.0300**"],
                          ["`direct`", "not measured", "not measured"]]


def test_tables_of_one_budget_have_the_longest_that_all_methods_had():
    fits = [record(m, b, 0, n, mean=e * b, flip_photos=0.1 * e) for n, e in (("a", 0.01), ("b", 0.02))
            for m, b in (("gan", 10.0), ("gan", 30.0), ("gan", 100.0), ("direct", 10.0), ("direct", 30.0))]
    assert summary.longest(fits) == 30.0
    table = each_one(benchmark(fits), "material", "mean", "Error")
    assert table.title == "Error, 30 s, each material"
    assert table.rows == [["median", *["**0.4500**"] * 2], ["a", *["**0.3000**"] * 2],
                          ["b", *["**0.6000**"] * 2]]
    assert ", 30 s, " in looks(benchmark(fits), "material").title
    assert "`direct` at 100 s (2 fits, 3 min)" in equal_time(benchmark(fits))[0].note
    assert "RMSE, 30 s" in {text.get_text() for text in each_figure(benchmark(fits),
                                                                    "material").axes[0].texts}
    apart = [r for r in fits if r["budget"] == (100.0 if r["method"] == "gan" else 30.0)]
    # no budget is shared: the longest of all
    assert summary.longest(apart) == 100.0 and summary.longest([]) == 0


def test_a_table_of_one_budget_says_once_whose_seeds_it_lacks():
    fits = [*(record("hybrid", 10.0, seed, n, mean=0.1, flip_photos=0.2) for seed in (0, 1, 2) for n in "ab"),
            *(record("hybrid", 30.0, 0, n, mean=0.1, flip_photos=0.2) for n in "ab"),
            record("gan", 30.0, 0, "a", mean=0.2), record("gan", 30.0, 0, "b", mean=0.2),
            record("gan", 30.0, 1, "b", mean=0.4)]
    each, seen = each_one(benchmark(fits), "material", "mean", "Error"), looks(benchmark(fits), "material")
    assert each.heads[1:] == ["`hybrid` (1 of 3 seeds)", "`gan`"]
    assert [row[1:] for row in each.rows[1:]] == [["**0.1000**", "0.2000 (1 of 2 seeds)"],
                                                  ["**0.1000**", "0.3000"]]
    assert [row[0] for row in seen.rows] == each.heads[1:] and seen.rows[0][2] == "**0.2000**"


def test_the_readme_has_the_longest_budget_that_all_methods_had():
    of = [("hierarchical", 10.0, 0.1), ("hierarchical", 30.0, 0.2), ("gan", 10.0, 0.3)]
    shots = [record(m, b, 0, "a", "capture", left_out=e, seen=e) | {"left_out": [7, 8]} for m, b, e in of]
    maps = [record(m, b, 0, "m", mean=e, **dict.fromkeys(("diffuse", "specular", "roughness", "normal"), e))
            for m, b, e in of]
    text = results(benchmark([*maps, *shots],
                             {"capture 7,8": {"a": {"Gao 2019 without them": {"left_out": 0.4}}}}))
    assert "budget was 10 s" in text and "| `a` | **0.100** | 0.400 |" in text and "RMSE of each map, budget 10 s" in text


def test_each_command_has_the_budgets_that_had_its_seeds():
    fits = [*(record("gan", b, 0, "a") for b in (10.0, 30.0, 100.0)), record("gan", 10.0, 1, "a"),
            *(record("direct", b, 0, "a") | {"config": {"class": "DirectConfig"}} for b in (10.0, 30.0,
                                                                                            100.0)),
            record("hybrid", 100.0, 0, "a"),
            *(record("gan", 300.0, 0, "c", "capture") | {"left_out": numbers} for numbers in ([4, 7],
                                                                                              [7, 8]))]
    told = [(re.search("--materials (.*?) .*--methods (.*?) --budgets (.*?) --seeds (.*?) ", line).groups(),
             line[-14:])
            for line in commands(benchmark(fits))]
    assert [groups for groups, _ in told] == [
        ("a", "gan,direct", "10", "0,1"), ("a", "gan,direct", "30,100", "0"), ("a", "hybrid", "100", "0"),
        ("none", "gan", "300", "0"), ("none", "gan", "300", "0")]
    assert [end == "--left-out 7,8" for _, end in told] == [False, False, False, False, True]


def test_two_ways_to_leave_photos_out_are_shown_apart():
    both = [record("hybrid", 10.0, 0, "a", "capture", seen=e, left_out=e) | {"left_out": numbers}
            for numbers, e in (([4, 7], 0.1), ([7, 8], 0.3))]
    given = {"capture 7,8": {"a": {"Gao 2019 without them": {"left_out": 0.2}}}}
    _, usual, other = summary.protocols(benchmark([*both, record(mean=0.5)], given))
    assert [row[1] for row in equal_time(usual)[0].rows] == ["**0.1000**"]
    table = equal_time(other)[0]
    assert table.rows == [["`hybrid`", "**0.3000**"], ["Gao 2019, published", "0.2000"]]
    assert table.title.endswith("a without photos 7 and 8")


def test_the_usual_photos_come_first_whatever_the_order_of_the_records():
    other, usual = ([record("hybrid", 10.0, 0, "a", "capture", seen=0.1, left_out=0.1)
                     | {"left_out": numbers}]
                    for numbers in ([7, 8], [4, 7]))
    material = [record("hybrid", 10.0, 0, "m", mean=0.1)]
    for records in (other + material + usual, usual + other + material):
        assert [part["left_out"] for part in summary.protocols(benchmark(records))[1:]] == [(4, 7), (7, 8)]
        assert summary.usual(benchmark(records))["left_out"] == (4, 7)
        (beside,) = (line for line in commands(benchmark(records)) if "--materials m" in line)
        assert "--left-out" not in beside  # materials stand in the command of the usual photos
    assert summary.usual(benchmark(other))["left_out"] == (7, 8)


def test_errors_of_photos_that_a_method_saw_are_marked_last_and_never_the_best():
    fits = [record("hybrid", 10.0, 0, n, "capture", seen=e, left_out=e) | {"left_out": [7, 8]}
            for n, e in (("a", 0.1), ("b", 0.3))]
    given = {"capture 7,8": {n: {"MaterialGAN": {"seen": 0.2, "left_out": 0.01},
                                 "MaterialGAN without them": {"left_out": 0.15}}
                             for n in ("a", "b")}}
    _, protocol = summary.protocols(benchmark(fits, given))
    assert summary.for_readers(benchmark(fits, given))[0] == protocol
    table = each_one(protocol, "capture", "left_out", "Error")
    assert table.heads == ["", "`hybrid`", "MaterialGAN, published", "*MaterialGAN, which saw them*"]
    assert table.rows == [["median", "0.2000", "**0.1500**", "0.0100"], ["a", "**0.1000**", "0.1500",
                                                                         "0.0100"],
                          ["b", "0.3000", "**0.1500**", "0.0100"]]
