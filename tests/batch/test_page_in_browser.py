"""The page of a library in a real Chromium."""

from __future__ import annotations

import functools
import http.server
import threading
import time
from contextlib import contextmanager

import pytest
from browser import opened
from helpers.libraries import library_of, random_rows, write_library

from mitsvbrdf.batch.library.page import address, write_library_page
from mitsvbrdf.batch.library.where import matcher, number_of
from mitsvbrdf.batch.manifest import now

COUNT = 600
NAMES = "[...document.querySelectorAll('#cards .name')].map(name => name.textContent)"
HOSTILE = ['<img src=x onerror="hit()">', "</script><script>hit()</script>", '"><svg onload=hit()>',
           "javascript:hit()",
           "'-hit()-'", "{{ 7 * 7 }}", "\u2028\u2029\u202e", "__proto__", "${hit()}"]


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


def first_names(page, count: int = 5) -> list[str]:
    return page.evaluate(NAMES)[:count]


def write(page, text: str) -> str:
    """Put this expression; give what the page says of it."""
    page.locator("#where").fill(text)
    two_frames(page)
    return page.locator("#shown").text_content()


@pytest.mark.slow
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
        assert page.evaluate("document.documentElement.scrollHeight") == height
        until(page, "[...document.querySelectorAll('#cards img')].every(img => img.naturalWidth == 128)")
        sizes = page.evaluate("""[...document.querySelectorAll('button, a, input, select')]
            .map(target => target.getBoundingClientRect()).filter(box => box.width)
            .map(box => Math.min(box.width, box.height))""")
        assert min(sizes) > 43.5


@pytest.mark.slow
def test_a_filter_shows_the_right_rows(library):
    rows, file = library
    with opened(file, beside=True) as page:
        for text in ("error<0.03 tag:wood", "state:failed", "warnings>0 date>2026-11-01T00:20", "cork old",
                     "method:gan"):
            meant = {row["name"] for row in rows if matcher(text)(row)}
            assert write(page, text) == f"{len(meant)} of {COUNT} materials" and 0 < len(meant) < COUNT
            assert first_names(page) and meant.issuperset(first_names(page, 50))
            said = write(page, text + " eror<1")
            assert said.startswith("Expected one of error, ") and "got eror; error is the nearest; " in said
            assert not first_names(page)
        assert write(page, "") == f"{COUNT} materials"
        page.evaluate("""() => {
          const [box, sort] = [document.getElementById("where"), document.getElementById("sort")];
          [box.value, sort.value] = ["cork", "date"];
          box.dispatchEvent(new Event("input"));
          sort.dispatchEvent(new Event("change"));  // before the frame that would have shown what was typed
        }""")
        two_frames(page)
        assert page.locator("#where").input_value() == "cork" and " of " in page.locator(
            "#shown").text_content()


@pytest.mark.slow
@pytest.mark.parametrize("field", ["error", "left_out_error", "warnings", "memory", "date"])
def test_sorting_puts_missing_values_last(library, field):
    rows, file = library
    by_name = {row["name"]: row["date"] if field == "date" else number_of(row, field) for row in rows}
    there = sorted(value for value in by_name.values() if value is not None)
    with opened(file, beside=True) as page:
        page.locator("#sort").select_option(field)
        assert [by_name[name] for name in first_names(page)] == there[:5]
        page.locator("#down").click()
        assert [by_name[name] for name in first_names(page)] == there[::-1][:5]
        page.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
        until(page, f"document.querySelector('#cards li:last-child').getAttribute('aria-posinset') == {COUNT}")
        assert by_name[page.locator("#cards .name").last.text_content()] == (None if len(there) < COUNT
                                                                             else there[0])


@pytest.mark.slow
def test_chips_write_into_the_expression(library):
    rows, file = library
    with opened(file, beside=True) as page:
        page.locator("#tags button", has_text="more tags").click()
        page.locator("#tags button", has_text="old wood").click()
        page.locator("#tags button", has_text="with warnings").click()
        page.locator("#states button", has_text="Done").click()
        text = page.locator("#where").input_value()
        assert text == 'tag:"old wood" warnings>0 state:done'
        assert page.locator("#shown").text_content() == f"{sum(map(matcher(text), rows))} of {COUNT} materials"
        assert page.evaluate("document.activeElement.dataset.name") == "Done"
        page.locator("#tags button", has_text="old wood").click()
        page.locator("#states button", has_text="All").click()
        assert page.locator("#where").input_value() == "warnings>0"


