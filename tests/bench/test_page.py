"""The benchmark's page and its plots."""

import xml.etree.ElementTree as ElementTree

import pytest
from helpers.bench_records import GIVEN, METHODS, benchmark, case, record

from mitsvbrdf.bench import plots
from mitsvbrdf.bench.in_short import in_short
from mitsvbrdf.bench.page import write_benchmark_page
from mitsvbrdf.bench.schema import check_benchmark


def test_the_page_has_every_section_and_its_pictures(tmp_path):
    ablation = [record(m, 10.0, 0, "a", suite="ablation", mean=e, novel_light=e) for m, e in (("full", 0.1), ("no luck", 0.12))]
    failed = record("direct", 10.0, 5, "a") | {"stopped": "failed", "why": "no step stays finite"}
    memory = {"renderer": "analytic64", "why": "needs about 42 GiB of memory"}
    records = [*METHODS, *ablation, failed, case(), case(resolution=128, skipped=[memory]), case(views=4), case("pixels")]
    content = check_benchmark(benchmark(records, GIVEN), "here")
    paths = write_benchmark_page(tmp_path / "page.md", content)
    text = paths[0].read_text()
    for words in ("## In short", "## Known materials", "## Real captures", "## Renderers", "## Each ingredient off",
                  "## How to reproduce", "--budgets 10,30 --seeds 0,1,2", "code 0123456789ab", "1 fits failed",
                  "no step stays finite", "needs about 42 GiB", "| no luck | 0.1200, +0.0200 |", "lower on 1 of 1 (a)",
                  "lower on 0 of 2, not on a, b",
                  "against MaterialGAN, which saw them, as published", "on the publishers' own photos of the same maps",
                  "Error of photos seen, `hybrid` after 30 s against MaterialGAN as published"):
        assert words in text, words
    names = {p.name for p in paths[1:]}
    assert names == {f"page-{n}.svg" for n in ("methods", "renderers", "material-mean", "material-novel-light",
                                               "capture-4-7-seen", "capture-4-7-left-out")}
    for name in names:
        assert f"({name})" in text
        ElementTree.parse(tmp_path / name)  # well-formed
    drawn = (tmp_path / "page-methods.svg").read_text()
    for label in ("hybrid", "MaterialGAN (published)", "MaterialGAN (saw them)"):
        assert f">{label}</text>" in drawn
    write_benchmark_page(tmp_path / "again.md", content)
    assert (tmp_path / "again-methods.svg").read_bytes() == (tmp_path / "page-methods.svg").read_bytes()


def test_curves_are_drawn_at_the_medians():
    drawing = plots.methods_figure(benchmark(METHODS, GIVEN))
    (panel,) = (p for p in drawing.axes if p.get_title(loc="left") == "Error of the maps")
    lines = {tuple(line.get_ydata().round(6)) for line in panel.get_lines()}
    assert (round(0.05 * 3**0.5 * 1.1 * 1.25, 6), 0.06875) in lines  # hybrid
    assert panel.get_xscale() == panel.get_yscale() == "log"


def test_labels_are_pushed_apart_as_little_as_needed():
    assert plots.spaced([0.1, 0.5, 0.9], 0.1) == [0.1, 0.5, 0.9]
    assert plots.spaced([0.5, 0.5, 0.9], 0.1) == pytest.approx([0.45, 0.55, 0.9])
    assert plots.spaced([0.4, 0.45, 0.5], 0.1) == pytest.approx([0.35, 0.45, 0.55])
    assert plots.spaced([], 0.1) == []


def test_a_budget_where_the_default_failed_is_told_with_the_best_method_there():
    fits = [record(m, b, 0, "a", mean=e) for m, b, e in (("hierarchical", 30.0, 0.1), ("gan", 10.0, 0.3), ("gan", 30.0, 0.2))]
    failed = record("hierarchical", 10.0, 0, "a") | {"stopped": "failed", "why": "no step"}
    line = next(line for line in in_short(benchmark([failed, *fits])) if "lowest" in line)
    assert line.endswith("lowest: `gan` at 10 s (0.3000, `hierarchical` has none); `hierarchical` at 30 s.")
    line = next(line for line in in_short(benchmark([failed, fits[1]])) if "lowest" in line)  # it has nothing at all
    assert line.endswith("lowest: `gan` at 10 s (0.3000, `hierarchical` has none).")
