"""The live page in a real browser."""

import json
import subprocess
import sys
import time

import pytest
from helpers.live_fits import FAST, fit_into, served, state_of

from mitsvbrdf import cli
from mitsvbrdf.report.live import ADDRESS

PHASE = "document.body.dataset.phase"


@pytest.fixture
def browser():
    from browser import FLAGS, chromium
    executable = chromium()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.mark.slow
def test_a_browser_sees_a_fit_start_run_end_and_start_anew(browser, tmp_path):
    photos, out = tmp_path / "photos", tmp_path / "out"
    assert cli.main(["synth", "builtin:inlay", "-o", str(photos), "--resolution", "64", "--noise",
                     "0.003"]) == 0
    fit = [sys.executable, "-m", "mitsvbrdf", "fit", str(photos), "-o", str(out), "--method", "direct",
           "--resolution", "64",
           "--budget", "8"]
    said, asked = [], []
    with served(out) as ask:
        page = browser.new_page()
        page.on("console", lambda message: "GPU stall" in message.text or said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"http://{ADDRESS}:{ask.port}/")
        page.wait_for_selector("body[data-phase=waiting]")
        assert f"No fit in {out} yet" in page.inner_text("#says") and page.is_hidden("#live")
        for options in ([], ["--overwrite"]):
            process = subprocess.Popen([*fit, *options], stdout=subprocess.DEVNULL)
            page.wait_for_selector("body[data-phase=running]", timeout=120_000)
            assert page.locator("iframe").count() == 0 and page.is_visible("#live")
            points, pictures, shares = set(), set(), []
            while page.evaluate(PHASE) == "running":
                points.add(page.eval_on_selector("#error polyline", "line => line.points.numberOfItems"))
                pictures.add(page.eval_on_selector("#maps img", "image => image.currentSrc"))
                shares.append(page.eval_on_selector("progress", "bar => bar.value"))
                time.sleep(0.5)
            # Eight seconds with a record a second, on a machine that may be busy.
            assert len(points) >= 3 and len(pictures) >= 3 and shares == sorted(shares) and shares[
                -1] > shares[0]
            assert page.eval_on_selector_all("#maps img", "images => images.map(i => [i.naturalWidth, "
                                                          "i.naturalHeight])") == [
                [64, 64]] * 4
            assert process.wait(timeout=120) == 0
            page.wait_for_selector("body[data-phase=done]", timeout=60_000)
            page.wait_for_selector("iframe")
            frame = page.frame_locator("iframe")
            assert f"{json.loads((out / 'fit.json').read_text())['rerender_rmse']:.4f}" in frame.locator(
                "body").inner_text()
            assert page.is_hidden("#live") and page.title().startswith("photos")
    assert not said
    outside = [url for url in asked if not url.startswith((f"http://{ADDRESS}:{ask.port}/", "data:",
                                                           "blob:"))]
    assert not outside and len([url for url in asked if "/report.html?" in url]) == 2


@pytest.mark.slow
def test_a_browser_is_told_of_a_fit_that_dies_and_of_a_server_that_ends(browser, tmp_path, capture,
                                                                        every_step):
    out = tmp_path / "out"
    with served(out) as ask:
        page = browser.new_page(viewport={"width": 390, "height": 844}, color_scheme="dark")
        page.goto(f"http://{ADDRESS}:{ask.port}/")

        def seen(losses, _):  # the page has drawn the last state before the fit dies
            state = state_of(ask)
            if losses is None:
                page.wait_for_selector(f"#maps img[src*=normal][src$='{state['fit']['version']}']")

        with pytest.raises(ZeroDivisionError):
            fit_into(out, capture, FAST, seen, fails=ZeroDivisionError())
        page.wait_for_selector("body[data-phase=died]")
        assert "without a result" in page.inner_text("#says") and "last state" in page.inner_text(
            "#maps-note")
        page.wait_for_selector("#maps img[src*=normal]")
        assert page.eval_on_selector_all("#maps img", "images => images.map(i => i.naturalWidth)") == [16] * 4
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.is_hidden("#lost")
    page.wait_for_selector("#lost", state="visible")
