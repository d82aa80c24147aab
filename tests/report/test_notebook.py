"""What a notebook shows: small, whole HTML, pictures of the right pixels, every text escaped."""

import base64
import io
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import torch
from helpers import ANALYTIC, GRID, photos_of

from mitsvbrdf.capture import Capture
from mitsvbrdf.fit import fit_svbrdf
from mitsvbrdf.fit.config import DirectConfig
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.report.notebook import html_of

HOSTILE = "<script>alert('&\"')</script>"


class Shown(HTMLParser):
    """The fragment: text outside tags, pictures with their captions, and nothing left open."""

    def __init__(self, value):
        super().__init__()
        self.html, self.words, self.sources, self.tags, self.open = html_of(value), "", {}, set(), []
        assert len(self.html.encode()) < 1_000_000
        self.feed(self.html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        if tag == "img":
            self.sources[dict(attributes)["alt"]] = dict(attributes)["src"]
        else:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words += data

    def pixels(self, caption):
        (alt,) = (alt for alt in self.sources if alt.startswith(caption))
        head, data = self.sources[alt].split(",", 1)
        assert head == "data:image/png;base64"
        return np.asarray(PIL.Image.open(io.BytesIO(base64.b64decode(data, validate=True))))


@pytest.fixture(scope="module")
def shots():
    return photos_of(make_material("inlay", 16))


@pytest.fixture(scope="module")
def result(shots):
    return fit_svbrdf(shots, ANALYTIC, DirectConfig(iterations=2))


def test_maps_are_shown_for_display():
    # sRGB of 0.2 is 1.055 * 0.2^(1 / 2.4) - 0.055 = 0.4845 = 124 / 255, and of 0.5 it is 188 / 255.
    maps = dict(flat(8, roughness=0.6).maps)
    maps["diffuse"] = torch.zeros(8, 8, 3)
    # the first row reddish, the last column blue
    maps["diffuse"][0, :, 0], maps["diffuse"][:, 7, 2] = 0.2, 0.5
    maps["normal"] = torch.tensor([0.6, 0.0, 0.8]).expand(8, 8, 3)
    shown = Shown(SVBRDF("roughconductor", maps))
    diffuse = shown.pixels("Diffuse 0 to 0.5")
    assert diffuse.shape == (8, 8, 3)
    assert diffuse[0, 0].tolist() == [124, 0, 0] and diffuse[5, 7].tolist() == [0, 0, 188]
    assert not diffuse[1:, :7].any()
    assert (shown.pixels("Roughness 0.6 to 0.6") == 153).all()
    # 0.8, 0.5 and 0.9 of 255, halves to the even side
    assert (shown.pixels("Normal") == [204, 128, 230]).all()
    assert "roughconductor · 8 × 8 px" in shown.words


def test_large_maps_are_averaged_down():
    checks = (torch.arange(512) % 2).float()
    maps = dict(flat(512, "principled").maps) | {"metallic": (checks[:, None] != checks)[..., None].float()}
    shown = Shown(SVBRDF("principled", maps))
    metallic = shown.pixels("Metallic")
    assert metallic.shape == (128, 128, 3) and (metallic == 128).all()  # half of the texels are 1
    assert len(shown.sources) == 4


def test_values_that_are_no_numbers_are_magenta():
    maps = dict(flat(4).maps)
    below = torch.arange(4)[:, None, None] > 0
    maps["roughness"] = maps["roughness"].clone().requires_grad_().where(below, torch.nan)
    pixels = Shown(SVBRDF("roughconductor", maps)).pixels("Roughness")
    assert (pixels[0] == [255, 0, 255]).all() and (pixels[1:] == 128).all()


def test_photos_with_their_positions(shots):
    camera, light = shots.views.camera.clone(), shots.views.light.clone()
    light[1, 1] += 0.5
    capture = replace(shots, views=replace(shots.views, camera=2 * camera, light=2 * light, size=2.0),
                      index=tuple(range(1, 10)))
    shown = Shown(capture)
    for row, name in enumerate(capture.names):
        stored = np.rint(capture.photos[row].numpy().astype(np.float64) * 255)
        assert np.array_equal(shown.pixels(name), stored)
    assert "01 · camera (0.00, 0.00, 2.00), light the same" in shown.words
    assert "02 · camera (0.36, -0.32, 2.00), light (0.36, 0.18, 2.00)" in shown.words
    assert "9 photos, 16 × 16 px" in shown.words and "gamma2.2" in shown.words


def test_many_large_photos_of_noise_stay_small():
    # PNG cannot shrink noise; more photos than fit are counted, not shown.
    views = GRID.pick([0] * 30)
    photos = torch.rand(30, 128, 128, 3, generator=torch.Generator().manual_seed(0))
    shown = Shown(Capture(photos, views))
    assert len(shown.sources) == 9 and "30 photos, 9 shown" in shown.words
    assert len(shown.html.encode()) > 500_000  # the bound is tested, not missed by far


def test_a_result_shows_maps_error_and_why_it_stopped(result):
    shown = Shown(result)
    assert f"RMSE {result.rerender_rmse:.4f} over 9 photos; stopped: iterations after" in shown.words
    assert "2 iterations" in shown.words and "direct · analytic · roughconductor" in shown.words
    assert len(shown.sources) == 4 + 1 + 9
    # Re-rendered photos are shown in sRGB, whose closed form is applied here in float64.
    radiance = result.rerendered[3].double().numpy().clip(0, 1)
    srgb = np.where(radiance <= 0.0031308, 12.92 * radiance, 1.055 * radiance ** (1 / 2.4) - 0.055) * 255
    # rounded to whole steps, in float32
    assert np.abs(shown.pixels(f"#4 · {result.per_photo[3]:.4f}") - srgb).max() < 0.51
    guess = shown.pixels("Guessed diffuse").astype(float)
    expected = result.guess.double().numpy().clip(0, 1)
    expected = np.where(expected <= 0.0031308, 12.92 * expected, 1.055 * expected ** (1 / 2.4) - 0.055) * 255
    assert np.abs(guess - expected).max() < 0.51


def test_the_largest_result_stays_below_the_limit(result):
    # wide, so that averages differ
    noise = torch.rand(12, 256, 256, 3, generator=torch.Generator().manual_seed(0)) ** 9
    small = torch.nn.functional.adaptive_avg_pool2d(noise.permute(0, 3, 1, 2), 128).permute(0, 2, 3, 1)
    maps = {"diffuse": small[0], "specular": small[1], "roughness": small[2][..., :1],
            "normal": small[3] + 0.01}
    shown = Shown(result.but(svbrdf=SVBRDF("roughconductor", maps), guess=small[4], rerendered=noise,
                          per_photo=[0.1] * 12, warnings=("a long warning " * 1000,) * 1000))
    assert len(shown.sources) == 14 and shown.words.count("…") + shown.words.count("...") >= 10


@pytest.mark.parametrize("text", [HOSTILE, "\udcff", "a" * 10**6, "</div>"])
def test_texts_are_escaped(text, shots, result):
    plain = set(Shown(shots).tags) | {"ul", "li"}
    capture = replace(shots, source=Path("photos") / text.replace("/", "∕"), notes=(text, "kept"))
    for value in (capture, result.but(warnings=(text, "kept"), renderer=text, stopped=text)):
        shown = Shown(value)
        assert set(shown.tags) == plain and "kept" in shown.words and "<script" not in shown.html
        if text == HOSTILE:
            assert HOSTILE.replace("/", "∕") in shown.words or HOSTILE in shown.words


def test_a_result_without_trace_or_photos_is_shown_too(result):
    bare = result.but(trace=[], rerendered=result.rerendered[:0], per_photo=[], warnings=())
    assert len(Shown(bare).sources) == 5


def test_ipython_shows_values_as_pictures_and_importing_stays_light():
    # A value type knows no HTML: importing the package inside IPython registers it. Pictures are made by cv2,
    # matplotlib and jinja2, which only a notebook's first output may load.
    code = ("from IPython.core.interactiveshell import InteractiveShell\n"
            "shell = InteractiveShell.instance()\n"
            "import sys\nbefore = set(sys.modules)\n"
            "import mitsvbrdf\nassert 'torch' not in sys.modules\n"
            "from mitsvbrdf import SVBRDF, Capture, Fit\n"
            "found = {'mitsuba', 'drjit', 'cv2', 'matplotlib', 'jinja2'} & (set(sys.modules) - before)\n"
            "assert not found, found\n"
            "from mitsvbrdf.material.maps import flat\n"
            "html = shell.display_formatter.format(flat(2))[0]['text/html']\n"
            "assert html.count('<img') == 4 and not hasattr(flat(2), '_repr_html_')\n"
            "found = {'mitsuba', 'drjit', 'matplotlib'} & (set(sys.modules) - before)\n"
            "assert not found, found\n")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_in_a_terminal_they_are_one_line(shots, result):
    assert repr(flat(4)) == "SVBRDF(roughconductor, 4 px)"
    assert repr(shots).startswith("Capture(without a folder, photos 00, 01") and len(repr(shots)) < 120
    assert f"{result.rerender_rmse:.4f}" in repr(result) and len(repr(result)) < 120
