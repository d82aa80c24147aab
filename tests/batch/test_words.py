"""What the page of a library says of times, errors, a batch at work and materials of one name; in node,
without a browser.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from helpers.page_scripts import called

from mitsvbrdf.batch import progress

called = functools.partial(called, ["batch/library/words.js"])
TIMES = {0.84: "0.8 s", 9.94: "9.9 s", 34.2: "34 s", 89: "89 s", 90: "2 min", 725: "12 min",
         5370: "1 h 30 min", 7200: "2 h",
         12000: "3 h 20 min", 86000: "23 h 53 min", 172800: "2 days", 190000: "2 days 5 h"}
RATES = {0.4: "one in 2 h 30 min", 1: "1.0 an hour", 9.94: "9.9 an hour", 12.3: "12 an hour",
         12345.6: "12,346 an hour"}


def given(name: str, *each: object) -> list:
    """What a function gives for one argument after the other."""
    return called([(name, [argument]) for argument in each])


@pytest.mark.parametrize("name, table", [("duration", TIMES), ("rate", RATES)])
def test_times_and_speeds_are_the_same_words_on_the_page_and_on_the_terminal(name, table):
    assert given(name, *table) == [getattr(progress, name)(value) for value in table] == list(table.values())
    more = [float(value) for value in np.geomspace(0.01, 1e6, 300)]
    assert given(name, *more) == [getattr(progress, name)(value) for value in more]


def test_a_time_is_told_on_the_clock_of_whoever_looks():
    date = "2026-11-23T20:05:09Z"
    assert called([("moment", [date]), ("utc", [date])], timezone="Asia/Kolkata") == ["24 Nov 2026, 01:35",
                                                                                     "2026-11-23 20:05:09 UTC"]
    assert called([("moment", [date])], timezone="America/New_York") == ["23 Nov 2026, 15:05"]


@pytest.mark.parametrize("low, high", [(0.003, 0.003), (0.01, 0.01), (0.011, 0.012), (0.0042, 0.31),
                                       (1e-6, 0.9), (0.2, 2.0)])
def test_an_axis_begins_and_ends_at_round_numbers_around_all_errors(low, high):
    (marks,) = called([("ticks", [low, high])])
    assert 2 <= len(marks) <= 8 and marks[0] <= low <= high <= marks[-1] and marks == sorted(set(marks))
    assert all(f"{mark:.0e}"[0] in "125" and float(f"{mark:.0e}") == mark for mark in marks)


def test_few_errors_are_told_one_by_one_and_many_by_shares():
    assert given("spread", [], [0.02], [0.01, 0.02346]) == [
        "None of the materials shown has an error.", "Error of the 1 material shown: 0.02.",
        "Error of the 2 materials shown: 0.01, 0.0235."]
    for count in (10, 11, 37):
        errors = [k / 100 for k in range(1, count + 1)]
        half, most = (next(e for e in errors if sum(x <= e for x in errors) >= part * count) for part in (0.5,
                                                                                                          0.9))
        assert given("spread", errors) == [f"Error of the {count} materials shown: half have {half:g} or "
                                           "less, "
                                           f"9 of 10 have {most:g} or less."]


MADE = "2026-11-23T10:00:00Z"
AT = 1795428000000  # ms, the same moment


@pytest.mark.parametrize("states, library, minutes, expected", [
    ([3, 0, 0, 0], {}, 0, None),
    ([0, 0, 0, 7], {"progress": {"per_hour": 0, "left_seconds": None}}, 0,
     ["0 of 7 ended, 0 % · workers are starting", None]),
    ([0, 0, 1, 6], {"progress": {"per_hour": 0, "left_seconds": None}}, 0,
     ["0 of 7 ended, 0 % · the first fit is running", None]),
    ([6, 0, 2, 1], {"progress": {"per_hour": 0, "left_seconds": None}}, 0,
     ["6 of 9 ended, 66 % · the first fits are running", None]),
    ([1, 0, 4, 2], {"progress": {"per_hour": 120, "left_seconds": None}}, 0, ["1 of 7 ended, 14 %", None]),
    ([900, 100, 4, 996], {"progress": {"per_hour": 120.4, "left_seconds": 30000}}, 14,
     ["1,000 of 2,000 ended, 50 % · this run: 120 an hour, about 8 h 20 min left", None]),
    ([3, 0, 0, 4], {"stopped": True, "command": "mitsvbrdf batch 'my shots' -o lib"}, 1000,
     ["3 of 7 ended, 42 % · stopped, 4 left; run the same command to go on:",
      "mitsvbrdf batch 'my shots' -o lib"]),
    ([3, 0, 0, 4], {}, 0,
     ["3 of 7 ended, 42 % · stopped, 4 left; run the same command to go on:", "mitsvbrdf batch … -o lib"]),
    ([3, 0, 1, 3], {"progress": {"per_hour": 60, "left_seconds": 240}, "command": "again"}, 150,
     ["3 of 7 ended, 42 % · no sign of life for 2 h 30 min; if it died, the same command goes on:",
      "again"])])
def test_how_a_batch_stands(states, library, minutes, expected):
    counts = dict(zip(("done", "failed", "running", "pending"), states))
    (found,) = called([("standing", [counts, {"made": MADE, "title": "lib"} | library,
                                     AT + 60_000 * minutes])])
    assert (found and [found["words"], found["command"]]) == expected


def alike(**values: list) -> list[dict]:
    """Rows of one name that differ in these."""
    usual = {"source": "/shots/oak", "options": "", "method": "hierarchical", "resolution": 256, "date": MADE,
             "id": "1a2b3c4d"}
    return [usual | dict(zip(values, each)) for each in zip(*values.values())]


@pytest.mark.parametrize("rows, expected", [
    (alike(source=["/a/monday/oak", "/a/tuesday/oak"]), ["monday", "tuesday"]),
    (alike(source=["/a/oak", "/a/b/oak", "/a/b/c/oak"]), ["", "b", "b/c"]),
    (alike(source=["/a/old oak", "/a/old_oak"]), ["old oak", "old_oak"]),
    (alike(source=["s3://x/oak", "/y/oak"]), ["s3://x", "/y"]),
    (alike(options=["", "--budget 60"]), ["default options", "--budget 60"]),
    (alike(options=["", "--budget 60", ""], source=["/a/oak", "/a/oak", "/b/oak"]),
     ["a · default options", "a · --budget 60", "b · default options"]),
    (alike(method=["gan", "hierarchical"], id=["1", "2"]), ["gan", "hierarchical"]),
    (alike(resolution=[256, 512]), ["256 px", "512 px"]),
    (alike(date=[MADE, "2026-11-24T10:00:00Z", None]), ["23 Nov 2026, 10:00", "24 Nov 2026, 10:00", ""]),
    (alike(id=["1a", "2b"]), ["1a", "2b"])])
def test_materials_of_one_name_are_told_apart(rows, expected):
    assert given("apart", rows) == [expected]
