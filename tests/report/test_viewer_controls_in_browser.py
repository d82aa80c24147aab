"""The live viewer's controls in a real Chromium: pointer, keys, touch, and a lost context."""

from __future__ import annotations

import numpy as np
import pytest
from browser import FLAGS, opened
from helpers.viewer_pages import canvas_picture, shown

from mitsvbrdf import make_material
from mitsvbrdf.material.maps import flat
from mitsvbrdf.pages.page import page_text
from mitsvbrdf.report.viewer import viewer_html


@pytest.mark.slow
def test_pointer_and_keys_move_light_and_view(tmp_path):
    with shown(make_material("leather", 32), tmp_path, width=1280) as page:
        canvas, state = page.locator("canvas"), lambda: page.evaluate("mitsvbrdfViewer.state")
        box = canvas.bounding_box()

        def point(x: float, y: float) -> tuple[float, float]:
            """A point of the canvas on the page, for x, y from -1 to 1."""
            return box["x"] + box["width"] * (x + 1) / 2, box["y"] + box["height"] * (1 - y) / 2

        # The patch fills 94 % of the canvas: at its corner, (0.94, 0.94), stands the corner of the patch.
        page.mouse.move(*point(0.94, 0.94))
        # To a pixel of 576: 2 / 576 / 0.94 / 2 = 0.002.
        assert np.allclose(state()["light"], (0.5, 0.5, 1.0), atol=0.002)
        page.mouse.move(*point(-0.47, 0))
        assert np.allclose(state()["light"], (-0.25, 0, 1), atol=0.002)
        page.mouse.down()
        page.mouse.move(*point(0.03, 0.25))
        page.mouse.up()
        assert np.allclose(state()["turn"], (-30, -15), atol=0.3) and np.allclose(state()["light"], (-0.25, 0, 1), atol=0.002)
        # Seen askew, the light still stands above the point of the patch under the pointer, in the middle its centre.
        page.mouse.move(*point(0, 0))
        assert np.allclose(state()["light"], (0, 0, 1), atol=0.003)
        page.mouse.move(5, 5)
        still = state()["light"]

        canvas.focus()
        for key in ("ArrowRight", "ArrowUp", "ArrowUp", "+", "-", "-", "Shift+ArrowLeft", "Shift+ArrowUp"):
            page.keyboard.press(key)
        assert np.allclose(np.subtract(state()["light"], still), (0.05, 0.1, -0.05), atol=1e-9)
        assert np.allclose(state()["turn"], (-25, -20), atol=0.3)
        for _ in range(50):
            page.keyboard.press("Shift+ArrowLeft")
        assert state()["turn"][0] == 80  # it never turns to where the patch is a line
        assert page.evaluate("scrollY") == 0

        page.get_by_role("radio", name="Sphere").check()
        page.mouse.move(*point(0.5, -0.5))
        assert np.allclose(state()["light"][:2], (0.5, -0.5), atol=0.004)


@pytest.mark.slow
def test_every_control_is_reached_by_tab_and_has_a_name(tmp_path):
    with shown(flat(8), tmp_path) as page:
        reached = []
        for _ in range(12):
            page.keyboard.press("Tab")
            reached.append(page.evaluate("document.activeElement.name || document.activeElement.tagName"))
            style = "getComputedStyle(document.activeElement.closest('.choices label') ?? document.activeElement)"
            assert page.evaluate(style + ".outlineStyle") != "none", reached[-1]
        assert reached[:11] == ["CANVAS", "surface", "show", "diffuse", "specular", "roughness", "normal", "exposure",
                                "roughnessScale", "height", "tiles"] and reached[11] == "BUTTON"
        for name in ("Exposure", "Roughness scale", "Light height", "Tiles"):
            assert page.get_by_role("slider", name=name, exact=True).count() == 1
        page.get_by_role("slider", name="Light height").press("ArrowRight")
        assert page.evaluate("mitsvbrdfViewer.state.light[2]") == pytest.approx(1.05)


@pytest.mark.slow
@pytest.mark.parametrize("width", [320, 390, 1280])
def test_on_a_phone(width, tmp_path):
    with shown(make_material("leather", 32), tmp_path, width=width, height=800, phone=width < 600, scheme="dark") as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        canvas = page.locator("canvas")
        canvas_picture(page)
        ratio = 2 if width < 600 else 1
        assert page.evaluate("document.querySelector('canvas').width") == round(ratio * canvas.bounding_box()["width"])
        if width < 600:
            box = canvas.bounding_box()
            page.touchscreen.tap(box["x"] + box["width"] * 0.25, box["y"] + box["height"] / 2)
            assert np.allclose(page.evaluate("mitsvbrdfViewer.state.light"), (-0.25 / 0.94, 0, 1), atol=0.01)
            for label in page.locator(".choices label").all():
                assert label.bounding_box()["height"] >= 36  # CSS pixels, for fingers


