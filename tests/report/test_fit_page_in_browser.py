"""The page of a fit in a real browser: its controls work by pointer, touch and keyboard."""

import io
import shutil
from contextlib import contextmanager

import numpy as np
import PIL.Image
import pytest
import torch
from browser import opened
from helpers import photos_of

from mitsvbrdf import cli
from mitsvbrdf.capture import write_capture
from mitsvbrdf.io import images
from mitsvbrdf.material.made import make_material
from mitsvbrdf.report.fit_page import write_report


@pytest.fixture(scope="module")
def larger(tmp_path_factory):
    """A fit at 64 px with two photos left out, as `fit` leaves it."""
    folder = tmp_path_factory.mktemp("larger")
    write_capture(photos_of(make_material("inlay", 64)), folder / "inlay")
    options = ["--resolution", "64", "--views", "0,1,2,3,5,6,8"]
    assert cli.main(["fit", str(folder / "inlay"), "-o", str(folder / "out"), *options]) == 0
    return folder / "out" / "report.html"


@contextmanager
def read(path, **how):
    with opened(path, **how) as page:
        page.evaluate("document.querySelector('.laboratory').open = true")
        yield page


def cut(page, number=0):
    return page.locator(".wipe").nth(number).evaluate(
        "e => parseFloat(getComputedStyle(e).getPropertyValue('--cut'))")


def pixels(locator):
    return np.asarray(PIL.Image.open(io.BytesIO(locator.screenshot())).convert("RGB")).astype(int)


@pytest.mark.slow
@pytest.mark.parametrize("width, phone", [(1280, False), (390, True)])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_fits_and_reads_in_a_browser(width, phone, scheme, larger, tmp_path):
    with read(larger, width=width, height=844, scheme=scheme, phone=phone) as page:
        page.wait_for_timeout(500)  # the live view draws; errors would be said by now
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.locator(".photo").count() == 9 and page.locator(".photo.held").count() == 2
        # WCAG's contrast of text and ground, 4.5 for small text.
        contrast = page.evaluate("""() => {
          const light = text => { const [r, g, b] = text.match(/[\\d.]+/g).map(v => v / 255)
            .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
            return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
          const ground = light(getComputedStyle(document.body).backgroundColor);
          return ["p", "td", "figcaption", "nav a", ".curves text", ".settings dt", ".legend span",
                  "caption"].map(name => {
            const style = getComputedStyle(document.querySelector(name));
            const ink = light(name.endsWith("text") ? style.fill : style.color);
            return (Math.max(ink, ground) + 0.05) / (Math.min(ink, ground) + 0.05); }); }""")
        assert min(contrast) > 4.5, contrast
        page.screenshot(path=tmp_path / "page.png", full_page=True)


@pytest.mark.slow
def test_the_slider_wipes_by_keyboard_and_pointer(larger, tmp_path):
    out = shutil.copytree(larger.parent, tmp_path / "out")
    images.write_png(out / "photos/00.png", torch.tensor([1.0, 0.0, 0.0]).expand(64, 64, 3))
    write_report(out, quick=True)
    with read(out / "report.html") as page:
        wipe, slider = page.locator(".wipe").first, page.locator(".wipe input").first

        def red():  # per cent of a line of the picture that shows the photo
            line = pixels(wipe)[40]
            return 100 * np.mean((line[:, 0] > 240) & (line[:, 1:].max(axis=1) < 20))

        # the line between the two is 2 px of 270, with its shadow
        assert cut(page) == 50 and red() == pytest.approx(50, abs=3)
        slider.focus()
        page.keyboard.press("Home")
        assert cut(page) == 0 and red() < 2
        page.keyboard.press("End")
        assert cut(page) == 100 and red() > 95 and cut(page, 1) == 50
        page.keyboard.press("ArrowLeft")
        assert cut(page) == 99
        box = wipe.bounding_box()
        page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 30)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 40, steps=4)
        page.mouse.up()
        assert cut(page) == pytest.approx(25, abs=1) and red() == pytest.approx(25, abs=3)
        page.locator("#all").fill("70")
        assert [cut(page, k) for k in range(9)] == [70] * 9 and red() == pytest.approx(70, abs=3)


