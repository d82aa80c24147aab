"""The benchmark's page and its plots."""

import re
import xml.etree.ElementTree as ElementTree

import pytest
from helpers.bench_records import GIVEN, METHODS, benchmark, case, record, timing

from mitsvbrdf.bench import plots, summary
from mitsvbrdf.bench.in_short import in_short
from mitsvbrdf.bench.page import codes, write_benchmark_page
from mitsvbrdf.bench.schema import check_benchmark


def test_the_page_has_every_section_and_its_pictures(tmp_path):
    ablation = [record(m, 10.0, 0, "a", suite="ablation", mean=e, novel_light=e) for m, e in (("full", 0.1),
                                                                                              ("no luck", 0.12))]
    failed = record("direct", 10.0, 5, "a") | {"stopped": "failed", "why": "no step stays finite"}
    memory = {"renderer": "analytic64", "why": "needs about 42 GiB of memory"}
    records = [*METHODS, *ablation, failed, case(), case(resolution=128, skipped=[memory]), case(views=4),
               case("pixels")]
    content = check_benchmark(benchmark(records, GIVEN), "here")
    paths = write_benchmark_page(tmp_path / "page.md", content)
    text = paths[0].read_text()
    for words in ("## In short", "## Known materials", "## Real captures", "## Renderers",
                  "## Each ingredient off",
                  "## How to reproduce", "--budgets 10,30 --seeds 0,1,2", "code 0123456789ab",
                  "**Fits that failed**, 1:",
                  "no step stays finite", "needs about 42 GiB", "| no luck | 0.1200, +0.0200 |",
                  "on the publishers' own photos of the same maps", "<summary>Each capture</summary>"):
        assert words in text, words
    names = {p.name for p in paths[1:]}
    assert names == {f"page-{n}.svg" for n in ("methods", "methods-wall", "renderers", "material",
                                               "capture-4-7")}
    for name in names:
        assert f"({name})" in text
        ElementTree.parse(tmp_path / name)  # well-formed
        # hundredths of a pixel are enough
        assert not re.search(r' (d|x|y)="[^"]*\.\d{3}', (tmp_path / name).read_text())
    drawn = (tmp_path / "page-methods.svg").read_text()
    for label in ("hybrid", "MaterialGAN (published)", "MaterialGAN (saw them)"):
        assert f">{label}</text>" in drawn
    write_benchmark_page(tmp_path / "again.md", content)
    assert (tmp_path / "again-methods.svg").read_bytes() == (tmp_path / "page-methods.svg").read_bytes()


def test_code_of_a_method_is_said_as_often_as_it_changed_and_that_of_other_suites_not():
    def of(kind, digits):
        return {"class": kind, "code": digits}

    records = [{"suite": "methods", "budget": 10.0, "config": of("DirectConfig", "one")},
               {"suite": "ablation", "budget": 10.0, "config": of("DirectConfig", "two")},
               {"suite": "methods", "budget": 30.0, "config": of("DirectConfig", "one")},
               {"suite": "leave-out", "config": {"with": of("HybridConfig", "three"),
                                                 "without": of("GanConfig", "four")}},
               {"suite": "capture", "config": of("HierarchicalConfig", "five")},
               {"suite": "schedule", "config": of("GanConfig", "six")}]
    assert codes({"records": records}) == {"direct": "one and two", "hybrid": "three", "gan": "four"}


def test_curves_are_drawn_at_the_medians():
    drawing = plots.methods_figure(benchmark(METHODS, GIVEN))
    (panel,) = (p for p in drawing.axes if p.get_title(loc="left") == "Error of the maps")
    lines = {tuple(line.get_ydata().round(6)) for line in panel.get_lines()}
    assert (round(0.05 * 3**0.5 * 1.1 * 1.25, 6), 0.06875) in lines  # hybrid
    assert panel.get_xscale() == panel.get_yscale() == "log"


def test_the_clock_on_the_wall_starts_with_the_process_where_that_was_measured():
    start = {"suite": "start", "method": "hybrid", "kind": "capture", "name": "a", "config": {}, "rows": [
        {"cache": cache} | {part: timing(value) for part, value in (("wall", wall), ("loop", 8.0),
                                                                    ("iterations", count))}
        for cache, wall, count in (("empty", 20.0, 30), ("full", 14.0, 40))]}
    # 30 iterations take 6 s once compiled: the other 14 of 20 s are the start and compilation.
    assert summary.cold_starts({"records": [start]}) == {"hybrid": 14.0}

    def seconds(records):
        panel = plots.methods_figure(benchmark(records, GIVEN), wall=True).axes[0]
        lines = [list(line.get_xdata()) for line in panel.get_lines() if line.get_marker() == "o"]
        return lines, {text.get_text() for text in panel.texts}

    lines, names = seconds([*METHODS, start])
    assert [24.0, 44.0] in lines and [11.0, 31.0] in lines and {"hybrid", "direct (warm)"} <= names
    lines, names = seconds(METHODS)
    assert all(line == [11.0, 31.0] for line in lines) and {"hybrid", "direct"} <= names


