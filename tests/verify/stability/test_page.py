"""The record of a sweep, its page and the command."""

import json
from typing import get_args

import pytest
from helpers import ANALYTIC, ROOT

from mitsvbrdf import cli
from mitsvbrdf.errors import OutputError
from mitsvbrdf.report.stability_page import BEGIN, END, write_stability_markdown, write_stability_page
from mitsvbrdf.verify.stability import SWEEPS, clamps, stability
from mitsvbrdf.verify.stability.verdict import VERDICTS


def test_record_page_and_markdown(one_case, tmp_path):
    record = stability([ANALYTIC], ["tilt"])
    json.dumps(record, allow_nan=False)
    assert record["violations"] == []
    (row,) = record["rows"]
    assert row["renderers"]["analytic"]["verdict"] == "exact" and max(row["fifty_digits"].values()) < 1e-12
    write_stability_page(tmp_path / "page.html", record)
    shown = (tmp_path / "page.html").read_text()
    assert "85 degrees" in shown and 'class="word good">exact<' in shown  # words stand at the left
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}old{END}\nafter\n")
    for _ in range(2):
        write_stability_markdown(page, record)
    text = page.read_text()
    assert text.startswith(f"before\n{BEGIN}") and text.endswith(f"{END}\nafter\n") and "old" not in text
    assert text.count("| 85 degrees | ") == 1 and all(f"| {clamp.name} |" in text for clamp in clamps.CLAMPS)
    page.write_text("no marks")
    with pytest.raises(OutputError, match="marks"):
        write_stability_markdown(page, record)
    assert page.read_text() == "no marks"


def test_the_page_in_docs_has_every_sweep_and_clamp():
    text = (ROOT / "docs/stability.md").read_text()
    text = text[text.index(BEGIN):text.index(END)]
    for key, (title, cases) in SWEEPS.items():
        assert f"### {title}\n" in text
        if key != "resolution":
            assert all(f"\n| {case.label} | " in text for case in cases())
    assert all(f"| {clamp.name} | {clamp.where} | {clamp.why} |" in text for clamp in clamps.CLAMPS)
    assert "wrong," not in text and "not finite," not in text


def test_command_knows_every_sweep(tmp_path, capsys):
    from mitsvbrdf.cli.stability import VERDICT_COLOURS, Sweep

    assert get_args(Sweep) == tuple(SWEEPS) and set(VERDICT_COLOURS) == set(VERDICTS)
    assert cli.main(["stability", "--only", "flat", "--json", str(tmp_path)]) == 2
    assert "a file to write" in capsys.readouterr().err
