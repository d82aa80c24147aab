"""The sheet of tags against AprilTag's own tables and its file's drawing commands."""

import re

import cv2
import numpy as np
import pytest
from helpers.tag_sheet import MIDDLES

from mitsvbrdf.capture.align.sheet import Sheet, tag_cells, write_sheet
from mitsvbrdf.cli import main
from mitsvbrdf.errors import ConfigError

# tag36h11_create() of AprilTag 3 (tag36h11.c): codes, highest bit first, and where in the 8 x 8 cells each
# bit stands.
OFFICIAL = [0xD7E00984B, 0xDDA664CA7, 0xDC4A1C821, 0xE17B470E9, 0xEF91D01B1, 0xF429CDD73, 0x05DA29225,
            0x1106CBA43, 0x223BED79D, 0x21F51213C, 0x33EB19CA6, 0x3F76EB0F8, 0x469A97414, 0x45DCFE0B0,
            0x4A6465F72, 0x51801DB96]
BIT_X = [1, 2, 3, 4, 5, 2, 3, 4, 3, 6, 6, 6, 6, 6, 5, 5, 5, 4, 6, 5, 4, 3, 2, 5, 4, 3, 4, 1, 1, 1, 1, 1, 2, 2,
         2, 3]
BIT_Y = [1, 1, 1, 1, 1, 2, 2, 2, 3, 1, 2, 3, 4, 5, 2, 3, 4, 3, 6, 6, 6, 6, 6, 5, 5, 5, 4, 6, 5, 4, 3, 2, 5, 4,
         3, 4]


def opencvs_tags(image):
    """What OpenCV's own dictionary sees: corners (4 x 2) by id."""
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    corners, numbers, _ = detector.detectMarkers(image)
    return {int(number): four.reshape(4, 2) for number, four in zip(np.ravel(numbers), corners)}


@pytest.mark.parametrize("number", range(16))
def test_cells_are_the_official_ones(number):
    cells = np.zeros((8, 8), dtype=bool)
    for bit, (x, y) in enumerate(zip(BIT_X, BIT_Y)):
        cells[y, x] = OFFICIAL[number] >> (35 - bit) & 1
    np.testing.assert_array_equal(tag_cells(number), cells)


def test_the_layout_is_svbrdf_diff_renderers():
    sheet = Sheet(18.0)
    assert list(sheet.corners) == list(range(16)) and sheet.patch == pytest.approx(11.52)
    for number, (x, y) in enumerate(MIDDLES):
        np.testing.assert_allclose(sheet.corners[number], [(x - 1, y + 1, 0), (x + 1, y + 1, 0),
                                                           (x + 1, y - 1, 0), (x - 1, y - 1, 0)], atol=1e-12)
    np.testing.assert_allclose(Sheet(9.0).corners[5], sheet.corners[5] / 2)
    assert sheet.patch < sheet.hole - 0.5 and sheet.hole <= 14 - 2 * 0.25 and sheet.outer >= 18 + 2 * 0.25


def test_white_is_paper_and_nothing_else():
    sheet = Sheet(18.0)
    at = np.random.default_rng(0).uniform(-11, 11, (20000, 2))
    margin = 0.25 - 1e-9
    tags = np.array([(np.abs(at - middle).max(axis=1) <= 1 + margin) for middle in MIDDLES]).any(axis=0)
    reach = np.abs(at).max(axis=1)
    paper = ~tags & (reach > sheet.hole / 2 + margin) & (reach < sheet.outer / 2 - margin)
    white = sheet.white(at)
    assert not (white & ~paper).any()
    assert white.sum() > 0.9 * paper.sum()  # only diagonal neighbours of corners are left out besides
    np.testing.assert_array_equal(Sheet(6.0).white(at / 3), white)


def test_the_picture_is_the_sheet():
    sheet = Sheet(18.0)
    picture, hole = sheet.picture(23.7)  # cells and pixels do not fit
    assert picture.shape == hole.shape == (450, 450) and picture.dtype == np.uint8
    seen = opencvs_tags(picture)
    assert sorted(seen) == list(range(16))
    for number, (x, y) in enumerate(MIDDLES):
        middle = np.array((x, -y)) / sheet.outer * 450 + 224.5
        assert np.abs(seen[number].mean(axis=0) - middle).max() < 0.5
    black = 255 - picture.astype(np.float64)
    cells = sum((~tag_cells(number)).sum() for number in range(16))
    # Rounded to 8 bits, else exact: 2e-5 was seen.
    assert black.sum() / 255 * (sheet.outer / 450) ** 2 == pytest.approx(cells * sheet.cell**2, rel=2e-4)
    assert hole.sum() * (sheet.outer / 450) ** 2 == pytest.approx(sheet.hole**2, rel=0.01)
    assert (picture[hole] == 255).all()


