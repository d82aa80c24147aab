"""The page of the paper's tables: every section, with or without its records, and the one in the docs."""

import xml.etree.ElementTree as ElementTree

import pytest
from helpers import ROOT
from helpers.bench_records import benchmark
from helpers.gan_records import WHOLE

from mitsvbrdf.bench.paper.page import NOT_RUN, write_gan_page
from mitsvbrdf.bench.store import read_benchmark

RESULTS = ROOT / "docs/results"


def test_the_page_has_every_section_and_its_curve(tmp_path):
    page, curve = write_gan_page(tmp_path / "gan.md", WHOLE)
    text = page.read_text()
    for words in ("code 0123456789ab", "### As printed, set 5", "not published",
                  "### Mean of 2 known materials",
                  "](gan-inlay.jpg)", "## From the start to the end", "Lower with the adversarial loss on 1 "
                                                                      "of 2", "| bce |",
                  "## Real captures", "](gan-schedule.svg)", "### Seconds of an iteration",
                  "mitsvbrdf bench --suite gan --materials a,b"):
        assert words in text, words
    assert NOT_RUN not in text
    ElementTree.parse(curve)  # well-formed
    again = write_gan_page(tmp_path / "again/gan.md", WHOLE)
    assert [p.read_bytes() for p in again] == [page.read_bytes(), curve.read_bytes()]


def test_what_has_no_records_is_named_and_has_no_section(tmp_path):
    (page,) = write_gan_page(tmp_path / "gan.md", benchmark([]))
    text = page.read_text()
    assert text.count("\n## ") == 1 and "real captures; the paper's full schedule; seconds" in text[
        text.index(NOT_RUN):]


def test_rows_that_the_program_no_longer_knows_are_said_to_be_of_an_earlier_version(tmp_path):
    (now, _), (then, _) = (write_gan_page(tmp_path / f"{name}.md", {**WHOLE, "records": [
        {**r, "method": name} if r.get("method") == "bce" else r for r in WHOLE["records"]]})
                           for name in ("bce", "of old"))
    assert "earlier version" not in now.read_text() and "Rows of an earlier version: *of old*." in then.read_text()


@pytest.mark.parametrize("name", ["gan", "gan-256", "gan-adversarial", "gan-captures", "gan-features",
                                  "gan-ingredients",
                                  "gan-schedule"])
def test_the_page_in_the_docs_is_what_its_records_make(name, tmp_path):
    record = read_benchmark(RESULTS / f"{name}.json")
    for made in write_gan_page(tmp_path / f"{name}.md", record):
        assert made.read_bytes() == (
            RESULTS / made.name).read_bytes(), f"make {made.name} anew: --suite none --gan-page"
    for sheet in (r["file"] for r in record["records"] if r["suite"] == "sheets"):
        assert (RESULTS / sheet).stat().st_size <= 400_000
