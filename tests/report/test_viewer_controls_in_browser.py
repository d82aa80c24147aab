"""The live viewer's controls in a real Chromium: pointer, keys, touch, and a lost context."""

import numpy as np
import pytest
from browser import FLAGS, opened
from helpers.viewer_pages import canvas_picture, shown

from mitsvbrdf import make_material
from mitsvbrdf.material.maps import flat
from mitsvbrdf.report.page import page_text
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
        assert np.allclose(state()["turn"], (-30, -15), atol=0.3)
        assert np.allclose(state()["light"], (-0.25, 0, 1), atol=0.002)
        # Seen askew, the light still stands above the point of the patch under the pointer.
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
            outline = page.evaluate("""() => { const at = document.activeElement;
                return getComputedStyle(at.closest(".choices label") ?? at).outlineStyle; }""")
            assert outline != "none", reached[-1]
        assert reached == ["CANVAS", "surface", "show", "diffuse", "specular", "roughness",
                           "normal", "exposure", "roughnessScale", "height", "tiles", "BUTTON"]
        for name in ("Exposure", "Roughness scale", "Light height", "Tiles"):
            assert page.get_by_role("slider", name=name, exact=True).count() == 1
        page.get_by_role("slider", name="Light height").press("ArrowRight")
        assert page.evaluate("mitsvbrdfViewer.state.light[2]") == pytest.approx(1.05)


@pytest.mark.slow
def test_nothing_is_decoded_or_drawn_before_it_is_in_view(tmp_path):
    (tmp_path / "it.html").write_text(f'<!doctype html><p style="height: 3000px"></p>{viewer_html(flat(8))}')
    with opened(tmp_path / "it.html", width=420, height=600) as page:
        page.wait_for_timeout(500)
        assert page.locator(".status").text_content() == ""
        page.locator("canvas").scroll_into_view_if_needed()
        canvas_picture(page)
        assert page.locator(".status").text_content().startswith("Light")


@pytest.mark.slow
@pytest.mark.parametrize("width", [320, 390, 1280])
def test_on_a_phone(width, tmp_path):
    with shown(make_material("leather", 32), tmp_path, width=width, height=800, phone=width < 600,
               scheme="dark") as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        canvas = page.locator("canvas")
        canvas_picture(page)
        wanted = round((2 if width < 600 else 1) * canvas.bounding_box()["width"])
        assert page.evaluate("document.querySelector('canvas').width") == wanted
        if width < 600:
            box = canvas.bounding_box()
            page.touchscreen.tap(box["x"] + box["width"] * 0.25, box["y"] + box["height"] / 2)
            assert np.allclose(page.evaluate("mitsvbrdfViewer.state.light"), (-0.25 / 0.94, 0, 1), atol=0.01)
            for label in page.locator(".choices label").all():
                assert label.bounding_box()["height"] >= 36  # CSS pixels, for fingers


@pytest.mark.slow
def test_one_finger_moves_the_light_and_two_turn_the_view(tmp_path):
    with shown(flat(8), tmp_path, width=390, height=800, phone=True) as page:
        # The browser scrolls the page with fingers that move up and down: these events are made by hand.
        assert page.locator("canvas").evaluate("canvas => getComputedStyle(canvas).touchAction") == "pan-y"
        page.locator("canvas").evaluate("canvas => { canvas.setPointerCapture = () => {}; }")

        def touch(kind: str, finger: int, x: float = 0.0, y: float = 0.0) -> dict:
            """A finger on the canvas at x, y from -1 to 1; the state after that."""
            return page.locator("canvas").evaluate("""(canvas, [kind, finger, x, y]) => {
                const box = canvas.getBoundingClientRect();
                canvas.dispatchEvent(new PointerEvent(kind, { pointerId: finger, pointerType: "touch",
                    bubbles: true, clientX: box.left + box.width * (x + 1) / 2,
                    clientY: box.top + box.height * (1 - y) / 2 }));
                return mitsvbrdfViewer.state; }""", [kind, finger, x, y])

        assert np.allclose(touch("pointerdown", 1)["light"], (0, 0, 1), atol=0.01)
        assert np.allclose(touch("pointermove", 1, -0.47, -0.47)["light"], (-0.25, -0.25, 1), atol=0.01)
        touch("pointerdown", 2, 0.3, -0.47)
        touch("pointermove", 1, -0.27, -0.47)
        state = touch("pointermove", 2, 0.5, -0.47)
        assert np.allclose(state["turn"], (-12, 0), atol=0.5)
        assert np.allclose(state["light"], (-0.25, -0.25, 1), atol=0.01)
        for finger in (1, 2):
            touch("pointerup", finger)
        assert np.allclose(touch("pointerdown", 3)["light"], (0, 0, 1), atol=0.02)  # one finger again


@pytest.mark.slow
def test_it_draws_only_when_something_changed(tmp_path):
    with shown(flat(8), tmp_path) as page:
        canvas_picture(page)
        page.evaluate("""() => { window.rows = [];
            const all = WebGL2RenderingContext.prototype, before = all.scissor;
            all.scissor = function (...box) { window.rows.push(box[3]); before.apply(this, box); }; }""")
        page.wait_for_timeout(500)
        assert page.evaluate("rows") == []
        page.evaluate("mitsvbrdfViewer.set({ exposure: 1 }); mitsvbrdfViewer.set({ exposure: 2 })")
        canvas_picture(page)
        side, rows = page.evaluate("document.querySelector('canvas').height"), page.evaluate("rows")
        assert rows[0] == side == sum(rows[1:])  # at once, and finer when at rest, each row once


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
    file.write_text(page_text("report/base.html", title="A material").replace("</body>", viewer_html(flat(8))
                                                                             + "</body>"))
    with opened(file, flags=(FLAGS[0], "--disable-3d-apis")) as page:
        assert page.evaluate("mitsvbrdfViewer.ready") is False
        assert "needs WebGL2" in page.locator(".problem").first.inner_text()
        assert not page.locator("canvas").is_visible() and not page.get_by_role("slider").first.is_visible()
