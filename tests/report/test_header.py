"""What a page begins with: a verdict from the record, and the material."""

import pytest
from helpers.fit_pages import Page

from mitsvbrdf.errors import BackendError
from mitsvbrdf.fit.result import Fit
from mitsvbrdf.report import header as header_page
from mitsvbrdf.report.header import header, judged


@pytest.mark.parametrize("stopped, warnings, good, words", [
    ("settled", [], True, "no warning"), ("settled", ["photo 3 is dark."], False, "photo 3 is dark. "),
    ("budget", ["one", "two", "three"], False, "one (2 more"), ("interrupted", [], False, "interrupted")])
def test_the_verdict_is_that_of_the_record(stopped, warnings, good, words):
    record = {"per_photo": {"00": 0.02, "01": 0.03}, "rerender_rmse": 0.0254, "stopped": stopped}
    found, sentence = judged(record | {"warnings": warnings})
    assert found is good and words in sentence and "2 photos" in sentence


def test_the_page_begins_with_a_sphere(fitted):
    ball = Page(fitted / "report.html").pixels("a sphere of this material in a studio")
    assert ball.shape == (256, 256, 3) and ball.std() > 5


def test_pages_go_without_mitsuba(fitted, monkeypatch):
    def missing(*_):
        raise BackendError("libLLVM 19 or newer", "none", "install libllvm19")

    monkeypatch.setattr(header_page, "sphere", missing)
    assert header(Fit.load(fitted), quick=True)["picture"] is None