def test_each_capture_has_a_row_with_a_dot_for_each_method():
    (_, protocol) = summary.protocols(benchmark(METHODS, GIVEN))
    left, _ = plots.each_figure(protocol, "capture").axes
    dots = {(round(float(line.get_xdata()[0]), 4), line.get_ydata()[0])
            for line in left.get_lines() if line.get_marker() == "o"}
    # the median of 1, 1.1 and 1.2 times
    assert {(0.055, 0), (0.0825, 1), (0.088, 0), (0.132, 1)} <= dots and len(dots) == 6
    assert [label.get_text() for label in left.get_yticklabels()] == ["a", "b"]
    assert {line.get_xdata()[0] for line in left.get_lines() if line.get_marker() == "D"} == {0.02}
    one = [r for r in METHODS if r["name"] == "a"]
    assert plots.each_figure(summary.protocols(benchmark(one, GIVEN))[1], "capture") is None


def test_labels_are_pushed_apart_as_little_as_needed():
    assert plots.spaced([0.1, 0.5, 0.9], 0.1) == [0.1, 0.5, 0.9]
    assert plots.spaced([0.5, 0.5, 0.9], 0.1) == pytest.approx([0.45, 0.55, 0.9])
    assert plots.spaced([0.4, 0.45, 0.5], 0.1) == pytest.approx([0.35, 0.45, 0.55])
    assert plots.spaced([], 0.1) == []


def test_what_a_reader_wants_stands_first_and_losses_are_told():
    blind = [record("hierarchical", b, 0, n, "capture", seconds=b / 2, left_out=e, seen=0.01)
             | {"left_out": [7, 8]}
             for b, n, e in ((10.0, "a", 0.30), (10.0, "b", 0.10), (30.0, "a", 0.10), (30.0, "b", 0.08))]
    given = {"capture 7,8": {"a": {"MaterialGAN": {"left_out": 0.01, "seen": 0.02},
                                   "Gao 2019 without them": {"left_out": 0.2}},
                             "b": {"MaterialGAN": {"left_out": 0.01},
                                   "Gao 2019 without them": {"left_out": 0.06}}},
             "material": {"m": {"MaterialGAN": {"mean": 0.1, "diffuse": 0.2, "normal": 0.05}}}}
    material = record("hierarchical", 30.0, 0, "m", mean=0.05, diffuse=0.01, normal=0.09)
    _, _, *lines, _ = in_short(benchmark([material, *blind], given))
    assert lines == [
        "- **Photos that no method saw.** Error of photos left out, mean of 2 real captures without photos "
        "7 and 8: "
        "`hierarchical` with a budget of 30 s has 0.0900, Gao 2019 0.1300, as published. It is lower than "
        "Gao 2019 on 1 of 2. "
        "It passes Gao 2019 after 15 s (31 s on the wall).",
        "- **Maps of known materials.** Error of the maps, m: `hierarchical` with a budget of 30 s has "
        "0.0500, "
        "MaterialGAN 0.1000, as published. It is lower than MaterialGAN on 1 of 1. It passes MaterialGAN "
        "after 30 s (31 s on "
        "the wall).",
        "- **Photos seen, of which the others fitted all nine.** Error of photos seen, a without photos 7 "
        "and 8: "
        "`hierarchical` with a budget of 30 s has 0.0100, MaterialGAN 0.0200, as published. It is lower "
        "than MaterialGAN "
        "on 1 of 1. It passes MaterialGAN after 5 s (11 s on the wall).",
        "- **Where it is worse:**",
        "    - Error of photos left out, 2 real captures without photos 7 and 8: than Gao 2019 on b (0.0800 "
        "against 0.0600).",
        "    - RMSE of a single map: than MaterialGAN in normal of m (0.0900 against 0.0500)."]


def test_a_budget_where_the_default_failed_is_told_with_the_best_method_there():
    fits = [record(m, b, 0, "a", mean=e) for m, b, e in (("hierarchical", 30.0, 0.1), ("gan", 10.0, 0.3),
                                                         ("gan", 30.0, 0.2))]
    failed = record("hierarchical", 10.0, 0, "a") | {"stopped": "failed", "why": "no step"}
    line = next(line for line in in_short(benchmark([failed, *fits])) if "lowest" in line)
    assert line.endswith("lowest: `gan` at 10 s (0.3000, `hierarchical` has none); "
                         "`hierarchical` at 30 s (0.1000, `gan` 0.2000).")
    # it has nothing at all
    line = next(line for line in in_short(benchmark([failed, fits[1]])) if "lowest" in line)
    assert line.endswith("lowest: `gan` at 10 s (0.3000, `hierarchical` has none).")
