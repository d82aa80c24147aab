"""Curves lie where their numbers say."""

import base64
import io
import math

import numpy as np
import PIL.Image
import pytest
import torch

from mitsvbrdf.report.curves import curves
from mitsvbrdf.report.pictures import picture_uri


def test_curves_are_logarithmic():
    trace = [{"seconds": 0.0, "a": 5.0}, {"seconds": 0.1, "a": 100.0, "b": 0.0}, {"seconds": 1.0, "a": 10.0},
             {"seconds": 10.0, "a": 1.0, "b": math.nan}]
    drawn = curves(trace, ["a", "b"])
    (line,) = drawn["lines"]
    x, y = ([point[k] for point in line["points"]] for k in (0, 1))
    assert line["name"] == "a" and len(x) == 3 and x[0] < x[1] < x[2] and y[0] < y[1] < y[2]  # y points down
    for a, b, c in (x, y):
        assert b - a == pytest.approx(c - b, abs=0.2)
    assert [label for _, label in drawn["x"]] == ["0.1", "1", "10"]
    assert [place for place, _ in drawn["x"]] == x and [place for place, _ in drawn["y"]] == y[::-1]
    left, top, right, bottom = drawn["frame"]
    assert all(left <= place <= right for place in x) and all(top <= place <= bottom for place in y)
    assert curves(trace[:1], ["a"]) is None and curves([], ["a"]) is None
    flat = curves([{"seconds": 2.0, "a": 3.0}], ["a"])  # one point is an axis too
    assert len(flat["x"]) > 2 and flat["lines"][0]["points"][0][2:] == (2.0, 3.0)
    narrow = curves([{"seconds": 1.0, "a": 0.0202}, {"seconds": 9.0, "a": 0.0313}], ["a"])
    labels = ["0.02", "0.022", "0.024", "0.026", "0.028", "0.03", "0.032"]
    assert [label for _, label in narrow["y"]] == labels
    long = [{"seconds": k + 1.0, "a": 1.0 / (k + 1)} for k in range(20_000)]
    points = curves(long, ["a"])["lines"][0]["points"]
    assert len(points) <= 1001 and points[-1][2] == 20_000


def test_pictures_that_would_be_large_become_jpegs():
    noise = torch.rand(256, 256, 3, generator=torch.Generator().manual_seed(0))
    smooth = torch.linspace(0, 1, 256)[:, None, None].expand(256, 256, 1)

    def decoded(uri):
        return np.asarray(PIL.Image.open(io.BytesIO(base64.b64decode(uri.split(",", 1)[1]))).convert("RGB"))

    assert picture_uri(noise).startswith("data:image/jpeg")
    assert picture_uri(smooth).startswith("data:image/png")
    assert np.array_equal(decoded(picture_uri(smooth))[:, 0, 0], np.arange(256))
    # Measured RMSE of noise, of 255: 15 in every channel; 74 with the colours at half the size.
    errors = decoded(picture_uri(noise)).astype(float) - 255 * noise.numpy()
    assert np.sqrt(np.mean(errors**2, axis=(0, 1))).max() < 20


@pytest.mark.parametrize("odd", [5e-324, 1e-307, 1e308])
def test_a_number_beyond_all_errors_is_left_out(odd):
    trace = [{"seconds": second, "a": value} for second, value in ((1.0, 0.1), (2.0, odd), (odd, 0.1))]
    assert [point[2:] for point in curves(trace, ["a"])["lines"][0]["points"]] == [(1.0, 0.1)]