@pytest.mark.slow
def test_reload_and_link_show_the_same(library):
    _, file = library
    with opened(file, beside=True) as page:
        write(page, "tag:wood,brick,cork")
        page.locator("#sort").select_option("error")
        page.evaluate("scrollTo(0, 1500)")
        until(page, "location.hash.includes('at=')")
        two_frames(page)
        top, names, link = page.evaluate("scrollY"), first_names(page), page.evaluate("location.hash")
        page.reload()
        assert abs(page.evaluate("scrollY") - top) <= 1 and first_names(page) == names
        page.locator("#cards a.card").nth(20).click()
        page.wait_for_url("**/report.html")
        page.go_back()
        until(page, "document.querySelector('#cards li')")
        assert abs(page.evaluate("scrollY") - top) < 400 and page.locator(
            "#where").input_value() == "tag:wood,brick,cork"
    with opened(file, beside=True, at=link) as page:
        assert abs(page.evaluate("scrollY") - top) <= 1 and first_names(page) == names


@pytest.mark.slow
def test_a_card_opens_its_report_or_tells_about_it(library):
    rows, file = library
    failed = next(row for row in rows if row["state"] == "failed")
    with opened(file, beside=True) as page:
        write(page, failed["name"])
        assert failed["reason"] in page.locator("#cards .failed").text_content()
        page.locator("#cards button.card").click()
        assert failed["source"] in page.locator("#details dl").text_content()
        assert page.locator("#details a").get_attribute("href") == address(failed["log"])
        page.keyboard.press("Escape")
        assert not page.locator("#details").is_visible()
        page.locator("#cards .failed .log").click()
        page.wait_for_url("**/log.txt")
        assert page.locator("body").inner_text() == f"the log of {failed['name']}"
        page.go_back()
        done = next(row for row in rows if row["warnings"])
        write(page, f'"{done["name"]}"')
        page.locator("#cards .more").click()
        assert done["warnings"][0] in page.locator("#details dl").text_content()
        page.locator("#details [aria-label=Close]").click()
        assert page.locator("#cards a.card").get_attribute("href") == address(done["report"])


@pytest.mark.slow
def test_materials_of_one_name_say_what_differs(tmp_path):
    rows = [row | {"name": "oak", "source": f"/shots/day-{k % 2}/oak", "options": "--budget 60" * (k > 1)}
            for k, row in enumerate(random_rows(4))]
    with opened(write_library(tmp_path, [*rows, random_rows(5)[4]]), beside=True) as page:
        assert sorted(page.locator("#cards .apart").all_text_contents()) == sorted(
            f"day-{k} · {options}" for k in (0, 1) for options in ("default options", "--budget 60"))
        bottoms = page.evaluate("[...document.querySelectorAll('#cards .under')].map(e => "
                                "e.getBoundingClientRect().bottom)")
        assert len(set(bottoms)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 3, 40])
@pytest.mark.parametrize("window", [{}, {"width": 390, "height": 844, "phone": True}],
                         ids=["desktop", "phone"])
def test_a_library_of_any_size_and_state_keeps_inside_the_window(tmp_path, count, window):
    rows = random_rows(count, unfinished=count == 40)
    for row in rows[:2]:
        row |= {"state": "failed", "reason": "expected a capture, got /a/very/long/" + 30 * "path" + "; "
                + "mend it " * 40,
                "preview": None, "report": None, "error": None, "name": "oak" * 40}
    file = write_library(tmp_path, rows, stopped=True, command="mitsvbrdf batch " + "shots/" * 40)
    with opened(file, beside=True, **window) as page:
        two_frames(page)
        assert page.evaluate("document.documentElement.scrollWidth - innerWidth") == 0
        errors = sum(row["error"] is not None for row in rows)
        assert page.locator(".histogram").is_visible() == (errors >= 10)
        assert (f"Error of the {errors} material" in page.locator("#errors").text_content()) == (errors > 0)
        assert page.locator("#tools").is_visible() == (count > 0) and page.locator("#none").is_visible() == (
            count == 0)
        assert page.locator("#progress code").is_visible() == (count == 40)
        lowest = page.evaluate("""[...document.querySelectorAll('#cards li')].map(card =>
            Math.max(...[...card.querySelectorAll('*')].map(part => part.getBoundingClientRect().bottom))
            - card.querySelector('.under').getBoundingClientRect().bottom)""")
        assert not lowest or max(lowest) <= 0.5  # a long reason stays inside its card


