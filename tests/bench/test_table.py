"""The table and the curve, against numpy."""

import numpy as np
import pytest

from mitsvbrdf.bench.plot import plot, svg
from mitsvbrdf.bench.table import judged, markdown, summary, table

GENERATOR = np.random.default_rng(0)
ERRORS = GENERATOR.uniform(0.01, 0.2, (2, 2, 3, 4))  # method, budget, seed, task
BUDGETS = 10.0, 30.0


def record(method, budget, seed, task, error, **more):
    return {"method": method, "kind": "capture", "name": f"t{task}", "held_out": [7, 8], "budget": budget,
            "seed": seed, "seconds": budget + seed, "wall": 2 * budget, "stopped": "budget", "why": None,
            "errors": {"held_out": float(error), "seen": float(error) / 2}, **more}


def records():
    return [record("ab"[m], BUDGETS[b], s, t, ERRORS[m, b, s, t]) for m, b, s, t in np.ndindex(ERRORS.shape)]


def test_medians_and_quartiles_are_numpys():
    found = summary(records(), "held_out")
    for m, b in np.ndindex(2, 2):
        seeds, row = ERRORS[m, b].mean(axis=1), found.loc["ab"[m], BUDGETS[b]]
        assert np.allclose([row["low"], row["median"], row["high"]], np.quantile(seeds, [0.25, 0.5, 0.75]))
        assert row["seeds"] == 3 and row["seconds"] == BUDGETS[b] + 1 and row["wall"] == 2 * BUDGETS[b]
        assert not row["ended"]


def test_a_seed_that_lacks_a_task_does_not_count():
    some = [r for r in records() if (r["method"], r["seed"], r["name"]) != ("a", 2, "t3")]
    some[-1] = some[-1] | {"errors": {}, "stopped": "failed", "why": "cannot"}  # method b, 30 s, seed 2
    found = summary(some, "held_out")
    assert list(found["seeds"]) == [2, 2, 3, 2]
    assert found.loc["a", 10.0]["median"] == pytest.approx(np.median(ERRORS[0, 0, :2].mean(axis=1)))


def test_the_best_is_bold_and_what_is_missing_says_so():
    some = [r for r in records() if (r["method"], r["budget"]) != ("b", 30.0)]
    some += [record("c", 10.0, 0, t, 0, errors={}, stopped="failed", why="cannot") for t in range(4)]
    some += [record("d", 10.0, 0, t, 0.3, stopped="settled", seconds=1234.0) for t in range(4)]
    cells = table(group := next(judged(some)))
    best = "ab"[int(np.median(ERRORS[1, 0].mean(axis=1)) < np.median(ERRORS[0, 0].mean(axis=1)))]
    assert cells["10 s"][f"`{best}`"].startswith("**") and cells["10 s"].str.startswith("**").sum() == 1
    assert cells["30 s"]["`b`"] == "not run" and cells["10 s"]["`c`"] == "fails on t0, t1, t2, t3"
    assert cells["10 s"]["`d`"] == "0.3000 †" and "`d` after 1230 s" in markdown([group])


def test_a_task_without_held_out_photos_is_none_of_their_table():
    more = [record("a", 10.0, 0, 4, 0.1, errors={"seen": 0.1})]  # a capture without views
    held, seen = judged(records() + more)
    assert "mean of 4 real captures" in held.title and "mean of 5" in seen.title
    assert not table(held).isin(["incomplete"]).any(axis=None)


def test_curves_are_the_medians_and_the_picture_is_always_the_same():
    groups = list(judged(records()))
    assert [g.error for g in groups] == ["held_out", "seen"]
    axes = plot(groups).axes[0]
    found = summary(records(), "held_out")
    for line, method in zip(axes.lines, "ab"):
        assert np.allclose(line.get_ydata(), found.loc[method]["median"])
        assert np.allclose(line.get_xdata(), found.loc[method]["seconds"])
    assert svg(plot(groups)) == svg(plot(groups))
