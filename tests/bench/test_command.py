"""The command: records, page and picture; mistakes are one error."""

from unittest import mock

import pytest
from helpers import photos_of

from mitsvbrdf import cli
from mitsvbrdf.bench import run as module
from mitsvbrdf.bench.run import read_records
from mitsvbrdf.capture import write_capture
from mitsvbrdf.material.made import make_material

TINY = ["bench", "--renderer", "analytic", "--materials", "inlay", "--captures", "none", "--resolution", "16",
        "--budgets", "0.1", "--seeds", "0", "--methods", "direct"]


@pytest.fixture
def out(tmp_path, monkeypatch):
    monkeypatch.delenv("MITSVBRDF_DATA", raising=False)
    return tmp_path / "b.jsonl"


@pytest.mark.slow
def test_the_page_and_its_picture_are_of_the_records(out, tmp_path):
    write_capture(photos_of(make_material("inlay", 16)), tmp_path / "data/captures/wood")
    words = [*TINY, "--json", str(out), "--captures", "wood", "--data", str(tmp_path / "data"),
             "--page", str(tmp_path / "p.md")]
    assert cli.main([*words, "--left-out", "7,8"]) == 0  # the option's earlier name
    material, capture = read_records(out)
    assert (material["name"], capture["name"], capture["held_out"]) == ("inlay", "wood", [7, 8])
    page = (tmp_path / "p.md").read_text()
    assert f"{material['errors']['mean']:.4f}" in page and f"{capture['errors']['held_out']:.4f}" in page
    assert (tmp_path / "p.svg").read_bytes().startswith(b"<?xml")
    assert cli.main([*words, "--held-out", "7,8"]) == 2  # the page is there


def test_fits_that_all_fail_make_no_page(out, tmp_path, capsys):
    assert cli.main([*TINY, "--json", str(out), "--budgets", "1e11", "--page", str(tmp_path / "p.md")]) == 1
    assert "p.md" not in capsys.readouterr().out and not list(tmp_path.glob("p.*"))


def test_ctrl_c_ends_with_130_and_keeps_records(out, monkeypatch, capsys):
    assert cli.main([*TINY, "--json", str(out)]) == 0
    before = out.read_bytes()
    monkeypatch.setattr(module, "_fitted", mock.Mock(side_effect=KeyboardInterrupt))
    assert cli.main([*TINY, "--json", str(out), "--seeds", "0,1", "--budgets", "0.1,0.2"]) == 130
    assert "the same command continues" in capsys.readouterr().out and out.read_bytes() == before


@pytest.mark.parametrize("extra, words", [
    (["--methods", "magic"], "hybrid"), (["--methods", ","], "none"), (["--budgets", "10,none"], "--budgets"),
    (["--budgets", "0"], "--budgets"), (["--seeds", "-1"], "--seeds"), (["--seeds", "9999999999"], "--seeds"),
    (["--resolution", "4"], "--resolution"), (["--materials", "builtin:gold"], "made material"),
    (["--materials", "none"], "--materials"), (["--materials", "inlay,builtin:inlay"], "inlay twice"),
    (["--held-out", "x"], "4,7"),
    *(([option, "nowhere"], "nowhere") for option in ("--materials", "--captures", "--data", "--views"))])
def test_mistakes_are_one_error(extra, words, out, capsys):
    assert cli.main([*TINY, "--json", str(out), *extra]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and words in message
    assert not out.exists()
