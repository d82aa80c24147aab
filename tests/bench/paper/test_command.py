"""The suites of the paper's tables, from the command line to the page."""

import json

import pytest
from helpers.commands import fails

from mitsvbrdf import cli
from mitsvbrdf.bench.paper.sheets import SheetJob
from mitsvbrdf.bench.schema import check_benchmark

TINY = ["bench", "--renderer", "analytic", "--materials", "inlay", "--captures", "none", "--resolution", "16",
        "--budgets", "0.1", "--seeds", "0", "--repeats", "1", "--views", "builtin:grid"]


@pytest.mark.slow
def test_all_suites_end_in_one_page(tmp_path, monkeypatch):
    monkeypatch.delenv("MITSVBRDF_DATA", raising=False)
    out, page = tmp_path / "gan.json", tmp_path / "gan.md"
    for suite, *more in (("gan", "--variants", "no adversarial loss,bce"),
                         ("methods", "--methods", "gan,gan-two-stage"),
                         ("schedule", "--schedule-size", "16", "--schedule-width", "4", "--iterations", "4"),
                         ("sheets", "--methods", "direct")):
        assert cli.main([*TINY, "--suite", suite, "--json", str(out), "--gan-page", str(page), *more,
                         "--overwrite"]) == 0
    found = check_benchmark(json.loads(out.read_text()), "here")
    assert [(r["suite"], r.get("method")) for r in found["records"]] == [
        ("references", None), ("gan", "full"), ("gan", "no adversarial loss"), ("gan", "bce"),
        ("methods", "gan"), ("methods", "gan-two-stage"), ("schedule", "gan-two-stage"), ("sheets", None)]
    text = page.read_text()
    for words in ("| `gan` |", "Lower with the adversarial loss on", "](gan-schedule.svg)",
                  "](gan-inlay.jpg)",
                  "--iterations 4"):
        assert words in text, words
    assert (tmp_path / "gan-inlay.jpg").is_file() and (tmp_path / "gan-schedule.svg").is_file()
    before = page.read_bytes()
    assert cli.main(["bench", "--suite", "none", "--json", str(out), "--gan-page", str(page),
                     "--overwrite"]) == 0
    assert page.read_bytes() == before


@pytest.mark.parametrize("suite, extra, words", [
    ("gan", ["--variants", "magic"], "no adversarial loss"), ("schedule", ["--methods", "direct"],
                                                              "gan-two-stage"),
    ("schedule", ["--methods", "gan"], "give --iterations"), ("schedule", ["--schedule-width", "0"], "width"),
    ("schedule", ["--iterations", "0"], "iterations")])
def test_mistakes_are_one_error(suite, extra, words, tmp_path, capsys):
    assert cli.main([*TINY, "--suite", suite, "--json", str(tmp_path / "b.json"), *extra]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and words in message


def test_pictures_are_replaced_only_when_asked(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("MITSVBRDF_DATA", raising=False)
    monkeypatch.setattr(SheetJob, "run", lambda self, report: self.path.write_text("new") and {
        "file": self.path.name, "errors": {name: {"diffuse": 0.1} for name in self.methods}})
    picture, bench = tmp_path / "gan-inlay.jpg", [*TINY, "--suite", "sheets", "--json",
                                                  str(tmp_path / "b.json")]
    picture.write_text("mine")
    fails(capsys, tmp_path, bench, "gan-inlay.jpg, which exists", "--overwrite")
    assert picture.read_text() == "mine"
    assert cli.main([*bench, "--overwrite"]) == 0 and picture.read_text() == "new"
    picture.write_text("old")
    assert cli.main(bench) == 0 and picture.read_text() == "old"  # its record is there
    # that of an earlier record
    assert cli.main([*bench, "--methods", "direct"]) == 0 and picture.read_text() == "new"
