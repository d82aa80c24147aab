"""The page in the docs is made from the records beside it, and these are of the code that is there."""

import pytest
from helpers import ROOT
from helpers.bench_records import stale

from mitsvbrdf.bench import page, store
from mitsvbrdf.bench.code import shared_code

RECORDS, PAGE = ROOT / "docs/results/benchmark.json", ROOT / "docs/benchmark.md"
ANEW = "make it anew: mitsvbrdf bench --suite none --json docs/results/benchmark.json --page docs/benchmark.md --overwrite"


def test_the_page_in_the_docs_is_what_its_records_make(tmp_path, monkeypatch):
    monkeypatch.setattr(page, "svg_file", lambda drawing: b"")  # drawing them takes seconds
    made, *pictures = page.write_benchmark_page(tmp_path / PAGE.name, store.read_benchmark(RECORDS))
    assert made.read_bytes() == PAGE.read_bytes(), ANEW
    there = {path.name for path in PAGE.parent.glob("benchmark-*.svg")}
    assert {path.name for path in pictures} == there, ANEW
    assert RECORDS.stat().st_size < 1_000_000


@pytest.mark.slow
def test_the_pictures_in_the_docs_are_what_their_records_make(tmp_path):
    for made in page.write_benchmark_page(tmp_path / PAGE.name, store.read_benchmark(RECORDS)):
        assert made.read_bytes() == (PAGE.parent / made.name).read_bytes(), ANEW


@pytest.mark.slow
def test_the_records_in_the_docs_are_of_this_code():
    record = store.read_benchmark(RECORDS)
    assert record["settings"]["code"] == shared_code(), "the code that shapes all records has changed: run the benchmark anew"
    changed = stale(record)
    assert not changed, f"the code of {changed} has changed since its records were made: run the benchmark, which goes on"
