"""Edges of tags to hundredths of a pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.tag_sheet import LENS, POSES, SHEET, on_grey, photograph

from mitsvbrdf.capture.align.tag_edges import _measured, find_edges
from mitsvbrdf.capture.lens import project


@pytest.mark.parametrize("i", range(5))
def test_edges_are_measured_to_hundredths_of_a_pixel(photos, i):
    edges = find_edges(photos[i], SHEET)
    points = np.column_stack((edges.plane, np.zeros(len(edges.plane))))
    off = ((edges.pixels - project(LENS, POSES[i], points)) * edges.across).sum(axis=1)
    # Seen: RMS 0.014 to 0.018, means up to 0.002, corners 0.06.
    assert np.sqrt(np.square(off).mean()) < 0.04 and abs(off.mean()) < 0.006
    assert len(edges.corners) == (15 if i == 1 else 16)  # one lies under the glare
    for number, four in edges.corners.items():
        assert np.abs(four - project(LENS, POSES[i], SHEET.corners[number])).max() < 0.15


@pytest.mark.parametrize("shown, points", [(1.0, 32), (0.6, 29), (0.2, None)])
def test_a_tag_of_which_too_little_shows_does_not_count(tmp_path, shown, points):
    """The paper beside the right edge of tag 6 is as dark as the tag, but for its upper part."""
    picture = on_grey(*SHEET.picture(80))
    right, top, bottom = (round((v / SHEET.outer + 0.5) * len(picture)) for v in (9, -1, 1))
    picture[top + round(shown * (bottom - top)) : bottom + 40, right:] = 0
    photo = photograph(tmp_path / "dark.jpg", POSES[0], picture=picture)
    grey = cv2.imread(str(photo.path), cv2.IMREAD_GRAYSCALE)
    found = _measured(grey, np.linspace(0, 1, 256, dtype=np.float32) ** 2.2,
                      project(LENS, POSES[0], SHEET.corners[6]) + 0.7)
    assert (found is None) == (points is None)
    if found:
        assert abs(len(found[0]) - points) <= 1
        assert np.abs(found[3] - project(LENS, POSES[0], SHEET.corners[6])).max() < 0.2