def drawn(pdf):
    """Of our uncompressed PDF: page size; filled rectangles and stroked ones (K x 4 x 2); lines (K x 2 x 2).
    Cm, y upward.
    """
    text = pdf.read_bytes().decode("latin-1")
    box = re.search(r"/MediaBox \[ ([\d. ]+) \]", text)[1].split()
    to, at = r"(-?[\d.]+) (-?[\d.]+) l\n", r"(-?[\d.]+) (-?[\d.]+) m\n"
    patterns = (at + 3 * to + "h", at + 3 * to + r"(?:[\d. -]+ l\n)h\n\nS", at + to + "\nS")
    found = (re.findall(pattern, text) for pattern in patterns)
    return [np.array(numbers, dtype=float) / 72 * 2.54 for numbers in (box, *found)]


@pytest.mark.parametrize("size, paper, page", [(18.0, "a4", (21.0, 29.7)), (19.4, "letter", (21.59, 27.94)),
                                               (5.0, "a4", (21.0, 29.7))])
def test_the_file_has_its_true_size(tmp_path, size, paper, page):
    write_sheet(tmp_path / "sheet.pdf", size, paper)
    box, filled, stroked, lines = drawn(tmp_path / "sheet.pdf")
    np.testing.assert_allclose(box[2:], page, atol=1e-6)
    runs = filled.reshape(-1, 4, 2)
    # of black cells; letters have other heights
    runs = runs[np.isclose(np.ptp(runs[:, :, 1], axis=1), size / 72, rtol=1e-4)]
    np.testing.assert_allclose(np.ptp(runs.reshape(-1, 2), axis=0), size, atol=1e-4)
    outlines = np.ptp(stroked.reshape(-1, 4, 2), axis=1)
    np.testing.assert_allclose(outlines, size / 72 * np.array([[76, 76], [52, 52]]), atol=1e-4)
    lines = lines.reshape(-1, 2, 2)
    lengths = np.abs(lines[:, 1] - lines[:, 0])
    assert np.isclose(lengths, (10, 0), atol=1e-4).all(axis=1).sum() == 1  # the ruler
    ticks = np.sort(lines[np.isclose(lengths, (0, 0.3), atol=1e-4).all(axis=1), 0, 0])
    # the arrow's ends, or those of the ruler's half cm
    assert ticks[-1] - ticks[0] == pytest.approx(max(size, 9.0), abs=1e-4)
    scale = 720 / size  # ten pixels a cell
    image = np.full((round(page[1] * scale), round(page[0] * scale)), 255, dtype=np.uint8)
    for run in runs:
        corners = np.rint(np.stack((run[:, 0], page[1] - run[:, 1]), axis=1) * scale - 0.5).astype(int)
        cv2.rectangle(image, corners.min(axis=0).tolist(), corners.max(axis=0).tolist(), 0, -1)
    seen = opencvs_tags(image)
    assert sorted(seen) == list(range(16))
    assert seen[0].mean(axis=0)[1] < seen[12].mean(axis=0)[1] and seen[0].mean(axis=0)[0] < seen[4].mean(
        axis=0)[0]


@pytest.mark.slow
def test_other_files_and_sizes(tmp_path):
    for name, begins in (("sheet.svg", b"<?xml"), ("sheet.png", b"\x89PNG")):
        write_sheet(tmp_path / name, 10.0)
        assert (tmp_path / name).read_bytes().startswith(begins)
    picture = cv2.imread(str(tmp_path / "sheet.png"), cv2.IMREAD_GRAYSCALE)
    seen = opencvs_tags(cv2.resize(picture, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA))
    assert sorted(seen) == list(range(16))
    for size, paper in ((19.0, "a4"), (19.6, "letter"), (4.9, "a4"), (float("nan"), "a4")):
        with pytest.raises(ConfigError, match="a size of 5 to 1[89]"):
            write_sheet(tmp_path / "no.pdf", size, paper)
    with pytest.raises(ConfigError, match=r"\.pdf, \.svg or \.png"):
        write_sheet(tmp_path / "sheet.docx")
    assert not (tmp_path / "no.pdf").exists()


def test_the_command(tmp_path, capsys):
    out = tmp_path / "sheet.pdf"
    assert main(["sheet", "-o", str(out), "--size", "15.5", "--paper", "letter"]) == 0
    assert drawn(out)[0][2:] == pytest.approx((21.59, 27.94))
    assert main(["sheet", "-o", str(out)]) == 2 and "which exists" in capsys.readouterr().err
    assert main(["sheet", "-o", str(out), "--size", "40", "--overwrite"]) == 2
