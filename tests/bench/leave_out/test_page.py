"""Verdicts on parts of fits by stated records, and the page made of the records beside it."""

import pytest
from helpers import ROOT
from helpers.bench_records import benchmark, stale

from mitsvbrdf.bench.code import shared_code
from mitsvbrdf.bench.leave_out.page import write_leave_out_page
from mitsvbrdf.bench.leave_out.plan import SHAPING
from mitsvbrdf.bench.leave_out.renders import Case
from mitsvbrdf.bench.leave_out.verdict import default_fits, items, verdict
from mitsvbrdf.bench.store import read_benchmark

RECORDS, PAGE = ROOT / "docs/results/leave-out.json", ROOT / "docs/leave-out.md"
ANEW = "make it anew: mitsvbrdf leave-out --page-only --json docs/results/leave-out.json --md docs/leave-out.md --overwrite"


def pair(part="starts", name="inlay", kind="exact", put_in=False, full=(6.0, 6.0), lean=(3.0, 2.0),
         spent=None, workers=None, **errors):
    """A pair of fits; errors of both sides by name."""
    errors = errors or {"mean": (0.1, 0.1), "photos": (0.01, 0.05)}
    return {"suite": "leave-out", "method": f"hierarchical without {part}", "kind": kind, "name": name,
            "config": {},
            "part": part, "says": [part], "of": "hierarchical", "put_in": put_in, "photos": 9,
            "seconds": {"with": list(full), "without": list(lean)}, "spent": spent or {"solver": 1.0},
            "errors": {side: {error: both[number] for error, both in errors.items()}
                       for number, side in enumerate(("with", "without"))}} | ({"workers": workers} if workers
                                                                               else {})


def settled(records):
    made = benchmark(records)
    return made | {"settings": made["settings"] | {"repeats": 2, "renders_resolution": 16,
                                                   "renders_repeats": 1}}


@pytest.mark.parametrize("ratio, worst, word", [(2.0, 1.05, "needed"), (2.0, 1.01, "not needed"),
                                                (1.02, 0.9, "no time saved")])
def test_verdicts(ratio, worst, word):
    errors = {"new light": {"median": 1.0, "worst": worst}, "seen": {"median": 3.0, "worst": 9.0}}
    assert verdict(ratio, errors) == word


def test_a_part_is_judged_by_all_scenes_of_a_kind_and_by_the_worst():
    sound, harmed = pair(mean=(0.1, 0.1)), pair(name="tiles", full=(8.0,), lean=(2.0,), mean=(0.1, 0.13))
    (item,) = items(settled([sound, harmed]))
    # of 2, 3 and 4
    assert item["scenes"] == 2 and item["ratio"] | {"median": 3.0, "repeats": 3} == item["ratio"]
    assert item["errors"]["maps"] == pytest.approx({"median": 1.15,
                                                    "worst": 1.3}) and item["verdict"] == "needed"
    (alone,) = items(settled([sound]))
    assert alone["verdict"] == "not needed"
    apart = items(settled([sound, pair(kind="cameras off", mean=(0.1, 0.13))]))
    assert [item["verdict"] for item in apart] == ["not needed", "needed"]


@pytest.mark.parametrize("errors, word", [
    ({"mean": (0.1, 0.1), "photos": (0.01, 0.5)}, "not needed"),  # photos seen decide nothing
    ({"seen": (0.1, 0.1), "left_out": (0.1, 0.11)}, "needed"),
    ({"mean": (0.0001, 0.0009)}, "not needed"),  # below what shows
    ({"mean": (0.1, 0.1), "novel_light": (0.02, 0.021)}, "needed")])
def test_which_errors_decide(errors, word):
    assert [item["verdict"] for item in items(settled([pair(**errors)]))] == [word]


def test_rows_stand_in_the_order_of_the_parts_whichever_was_done_first():
    names = {kind: [item["part"] for item in items(settled(
        [pair(part, kind=kind, mean=(0.1, 0.1)) for part in ("every other photo", "look-alikes",
                                                             "flash offset")]))]
        for kind in ("exact", "cameras off")}
    assert set(map(tuple, names.values())) == {("flash offset", "look-alikes", "every other photo")}
    kinds = [item["kind"] for item in items(settled([pair("look-alikes", kind=kind)
                                                     for kind in ("cameras off", "exact")]))]
    assert kinds == ["exact", "cameras off"]


def test_maps_of_a_matte_material_decide_nothing():
    errors = {"mean": (0.1, 0.5), "novel_light": (0.02, 0.02)}
    (item,) = items(settled([pair(kind="exact, matte", **errors)]))
    assert set(item["errors"]) == {"new light"} and item["verdict"] == "not needed"


