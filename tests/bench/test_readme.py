"""The results in README: short tables between two markers, of the records that are there."""

import re

import pytest
from helpers import ROOT
from helpers.bench_records import record

from mitsvbrdf.bench import store
from mitsvbrdf.bench.readme import BEGIN, END, results, write_readme
from mitsvbrdf.errors import ConfigError

RECORDS = ROOT / "docs/results/benchmark.json"
BLIND = {"capture 7,8": {"a": {"MaterialGAN": {"left_out": 0.01},
                               "MaterialGAN without them": {"left_out": 0.06},
                               "Gao 2019 without them": {"left_out": 0.03}},
                         "b": {"MaterialGAN without them": {"left_out": 0.02}}},
         "material": {"a": {"MaterialGAN": dict.fromkeys(("diffuse", "specular", "roughness", "normal",
                                                          "mean"), 0.25)}}}


def fit(name, kind, budget=10.0, method="hierarchical", **errors):
    numbers = {"left_out": [7, 8]} if kind == "capture" else {}
    return record(method, budget, 0, name, kind, **errors) | numbers


MAPS = {"diffuse": 0.1, "specular": 0.2, "roughness": 0.3, "normal": 0.4, "mean": 0.25}
FITS = [fit("a", "capture", left_out=0.09), fit("a", "capture", 30.0, left_out=0.05),
        fit("b", "capture", left_out=0.03),
        fit("b", "capture", 30.0, left_out=0.03), fit("a", "material", **MAPS)]
RECORD = {"records": FITS, "published": BLIND}


def test_photos_that_nobody_saw_stand_beside_those_who_did_not_see_them_either():
    text = results(RECORD)
    # of the longest budget; the lowest is marked, whosever it is
    assert "| `a` | 0.050 | 0.060 | **0.030** |" in text
    assert "| `b` | 0.030 | **0.020** | not published |" in text
    assert "lower than MaterialGAN on 1 of 2 (median ratio 1.17); Gao 2019 on 0 of 1 (median ratio 1.67)" in text
    assert "budget was 30 s; its loop took 30 s" in text
    assert "0.010" not in text  # MaterialGAN's, which had seen the photos


def test_known_materials_stand_beside_what_was_published():
    text = results(RECORD)
    assert "| mean of 1, default | 0.100 | 0.200 | 0.300 | 0.400 |" in text
    assert "| `a`, MaterialGAN as published | 0.250 | 0.250 | 0.250 | 0.250 |" in text and "--method gan" not in text

    assert "RMSE of each map, budget 10 s" in text and "on the publishers' own photos of the same maps" in text


def test_all_rows_are_of_the_longest_budget_and_say_where_they_lack_it():
    short = [fit("c", "capture", left_out=0.01), fit("b", "material", 20.0, **MAPS),
             fit("a", "material", 20.0, "gan", **MAPS),
             fit("b", "material", 20.0, "gan", **MAPS), fit("a", "material", 99.0, "direct", **MAPS)]
    blind = {"capture 7,8": BLIND["capture 7,8"] | {"c": {"MaterialGAN without them": {"left_out": 0.07}}}}
    text = results({"records": FITS + short, "published": BLIND | blind})
    assert "| `c` | not run | **0.070** | not published |" in text and "MaterialGAN on 1 of 2" in text
    assert "RMSE of each map, budget 20 s" in text and "| mean of 2, `--method gan` | 0.100 | 0.200 | 0.300 | 0.400 |" in text
    assert "| mean of 2, default | only 1 of 2 |" in text and "| `a`, default | not run | not run | not run | not run |" in text


def test_a_fit_that_settled_stands_for_longer_budgets():
    settled = fit("a", "capture", left_out=0.05) | {
        "stopped": "settled", "config": {"class": "HierarchicalConfig"}, "seconds": 0.1}
    assert "| `a` | 0.050 |" in results({"records": [settled, *FITS[2:4]], "published": BLIND})


def test_all_else_in_the_file_stays(tmp_path):
    page = tmp_path / "README.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    write_readme(page, RECORD)
    once = page.read_text(encoding="utf-8")
    assert once.startswith(f"before\n{BEGIN}\n\n### Real photos") and once.endswith(
        f"\n{END}\nafter\n") and "old" not in once
    write_readme(page, RECORD)
    assert page.read_text(encoding="utf-8") == once


@pytest.mark.parametrize("text", [None, "no markers", f"{END} {BEGIN}"])
def test_a_file_without_markers_is_refused(text, tmp_path):
    page = tmp_path / "README.md"
    if text is not None:
        page.write_text(text)
    with pytest.raises(ConfigError, match="README.md"):
        write_readme(page, RECORD)
    assert text is None or page.read_text() == text


def test_every_figure_of_readme_is_made_from_the_committed_records():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = text.partition(BEGIN)[2].partition(END)[0]
    assert shown == f"\n\n{results(store.read_benchmark(RECORDS))}\n", "mitsvbrdf bench --suite none --readme README.md"
    assert not re.findall(r"(?<!\d)0?\.\d{2,}", text.replace(shown, ""))
