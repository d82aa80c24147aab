"""The live page of a fit: static, self-contained, gone with the end, and without effect on the fit."""

import base64
import json
import re
import shutil
from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, photos_of

from mitsvbrdf import cli
from mitsvbrdf.capture import write_capture
from mitsvbrdf.errors import OutputError
from mitsvbrdf.fit import fit_svbrdf
from mitsvbrdf.fit import live as fit_live
from mitsvbrdf.fit.config import DirectConfig, HierarchicalConfig
from mitsvbrdf.material.made import make_material
from mitsvbrdf.report import live
from mitsvbrdf.report.live import LivePage

FAST = DirectConfig(iterations=20)
HOSTILE = "<script>alert(1)<%script>"


@pytest.fixture(scope="module")
def shots():
    return photos_of(make_material("inlay", 16))


@pytest.fixture
def every_step(monkeypatch):
    monkeypatch.setattr(fit_live, "SECONDS", 0.0)
    monkeypatch.setattr(fit_live, "SHARE", 1.0)


@pytest.mark.parametrize("config", [
    FAST, pytest.param(HierarchicalConfig(iterations=3), marks=pytest.mark.slow)])
def test_the_fit_is_the_same_with_and_without_it(config, shots, every_step, tmp_path):
    states = []
    page = LivePage(tmp_path, tmp_path / "out")

    def show(state):
        states.append(state)
        page(state)

    seen, alone = (fit_svbrdf(shots, ANALYTIC, config, live=each) for each in (show, None))
    assert all(torch.equal(seen.svbrdf[name], alone.svbrdf[name]) for name in alone.svbrdf.maps)
    assert torch.equal(seen.rerendered, alone.rerendered) and seen.rerender_rmse == alone.rerender_rmse
    assert len(states) > 2 and states[-1].stopped == seen.stopped and states[0].stopped is None
    assert states[-1].trace == seen.trace and states[-1].share == 1


def test_states_are_rare(shots, tmp_path):
    states = []
    fit_svbrdf(shots, ANALYTIC, FAST, live=states.append)
    # the first, the last, and one a second at most between them
    assert 2 <= len(states) <= 3 + states[-1].seconds / fit_live.SECONDS


def test_a_full_disk_does_not_end_the_fit(shots, every_step):
    def full(state):
        raise OutputError("to write", "no space", "free some")

    assert fit_svbrdf(shots, ANALYTIC, FAST, live=full).stopped == "iterations"


def test_the_page_asks_nobody_and_holds_names_as_text(shots, every_step, tmp_path):
    out, pages = tmp_path / f"out{HOSTILE}", []
    page = LivePage(tmp_path / "made", out)
    first = page.path.read_text()
    assert "being set up" in first

    def show(state):
        page(state)
        pages.append(page.path.read_text())

    fit_svbrdf(replace(shots, source=tmp_path / HOSTILE, notes=(HOSTILE,)), ANALYTIC, FAST, live=show)
    for text in (first, *pages):
        assert HOSTILE not in text and re.search(r"Last written at \d\d:\d\d:\d\d", text)
        addresses = re.findall(r"""(?:src|href)=["']?([^"'\s>]+)""", text)
        report = "../out%3Cscript%3Ealert%281%29%3C%25script%3E/report.html"
        assert all(each.startswith("data:") or each == report for each in addresses)
    assert all(text.count("data:image/png") >= 4 for text in pages) and "all iterations done" in pages[-1]
    assert "<dd>20</dd>" in pages[-1]


def test_the_command_names_it_and_leaves_none_in_the_result(shots, tmp_path, capsys, monkeypatch, every_step):
    write_capture(shots, tmp_path / "photos")
    written, write = [], LivePage.__call__

    def noted(page, state):
        write(page, state)
        written.append(page.path)
        assert page.path.is_file() and page.path.with_name(live.MARK).is_file()

    monkeypatch.setattr(LivePage, "__call__", noted)
    out = tmp_path / "out"
    assert cli.main(["fit", str(tmp_path / "photos"), "-o", str(out), "--method", "direct", "--iterations",
                     "3", "--resolution", "16", "--renderer", "analytic"]) == 0
    assert f"live page: {written[0]}" in capsys.readouterr().out.splitlines()[0] and len(written) > 2
    assert not written[0].exists() and not list(out.rglob("live.*"))
    assert "live.html" not in json.dumps(json.loads((out / ".mitsvbrdf").read_text()))


@pytest.mark.slow
def test_in_a_browser_it_goes_on_to_the_report(shots, tmp_path, every_step):
    from browser import opened

    made, out = tmp_path / "out.partial", tmp_path / "out"
    page_file = LivePage(made, out)
    fit_svbrdf(shots, ANALYTIC, FAST, live=page_file)
    # It asks for a picture that is gone when the fit has ended, and the browser says so.
    gone = r"said \['error: Failed to load resource: net::ERR_FILE_NOT_FOUND'\] and asked for \[\]"
    with pytest.raises(AssertionError, match=gone), opened(page_file.path, beside=tmp_path) as page:
        assert "its result is being written" in page.inner_text("body").lower()
        written = page.inner_text("p.faint")
        page_file(None)
        page.wait_for_function("document.body.innerText.includes('being set up')")
        assert re.search(r"\d s ago", written)
        shutil.copytree(made, out)
        (out / "report.html").write_text("<title>whole</title>the report")
        (out / "sheet.png").write_bytes(base64.b64decode(
            "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAQAAAC1HAwCAAAAC0lEQVR42mNk+A8AAQUBAScY42YAAAAASUVORK5CYII="))
        shutil.rmtree(made)
        page.wait_for_url("**/out/report.html", timeout=15000)
