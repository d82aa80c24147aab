"""The site builds without a warning; its pages open in a browser, wide and narrow, and hold help and
docstrings.
"""

import html
import io
import re
import runpy
import subprocess
import sys
from contextlib import redirect_stdout, suppress
from dataclasses import fields
from fnmatch import fnmatch
from pathlib import Path

import browser
import pytest
from helpers import ROOT

from mitsvbrdf import cli


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    for name in ("sphinx", "furo", "myst_nb"):
        pytest.importorskip(name, reason="needs the site's packages: pip install 'mitsvbrdf[docs]'")
    folder = tmp_path_factory.mktemp("site")
    # as `./run docs` does, into another folder
    command = ["-m", "sphinx", "-b", "html", "-c", "docs", "-d", folder / "doctrees", "-E", "-W",
               "--keep-going", "-q", "."]
    done = subprocess.run([sys.executable, *command, folder / "site"], cwd=ROOT, capture_output=True,
                          encoding="utf-8")
    assert done.returncode == 0, done.stderr
    return folder / "site"


# Elements that end right of the window, outside of blocks that scroll by themselves. The theme hides them.
OUTSIDE = """width => [...document.querySelectorAll("body *")].filter(it =>
    !it.closest("pre, .table-wrapper, aside, label") && it.getClientRects().length
    && it.getBoundingClientRect().right > width + 1).map(it => it.outerHTML.slice(0, 80))"""


SOURCES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "docs").glob("*.ipynb")]


def pages(site: Path) -> list[Path]:
    return sorted(path for path in site.rglob("*.html") if path != site / "index.html")


@pytest.mark.slow
def test_every_source_is_a_page_and_the_first_address_leads_to_the_first_page(site):
    missing = [path for path in SOURCES if not (site / path.relative_to(ROOT)).with_suffix(".html").is_file()]
    assert not missing and len(SOURCES) > 20
    with browser.opened(site / "index.html", beside=site) as page:
        page.wait_for_url("**/docs/index.html")
        assert page.title().startswith("mitsvbrdf")


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
def test_pages_open_and_nothing_sticks_out(site, width):
    """No page loads anything from outside of the site, or writes to the console."""
    wide = []
    with browser.opened(site / "docs/index.html", beside=site, width=width, phone=width < 600) as page:
        for path in pages(site):
            page.goto(path.as_uri())
            broken = page.evaluate("[...document.images].filter(it => !it.naturalWidth).map(it => it.src)")
            assert not broken, f"{path.name}: {broken}"
            wide += [f"{path.relative_to(site)}: {found}" for found in page.evaluate(OUTSIDE, width)]
    assert not wide


@pytest.mark.slow
@pytest.mark.parametrize("words", [["relight"], ["doctor"], ["fit", "--method", "gan"]], ids=" ".join)
def test_the_page_of_commands_has_their_help(site, words):
    shown = html.unescape(re.sub("<[^>]*>", "", (site / "docs/commands.html").read_text(encoding="utf-8")))
    with redirect_stdout(io.StringIO()) as printed, suppress(SystemExit):
        cli.main([*words, "--help"])
    told = re.findall(r"--[a-z][a-z-]+|\w{4,}", printed.getvalue())
    assert f"{' '.join(words)}¶" in shown
    assert len(told) > 20 and not set(told) - set(re.findall(r"--[a-z][a-z-]+|\w{4,}", shown))


@pytest.mark.slow
def test_the_page_of_python_has_every_public_name_with_its_first_sentence(site):
    import mitsvbrdf

    page = (site / "docs/python.html").read_text(encoding="utf-8")
    shown = " ".join(html.unescape(re.sub("<[^>]*>", "", page)).split())
    for name in mitsvbrdf.__all__:
        assert f'id="mitsvbrdf.{name}"' in page, name
        prose = " ".join((getattr(mitsvbrdf, name).__doc__ or "").replace("`", "").split())
        first = re.split(r"[.:]", prose)[0]
        assert len(first) > 10 and first in shown, (name, first)
    for config in (mitsvbrdf.HierarchicalConfig, mitsvbrdf.GanConfig):
        missing = [field.name for field in fields(config)
                   if f'id="mitsvbrdf.{config.__name__}.{field.name}"' not in page]
        assert not missing, missing
    assert "tyro" not in shown


def test_every_page_has_a_place_in_the_sidebar(monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setenv("COLUMNS", "96")
    contents = runpy.run_path(str(ROOT / "docs/conf.py"))["CONTENTS"]
    places = [entry.rpartition("<")[2].strip("/>") for captions in contents.values()
              for entries in captions.values() for entry in entries]
    for path in SOURCES:
        name = str(path.relative_to(ROOT).with_suffix(""))
        assert name == "docs/index" or any(fnmatch(name, place) for place in places), name