@pytest.mark.slow
def test_one_finger_moves_the_light_and_two_turn_the_view(tmp_path):
    with shown(flat(8), tmp_path, width=390, height=800, phone=True) as page:
        box, remote = page.locator("canvas").bounding_box(), page.context.new_cdp_session(page)

        def touch(kind: str, *fingers: tuple[float, float]) -> dict:
            """Fingers on the canvas at x, y from -1 to 1; the state after that."""
            points = [{"x": box["x"] + box["width"] * (x + 1) / 2, "y": box["y"] + box["height"] * (1 - y) / 2, "id": number}
                      for number, (x, y) in enumerate(fingers)]
            remote.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
            page.wait_for_timeout(100)
            return page.evaluate("mitsvbrdfViewer.state")

        assert np.allclose(touch("touchStart", (0, 0))["light"], (0, 0, 1), atol=0.01)
        touch("touchMove", (-0.2, 0))  # sideways it is ours; up and down it would be the page's, which scrolls
        touch("touchMove", (-0.47, 0))
        touch("touchMove", (-0.47, 0.01))
        page.wait_for_function("Math.abs(mitsvbrdfViewer.state.light[0] + 0.25) < 0.02")  # touches come late here
        assert page.locator("canvas").evaluate("canvas => getComputedStyle(canvas).touchAction") == "pan-y"
        touch("touchStart", (-0.47, 0), (0.3, 0))
        touch("touchMove", (-0.27, 0), (0.5, 0))
        page.wait_for_function("mitsvbrdfViewer.state.turn[0] !== 0")  # a busy browser hands touches over late
        state = page.evaluate("mitsvbrdfViewer.state")
        assert np.allclose(state["turn"], (-12, 0), atol=0.5) and np.allclose(state["light"], (-0.25, 0, 1), atol=0.01)
        touch("touchEnd")
        assert np.allclose(touch("touchStart", (0, 0))["light"], (0, 0, 1), atol=0.02)  # one finger again


@pytest.mark.slow
def test_it_draws_only_when_something_changed(tmp_path):
    with shown(flat(8), tmp_path) as page:
        page.wait_for_timeout(700)
        page.evaluate("""() => { window.draws = 0; const before = WebGL2RenderingContext.prototype.drawArrays;
            WebGL2RenderingContext.prototype.drawArrays = function (...all) { window.draws++; before.apply(this, all); }; }""")
        page.wait_for_timeout(500)
        assert page.evaluate("draws") == 0
        page.evaluate("mitsvbrdfViewer.set({ exposure: 1 }); mitsvbrdfViewer.set({ exposure: 2 })")
        page.wait_for_timeout(700)
        assert page.evaluate("draws") == 2  # at once, and finer when at rest


@pytest.mark.slow
def test_a_lost_context_comes_back(tmp_path):
    with shown(make_material("inlay", 32), tmp_path) as page:
        before = canvas_picture(page)
        page.evaluate("""() => { const gl = document.querySelector("canvas").getContext("webgl2");
            window.lose = gl.getExtension("WEBGL_lose_context"); lose.loseContext(); }""")
        page.wait_for_timeout(200)
        page.evaluate("mitsvbrdfViewer.set({ exposure: 1 })")  # meanwhile nothing breaks
        page.evaluate("lose.restoreContext()")
        page.evaluate("mitsvbrdfViewer.set({ exposure: 0 })")
        assert np.array_equal(canvas_picture(page), before) and before.std() > 10


@pytest.mark.slow
def test_without_webgl_a_sentence_says_so(tmp_path):
    file = tmp_path / "viewer.html"
    file.write_text(page_text("pages/base.html", title="A material").replace("</body>", viewer_html(flat(8)) + "</body>"))
    with opened(file, flags=(FLAGS[0], "--disable-3d-apis")) as page:
        assert page.evaluate("mitsvbrdfViewer.ready") is False
        assert "needs WebGL2" in page.locator(".problem").first.inner_text()
        assert not page.locator("canvas").is_visible() and not page.get_by_role("slider").first.is_visible()