@pytest.mark.slow
def test_switches_and_the_large_picture_work_by_keyboard(larger):
    with read(larger) as page:
        spreads, plain = page.locator(".maps .spread"), page.locator(".maps .plain")
        assert not spreads.first.is_visible() and plain.first.is_visible()
        page.locator("#spreads").focus()
        page.keyboard.press("Space")
        assert all(spreads.nth(k).is_visible() for k in range(4)) and page.locator(".scale").is_visible()
        # the guess has no deviation
        assert [plain.nth(k).is_visible() for k in range(5)] == [False] * 4 + [True]
        page.locator("#differences").focus()
        page.keyboard.press("Space")
        assert not page.locator(".difference").first.is_visible()
        page.keyboard.press("Space")
        assert page.locator(".difference").first.is_visible()
        dialog = page.locator("#large")
        assert not dialog.is_visible()
        page.locator(".maps .enlarge").nth(3).focus()
        page.keyboard.press("Enter")
        alt = dialog.locator("img").get_attribute("alt")
        assert dialog.is_visible() and alt == "Normal: standard deviation"
        page.keyboard.press("ArrowRight")
        assert dialog.locator("span").inner_text() == "Guessed diffuse"
        page.keyboard.press("Escape")
        assert not dialog.is_visible() and page.evaluate("document.activeElement.dataset.title") == "Normal"
        page.locator(".difference").first.click()
        assert dialog.locator("span").inner_text() == "Photo 00: difference × 4"
        dialog.locator("button", has_text="Close").click()
        assert not dialog.is_visible()


@pytest.mark.slow
def test_a_phone_wipes_by_touch(larger):
    with read(larger, width=390, height=844, phone=True) as page:
        wipe = page.locator(".wipe").nth(2)
        wipe.scroll_into_view_if_needed()
        box = wipe.bounding_box()
        page.touchscreen.tap(box["x"] + 0.8 * box["width"], box["y"] + 40)
        assert cut(page, 2) == pytest.approx(80, abs=2)


@pytest.mark.slow
def test_without_javascript_all_pictures_are_there(larger):
    with read(larger) as page:
        plain = page.context.browser.new_context(java_script_enabled=False,
                                                 viewport={"width": 390, "height": 844}).new_page()
        plain.goto(larger.resolve().as_uri())
        first = plain.locator(".wipe").first
        boxes = [first.locator("img").nth(k).bounding_box() for k in (0, 1)]
        # photo and re-rendering side by side
        assert abs(boxes[0]["x"] - boxes[1]["x"]) >= boxes[0]["width"] - 1
        assert not plain.locator(".wipe input").first.is_visible() and not plain.locator("#all").is_visible()
        plain.locator("#spreads").check()
        assert plain.locator(".maps .spread").first.is_visible()


@pytest.mark.slow
@pytest.mark.parametrize("width, phone", [(1280, False), (390, True)])
def test_the_page_begins_with_the_material(width, phone, larger):
    with opened(larger, width=width, height=844, phone=phone) as page:
        top = page.locator(".front .ball").bounding_box()
        assert top["y"] + top["height"] < 844  # seen without scrolling
        assert page.locator("#photos").is_visible() and not page.locator("#curves").is_visible()
        drawn = page.evaluate("""() => { const canvas = document.querySelector(".tiling");
          const data = canvas.getContext("2d").getImageData(0, 0, 384, 384).data;
          const at = (x, y) => 4 * (384 * y + x);
          return [[...data.slice(at(20, 50), at(21, 50))], [...data.slice(at(148, 306), at(149, 306))]]; }""")
        assert drawn[0] == drawn[1] and sum(drawn[0][:3]) > 0  # the same place of two tiles
        page.get_by_role("link", name="Stability").click()
        page.wait_for_timeout(200)
        assert page.locator("#stability").is_visible()
