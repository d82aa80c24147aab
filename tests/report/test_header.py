"""What a page begins with: a verdict from the record, and textures that are those of the exports."""

import base64
import io
import re
import zipfile

import numpy as np
import PIL.Image
import pytest
from helpers.exported import gilt_plates
from helpers.fit_pages import Page

from mitsvbrdf.errors import BackendError
from mitsvbrdf.export import ExportSettings
from mitsvbrdf.export.maps import write_maps
from mitsvbrdf.fit.result import Fit
from mitsvbrdf.report import header as header_page
from mitsvbrdf.report.header import header, judged, packed


@pytest.mark.parametrize("stopped, warnings, good, words", [
    ("settled", [], True, "0.025"), ("settled", ["photo 3 is dark."], False, "photo 3 is dark. "),
    ("budget", ["one", "two", "three"], False, "one (2 more"), ("interrupted", [], False, "interrupted")])
def test_the_verdict_is_that_of_the_record(stopped, warnings, good, words):
    record = {"per_photo": {"00": 0.02, "01": 0.03}, "rerender_rmse": 0.0254, "stopped": stopped}
    found, sentence = judged(record | {"warnings": warnings})
    assert found is good and words in sentence and "2 photos" in sentence


def test_the_zip_holds_what_export_writes(tmp_path):
    made = gilt_plates(16)
    written = write_maps(tmp_path, made, ExportSettings("Old brick!", "polyhaven", bits=8))
    file, data = packed(made, "Old brick!")
    inside = zipfile.ZipFile(io.BytesIO(data))
    kept = [name for name in written.files if not name.endswith("_disp.png")]
    assert file == "Old_brick.zip" and inside.namelist() == kept and len(kept) == 7
    for name in kept:
        assert inside.read(name) == (tmp_path / name).read_bytes()
    assert packed(made, "Old brick!")[1] == data


def test_the_page_has_the_textures_of_its_fit(fitted):
    page = Page(fitted / "report.html")
    link = re.search(r'download="([^"]*)" href="data:application/zip;base64,([^"]*)"', page.source)
    inside = zipfile.ZipFile(io.BytesIO(base64.b64decode(link[2])))
    stem = link[1].removesuffix(".zip")
    rough = np.asarray(PIL.Image.open(io.BytesIO(inside.read(f"{stem}_rough.png")))).astype(int)
    assert np.abs(rough - 255 * Fit.load(fitted).svbrdf["roughness"][..., 0].numpy()).max() < 0.51
    ball = page.pixels("a sphere of this material in a studio")
    assert ball.shape == (256, 256, 3) and ball.std() > 5


def test_pages_go_without_mitsuba(fitted, monkeypatch):
    def missing(*_):
        raise BackendError("libLLVM 19 or newer", "none", "install libllvm19")

    monkeypatch.setattr(header_page, "sphere", missing)
    assert header(Fit.load(fitted), quick=True)["picture"] is None


def test_heavy_textures_are_smaller_on_the_page(fitted, monkeypatch):
    monkeypatch.setattr(header_page, "SIDES", (32, 16))
    assert header(Fit.load(fitted), quick=True)["side"] == 32
    monkeypatch.setattr(header_page, "HEAVIEST", 1000)
    assert header(Fit.load(fitted), quick=True)["side"] == 16