def test_the_default_fit_is_the_side_that_the_program_decides():
    records = [pair(full=(6.0,), lean=(3.0,), spent={"solver": 4.0}),
               pair("tied stage", full=(20.0,), lean=(8.0,), put_in=True,
                    spent={"solver": 6.0, "views": 1.0})]
    (found,) = default_fits(settled(records))
    assert found["seconds"] | {"median": 7.0, "repeats": 2} == found["seconds"]
    assert found["spent"] == {"solver": 5.0, "views": 0.5}


def test_the_page_says_how_it_was_made(tmp_path):
    write_leave_out_page(tmp_path / "p.md", settled([pair(workers=2), pair("tied stage", put_in=True)]))
    page = (tmp_path / "p.md").read_text()
    assert "1 of 2 records were made 2 at a time (`--workers`)" in page and "code 0123456789ab" in page
    assert "| starts | `hierarchical` | exact | 1 | 2.50 (2.25 to 2.75) |" in page and "| exact, by itself |" in page
    assert "## Of a scene" not in page  # nothing of it was measured
    assert "--repeats 1 --fits --fit-resolution 16 --fit-repeats 2 --json" in page


def test_the_page_begins_with_what_the_verdicts_come_to(tmp_path):
    def render(name, worst, full, lean, error=1e-6):
        seconds = {side: {"median": value, "low": value, "high": value, "repeats": 1}
                   for side, value in (("full", full), ("lean", lean))}
        return {"suite": "leave-out-renders", "name": name, "where": "mitsuba", "why": "known", "config": {},
                "worst": worst,
                "mean": worst / 10, "full_error": error, "lean_error": error, "seconds": seconds}

    write_leave_out_page(tmp_path / "p.md", settled([
        render("path depth", 0.0, 2.0, 1.0), render("ray tracing", 1.4e-6, 3.0, 0.4),
        render("light falloff", 0.3, 9.0, 1.0, None),
        pair("tied stage", put_in=True, mean=(0.1, 0.05)),
        pair("tied stage", kind="exact, noisy", put_in=True, full=(4.0, 4.0)),
        pair("rival starts", kind="cameras off", put_in=True, full=(1.0,), lean=(2.0,), mean=(0.1, 0.1)),
        pair("look-alikes", mean=(0.1, 0.13), novel_light=(0.1, 0.15)),
        pair("look-alikes", kind="cameras off", mean=(0.1, 0.1)),
        pair("weights of pixels", full=(3.0, 3.0), mean=(0.1, 0.1)),
        pair("discriminator", mean=(0.1, 0.2)) | {"of": "gan", "method": "gan without discriminator"},
        pair("every other photo", put_in=True, mean=(0.1, 0.2))]))
    lines = (tmp_path / "p.md").read_text().split("## ")[1].splitlines()
    ratio = "Seconds with it over those without"
    assert [line for line in lines if line] == [
        "In short",
        "- **Of a scene.** Leaving out what it does not need changes pictures by at most 1.4e-06 of their "
        f"values. {ratio}: "
        "ray tracing 7.5, path depth 2.",
        "- **Left out of fits by the program itself**, where photos show that they do not need it. "
        f"{ratio}: tied stage 1.7 to 2.5.",
        "- **Left out by the program itself, though it would help.** Error without it over error with it: "
        "every other photo: maps 2.00 (exact).",
        "- **Needed.** Error without it over error with it: look-alikes: new light 1.50 (exact); "
        "discriminator of `gan`: maps 2.00 (exact).",
        f"- **Kept, though none of these photos needs it**, as no test of photos tells so. {ratio}: "
        "weights of pixels 1.2."]


def test_the_page_in_the_docs_is_what_its_records_make(tmp_path):
    write_leave_out_page(tmp_path / "page.md", read_benchmark(RECORDS))
    assert (tmp_path / "page.md").read_bytes() == PAGE.read_bytes(), ANEW


@pytest.mark.slow
def test_the_records_in_the_docs_are_of_this_code():
    record = read_benchmark(RECORDS)
    assert record["settings"]["code"] == shared_code(
        SHAPING), "shared code has changed: run `mitsvbrdf leave-out --fits` anew"
    assert not stale(record), "the code of methods has changed: run `mitsvbrdf leave-out --fits`, which goes on"
    renders = [r for r in record["records"] if r["suite"] == "leave-out-renders"]
    assert [r["config"].get("code") for r in renders] == [Case("", r["where"], "", print,
                                                               print).settings.get("code")
                                                          for r in renders]
