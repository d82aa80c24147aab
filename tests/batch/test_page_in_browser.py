"""The page of a library in a real Chromium."""

import time

import pytest
from browser import opened
from helpers.libraries import random_rows, write_library, write_page

from mitsvbrdf.batch.library import matches

pytestmark = pytest.mark.slow
COUNT = 600
NAMES = "[...document.querySelectorAll('#cards .name')].map(name => name.textContent)"
HOSTILE = ['<img src=x onerror="hit()">', "</script><script>hit()</script>", '"><svg onload=hit()>',
           "javascript:hit()", "'-hit()-'", "{{ 7 * 7 }}", "\u2028\u2029\u202e", "__proto__", "${hit()}"]


def until(page, code: str, seconds: float = 20) -> None:
    """Wait until this is true in the page; its own way to wait needs an eval, which the page forbids."""
    end = time.monotonic() + seconds
    while not page.evaluate(code):
        assert time.monotonic() < end, code
        time.sleep(0.05)


def two_frames(page) -> None:
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    rows = random_rows(COUNT)
    return rows, write_library(tmp_path_factory.mktemp("library"), rows, title="All of it")


@pytest.mark.parametrize("how", [{}, {"width": 390, "height": 844, "phone": True, "scheme": "dark"}],
                         ids=["desktop", "phone"])
def test_few_cards_stand_for_all(library, how):
    rows, file = library
    with opened(file, beside=True, **how) as page:
        until(page, "document.querySelector('#cards img').naturalWidth == 128")
        assert page.title() == "All of it" and page.locator("#shown").text_content() == f"{COUNT} materials"
        height, seen = page.evaluate("document.documentElement.scrollHeight"), set()
        for y in range(0, height, how.get("height", 900)):
            page.evaluate("y => scrollTo(0, y)", y)
            two_frames(page)
            seen.update(page.evaluate(NAMES))
            assert page.locator("#cards li").count() < 90
            assert page.evaluate("[scrollX, document.documentElement.scrollWidth - innerWidth]") == [0, 0]
        assert seen == {row["name"] for row in rows}


@pytest.mark.parametrize("text, state", [("", "failed"), ("OLD wood", ""), ("crashed", "failed"),
                                         ("no such", ""), ("gan", "done"), ("façade", "")])
def test_a_search_shows_the_rows_that_the_command_lists(library, text, state):
    rows, file = library
    with opened(file, beside=True) as page:
        page.locator("#text").fill(text)
        page.select_option("#state", state)
        two_frames(page)
        wanted = [row["name"] for row in rows if matches(row, text) and state in ("", row["state"])]
        assert page.evaluate("shown.map(row => row.name)") == wanted
        assert page.locator("#none").is_visible() == (not wanted)
        page.reload()
        assert page.evaluate("shown.map(row => row.name)") == wanted
        assert page.locator("#text").input_value() == text


@pytest.mark.parametrize("field", ["error", "held_out_error", "date"])
def test_sorting_puts_missing_values_last(library, field):
    rows, file = library
    with opened(file, beside=True) as page:
        for down in (False, True):
            if down:
                page.locator("#down").click()
            page.select_option("#sort", field)
            found = page.evaluate(f"shown.map(row => row.{field})")
            there = [value for value in found if value is not None]
            assert there == sorted(there, reverse=down) and found[:len(there)] == there


def test_a_card_opens_its_report_or_tells_about_it(library):
    _, file = library
    with opened(file, beside=True) as page:
        page.locator("#cards .done .more").first.click()
        assert page.locator("#details dl").is_visible()
        assert "Held-out" in page.locator("#details").text_content()
        page.keyboard.press("Escape")
        page.locator("#cards .done a").first.click()
        assert page.locator("body").text_content().strip() == "a report"


def test_strangers_names_are_text(tmp_path):
    rows = random_rows(len(HOSTILE))
    for row, name in zip(rows, HOSTILE):
        row |= {"name": name, "state": "failed", "reason": name, "tags": [name], "source": name,
                "options": name, "preview": None, "report": None, "log": None}
    write_page(tmp_path, rows, title=HOSTILE[1])
    with opened(tmp_path / "index.html", beside=True) as page:
        assert page.evaluate(NAMES) == HOSTILE and page.title() == HOSTILE[1]
        page.locator("#cards .more").nth(1).click()
        assert HOSTILE[1] in page.locator("#details dl").text_content()
        assert page.evaluate("typeof hit") == "undefined"


def test_a_batch_at_work_is_followed_from_disk(tmp_path):
    rows = [row | {"preview": None} for row in random_rows(60, unfinished=True)]
    write_page(tmp_path, rows, title="At work", progress="48 of 60 ended, 4 running")
    with opened(tmp_path / "index.html", beside=True) as page:
        assert page.title() == "48 of 60 ended · At work"
        assert "4 running" in page.locator("#progress p").text_content()
        page.locator("#text").fill("256")
        for row in rows:
            row["state"] = "done" if row["state"] != "failed" else "failed"
        rows[0]["state"] = "pending"
        write_page(tmp_path, rows, title="At work")
        until(page, "document.title == 'At work'")
        assert page.locator("#text").input_value() == "256"
        assert "the same command goes on" in page.locator("#progress p").text_content()


def test_a_page_without_its_data_says_so(tmp_path):
    write_page(tmp_path, [])
    (tmp_path / "library.js").write_text("")
    with opened(tmp_path / "index.html", beside=True) as page:
        assert "library.js" in page.locator("#none").text_content()