@pytest.mark.slow
def test_the_keyboard_walks_through_all(library):
    _, file = library
    with opened(file, beside=True, width=500, height=600) as page:
        write(page, "state:done")  # the others have a log to stop at, too
        page.locator("#cards .card").first.focus()
        for _ in range(60):
            page.keyboard.press("Tab")
        page.wait_for_timeout(100)
        at = page.evaluate("document.activeElement.closest('li').getAttribute('aria-posinset')")
        assert at == "31" and page.evaluate("document.activeElement.getBoundingClientRect().top") < 600


@pytest.mark.slow
def test_strangers_names_are_text(tmp_path):
    rows = []
    for k, text in enumerate(HOSTILE):
        texts = ("name", "source", "host", "worker", "options", "method", "reason", "id", "report", "log",
                 "folder")
        rows.append(random_rows(1, seed=k)[0] | dict.fromkeys(texts, text) | {
            "tags": [text], "warnings": [text], "state": "failed" if k % 2 else "done", "preview": None})
    write_library_page(tmp_path,
                       library_of(rows, title="</title><script>hit()</script><img src=x onerror=hit()>"))
    with opened(tmp_path / "index.html", beside=True) as page:
        page.evaluate("() => { window.hits = 0; window.hit = () => hits++; }")
        assert sorted(page.locator("#cards .name").all_text_contents()) == sorted(HOSTILE)
        for k in range(len(HOSTILE)):
            page.locator("#cards .more").nth(k).click()
            page.keyboard.press("Escape")
        page.locator("#tags button", has_text="more tags").click()
        for chip in range(page.locator("#tags button").count()):
            page.locator("#tags button").nth(chip).click()
            # the first: with warnings
            shown = f"{len(rows)} materials" if chip == 0 else f"1 of {len(rows)} materials"
            assert page.locator("#shown").text_content() == shown
            page.locator("#tags button").nth(chip).click()
        tags = "#cards img, #cards svg, #cards script, #details script, #details svg, #tags img, h1 img"
        assert page.evaluate("tags => [hits, document.querySelectorAll(tags).length]", tags) == [0, 0]
        assert set(page.evaluate("[...document.querySelectorAll('a')].map(link => link.protocol)")) <= {
            "file:"}


@contextmanager
def served(folder):
    """The address of a folder on a static server."""
    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *args):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0),
                                         functools.partial(Quiet, directory=folder)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/index.html"
        server.shutdown()


@pytest.mark.slow
def test_a_batch_at_work_is_followed(tmp_path):
    rows = random_rows(COUNT, unfinished=True)
    progress = {"per_hour": 312.5, "left_seconds": 7300}
    file = write_library(tmp_path, rows, title="At work", progress=progress, made=now())
    with opened(file, beside=True) as page:  # from disk: as it was when it was written
        assert page.locator("#progress").is_visible() and page.title() == "At work"
        with served(tmp_path) as url:
            followed = page.context.browser.new_page()
            said: list[str] = []
            followed.on("console", lambda message: said.append(message.text))
            followed.goto(url)
            words = "480 of 600 ended, 80 % · this run: 313 an hour, about 2 h 2 min left"
            assert followed.locator("#progress p").text_content() == words and followed.title() == "80 % · At work"
            write(followed, "resolution:256")
            followed.evaluate("scrollTo(0, 1200)")
            until(followed, "location.hash.includes('at=')")
            before = followed.evaluate("scrollY"), first_names(followed)
            # A page that took long to read its data looks again after 20 times as long.
            stopped = {"stopped": True, "command": "mitsvbrdf batch shots -o lib"}
            write_library_page(tmp_path, library_of(rows, title="At work", **stopped))
            until(followed, "document.title == 'stopped · At work'", 120)
            assert followed.locator("#progress code").text_content() == stopped["command"]
            assert "stopped, 120 left; run the same" in followed.locator("#progress p").text_content()
            for row in rows:
                row["state"] = "failed" if row["state"] == "failed" else "done"
            write_library_page(tmp_path, library_of(rows, title="At work"))
            until(followed, "document.title == 'At work'", 120)
            assert followed.locator("#where").input_value() == "resolution:256" and first_names(
                followed) == before[1]
            assert not followed.locator("#progress").is_visible() and not said
