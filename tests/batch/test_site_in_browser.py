"""A library followed in a real browser, from before there is one."""

import pytest
from helpers.libraries import random_rows, write_whole_library
from helpers.live_fits import served

from mitsvbrdf.cli.view import _Followed


@pytest.mark.slow
def test_materials_appear_by_themselves(tmp_path):
    from browser import FLAGS, chromium
    executable = chromium()
    from playwright.sync_api import expect, sync_playwright

    root, rows, said, asked, loads = tmp_path / "library", random_rows(12), [], [], []
    done = [row for row in rows if row["state"] == "done"]
    with served(root, _Followed) as ask, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(FLAGS))
        page = browser.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"http://127.0.0.1:{ask.port}/")
        page.wait_for_selector("body[data-phase=waiting]")
        root.mkdir()
        (root / ".token").write_text("")
        page.wait_for_selector("#none", state="visible")  # the page of a library, still empty
        assert "no captures yet" in page.inner_text("#none")
        page.on("load", lambda: loads.append(1))
        for count in (3, len(done)):
            write_whole_library(root, done[:count])
            expect(page.locator("#cards > li.done")).to_have_count(count, timeout=20_000)
        expect(page.locator("#cards img").first).to_have_js_property("naturalWidth", 128)
        assert not loads and not said
        name = page.locator("#cards .name").first.inner_text()
        page.locator("#cards a.card").first.click()
        expect(page.locator("body")).to_have_text("a report")
        assert page.title() == name and not said
        assert all(url.startswith((f"http://127.0.0.1:{ask.port}/", "data:", "blob:")) for url in asked)
        browser.close()
