"""The pages in the docs, one for each machine, are made from their records, and these are of the code that is
there.
"""

import pytest
from helpers import ROOT
from helpers.bench_records import stale

from mitsvbrdf.bench import page, store
from mitsvbrdf.bench.code import shared_code

DOCS = ROOT / "docs"
PAGES = {DOCS / "benchmark.md": DOCS / "results/benchmark.json",
         DOCS / "results/benchmark-intel.md": DOCS / "results/benchmark-intel.json"}
each_page = pytest.mark.parametrize("shown, records", PAGES.items(), ids=[path.stem for path in PAGES])


def anew(shown, records):
    there, here = (path.relative_to(ROOT) for path in (records, shown))
    return f"make it anew: mitsvbrdf bench --suite none --json {there} --page {here} --overwrite"


@each_page
def test_the_page_in_the_docs_is_what_its_records_make(shown, records, tmp_path, monkeypatch):
    monkeypatch.setattr(page, "svg_file", lambda drawing: b"")  # drawing them takes seconds
    made, *pictures = page.write_benchmark_page(tmp_path / shown.name, store.read_benchmark(records))
    assert made.read_bytes() == shown.read_bytes(), anew(shown, records)
    there = {path.name for path in shown.parent.glob(f"{shown.stem}-*.svg")}
    assert {path.name for path in pictures} == there, anew(shown, records)
    assert records.stat().st_size < 1_000_000


@pytest.mark.slow
@each_page
def test_the_pictures_in_the_docs_are_what_their_records_make(shown, records, tmp_path):
    for made in page.write_benchmark_page(tmp_path / shown.name, store.read_benchmark(records)):
        assert made.read_bytes() == (shown.parent / made.name).read_bytes(), anew(shown, records)


@pytest.mark.slow
@pytest.mark.parametrize("records", PAGES.values(), ids=[path.stem for path in PAGES])
def test_the_records_in_the_docs_are_of_this_code(records):
    record = store.read_benchmark(records)
    assert record["settings"][
        "code"] == shared_code(), "the code that shapes all records has changed: run the benchmark anew"
    changed = stale(record)
    assert not changed, f"the code of {changed} has changed since its records were made: run the benchmark, which goes on"
