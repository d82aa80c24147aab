"""The paper's tables from made records, against numbers counted by hand."""

import shlex

import pytest
from helpers.bench_records import benchmark
from helpers.gan_records import OF_PHOTOS, SCHEDULE, WHOLE, fitted

from mitsvbrdf import cli
from mitsvbrdf.bench.commands import commands
from mitsvbrdf.bench.paper import tables
from mitsvbrdf.bench.paper.printed import printed
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.summary import usual


def cells(table):
    return {row[0]: list(row[1:]) for row in table.rows}


def test_the_made_records_are_records():
    check_benchmark(WHOLE, "here")
    check_benchmark(benchmark([], printed()), "here")


def test_the_papers_own_rows_are_those_it_prints():
    four, five = tables.printed_tables(WHOLE)
    assert cells(four)["the paper"] == ["0.085", "0.208", "0.451", "0.143", "0.071"]
    assert cells(five)["Gao 2019"] == ["0.029", "0.071", "0.035", "0.039", "–"]


def test_known_materials_have_the_same_columns():
    both, one = tables.measured_tables(WHOLE)
    assert (both.title, one.title) == ("Mean of 2 known materials", "a")
    rows = cells(both)
    # Seeds of gan: (0.04 + 0.06) / 2, (0.05 + 0.07) / 2 and (0.09 + 0.05) / 2; the guess: 0.4 (0.1 + 0.08) /
    # 2.
    assert rows["`gan`"] == ["**0.0240**", "**0.0480**", "**0.0720**", "**0.0960**", "**0.0600**", "0.0360",
                             "30"]
    # min: (0.1 + 0.08) / 2
    assert rows["`gan-two-stage`, the paper's preset"][4:] == ["0.4000", "0.0900", "30"]
    assert rows["the start: the guess, one lobe for all texels, flat"][4] == "0.0900"
    assert "Gao 2019, published maps" not in rows  # of a alone
    assert both.note == "Not run on all of these: `gan`, the paper's losses alone, `hierarchical`."
    rows = cells(one)
    assert list(rows)[:2] == ["Gao 2019, published maps", "MaterialGAN, published maps"]
    assert rows["MaterialGAN, published maps"][4:] == ["0.0400", "–", ""]
    assert rows["`hierarchical`"][4] == "**0.0100**"


def test_the_fit_is_held_against_its_start():
    rows = cells(tables.start_and_end(WHOLE))
    # Seeds 0.04, 0.05 and 0.09: quartiles 0.045 and 0.07.
    assert rows["a"] == ["0.1000", "0.0500 (0.0450–0.0700)", "50 %", "0.0400 → 0.0200", "0.0800 → 0.0400",
                         "0.1200 → 0.0600",
                         "0.1600 → 0.0800"]
    assert rows["mean of 2"][:3] == ["0.0900", "0.0600 (0.0550–0.0650)", "33 %"]


def test_the_adversarial_loss_is_counted_one_by_one():
    maps = tables.game_tables(WHOLE)[0]
    assert cells(maps) == {"a": ["0.0500 (0.0450–0.0700)", "0.1100 (0.1050–0.1150)", "-0.0600"],
                           "b": ["0.0600 (0.0550–0.0650)", "0.0500 (0.0500–0.0500)", "+0.0100"]}
    assert maps.note.startswith("Lower with the adversarial loss on 1 of 2. Median of 3 seeds")


def test_each_ingredient_is_paired_with_the_whole():
    rows = cells(tables.ingredient_tables(WHOLE)[0])
    # bce less full: 0.02, 0.01, -0.03 on a and 0.02, 0.01, 0.03 on b.
    assert rows["bce"] == ["0.0700, +0.0150 (+0.0100 to +0.0200)"]
    assert cells(tables.ingredient_tables(WHOLE)[-1])["full"][4] == "**0.0600**"


def test_ingredients_are_compared_on_what_all_were_fitted_to():
    few = [r for r in WHOLE["records"]
           if (r["suite"], r.get("method")) != ("gan", "bce") or (r["name"], r["seed"]) == ("a", 1)]
    rows = cells(tables.ingredient_tables({**WHOLE, "records": few})[0])
    assert rows == {"full": ["0.0500"], "no adversarial loss": ["0.1200, +0.0700"],
                    "bce": ["0.0600, +0.0100"]}
    # with all of theirs
    assert cells(tables.game_tables({**WHOLE, "records": few})[0])["b"][0] == "0.0600 (0.0550–0.0650)"


def test_captures_stand_beside_what_was_published():
    left_out, seen = tables.capture_tables(usual(WHOLE))
    assert left_out.heads == ["", "the start", "`gan`", "MaterialGAN, published"]
    assert cells(left_out) == {"c": ["0.0900", "0.0600", "0.0210"]} and cells(seen)["c"] == ["0.0900",
                                                                                             "0.0300", "0.0200"]
    more = [*fitted("methods", "gan", (0.04,), "d", kind="capture"), *fitted("methods", "gan", (0.09,), "e",
                                                                             kind="capture")]
    _, seen = tables.capture_tables(usual({**WHOLE, "records": [*WHOLE["records"], *more]}))
    assert seen.note == "Median of these: `gan` 0.0400. One seed."  # of 0.03, 0.04, 0.09


def test_a_schedule_ends_with_its_result_and_its_last_state():
    known, real = tables.schedule_tables(WHOLE)
    rows = cells(known)
    title = "`gan-two-stage`, a, 200 iterations, 64 px, width 16, "
    assert rows[title + "result"] == ["0.1200", "0.2400", "0.3600", "0.4800", "0.3000", "0.1000", "0.1000",
                                      "900"]
    assert rows[title + "last"][4] == "0.3000"
    assert cells(real)[title.replace(" a,", " c,") + "last"] == ["0.1100", "0.1300", "900"]


def test_long_runs_of_several_sizes_have_a_command_each():
    other = OF_PHOTOS | {"config": OF_PHOTOS["config"] | {"resolution": 32}}
    made = [line for line in commands(benchmark([SCHEDULE, OF_PHOTOS, other])) if "schedule" in line]
    assert [line.split("--materials ")[1].split(" --seeds")[0] for line in made] == [
        f"{who} --methods gan-two-stage --iterations 200 --schedule-size {side} --schedule-width 16"
        for who, side in (("a --captures c", 64), ("none --captures c", 32))]


def test_iterations_stand_side_by_side():
    timed, parts = tables.step_tables(WHOLE)
    assert cells(timed)["`paper-two-stage`, 256 px, width 64"] == [
        "2 (1.8–2.4)", "5 (4.5–6)", "2.5 (2.25–3)", "bfloat16, float32"]
    assert cells(parts)["`paper-two-stage`, 256 px, width 64, now"] == ["75 %", "25 %"]


@pytest.mark.parametrize("line", commands(WHOLE))
def test_commands_are_understood(line, monkeypatch):
    asked = []
    monkeypatch.setattr("mitsvbrdf.bench.plan.Plan.jobs", lambda plan: asked.extend(plan.suites) or ([], {},
                                                                                                     {}))
    monkeypatch.setattr("mitsvbrdf.bench.store.Store.write", lambda store: None)
    assert cli.main(shlex.split(line)[1:]) == 0 and asked == [shlex.split(line)[3]]
