"""The sheet of tags against AprilTag's own tables and its file's drawing commands; the rig found from photos of it."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from mitsvbrdf.capture.align.from_sheet import rig_from_sheet
from mitsvbrdf.capture.align.sheet import Sheet, tag_cells, write_sheet
from mitsvbrdf.capture.align.tag_edges import _measured, find_edges
from mitsvbrdf.capture.lens import Lens, Pose, on_plane, project
from mitsvbrdf.capture.photo import Photo
from mitsvbrdf.cli import main
from mitsvbrdf.errors import CaptureError, ConfigError
from mitsvbrdf.views import texel_positions

# tag36h11_create() of AprilTag 3 (tag36h11.c): codes, highest bit first, and where in the 8 x 8 cells each bit stands.
OFFICIAL = [0xD7E00984B, 0xDDA664CA7, 0xDC4A1C821, 0xE17B470E9, 0xEF91D01B1, 0xF429CDD73, 0x05DA29225, 0x1106CBA43,
            0x223BED79D, 0x21F51213C, 0x33EB19CA6, 0x3F76EB0F8, 0x469A97414, 0x45DCFE0B0, 0x4A6465F72, 0x51801DB96]
BIT_X = [1, 2, 3, 4, 5, 2, 3, 4, 3, 6, 6, 6, 6, 6, 5, 5, 5, 4, 6, 5, 4, 3, 2, 5, 4, 3, 4, 1, 1, 1, 1, 1, 2, 2, 2, 3]
BIT_Y = [1, 1, 1, 1, 1, 2, 2, 2, 3, 1, 2, 3, 4, 5, 2, 3, 4, 3, 6, 6, 6, 6, 6, 5, 5, 5, 4, 6, 5, 4, 3, 2, 5, 4, 3, 4]
# Middles of the tags with a size of 18: along the top, down the right, back along the bottom, up the left.
MIDDLES = [(-8, 8), (-4, 8), (0, 8), (4, 8), (8, 8), (8, 4), (8, 0), (8, -4),
           (8, -8), (4, -8), (0, -8), (-4, -8), (-8, -8), (-8, -4), (-8, 0), (-8, 4)]


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
        np.testing.assert_allclose(sheet.corners[number], [(x - 1, y + 1, 0), (x + 1, y + 1, 0), (x + 1, y - 1, 0),
                                                           (x - 1, y - 1, 0)], atol=1e-12)
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
    """Of our uncompressed PDF: page size; filled rectangles and stroked ones (K x 4 x 2); lines (K x 2 x 2). Cm, y upward."""
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
    runs = runs[np.isclose(np.ptp(runs[:, :, 1], axis=1), size / 72, rtol=1e-4)]  # of black cells; letters have other heights
    np.testing.assert_allclose(np.ptp(runs.reshape(-1, 2), axis=0), size, atol=1e-4)
    outlines = np.ptp(stroked.reshape(-1, 4, 2), axis=1)
    np.testing.assert_allclose(outlines, size / 72 * np.array([[76, 76], [52, 52]]), atol=1e-4)
    lines = lines.reshape(-1, 2, 2)
    lengths = np.abs(lines[:, 1] - lines[:, 0])
    assert np.isclose(lengths, (10, 0), atol=1e-4).all(axis=1).sum() == 1  # the ruler
    ticks = np.sort(lines[np.isclose(lengths, (0, 0.3), atol=1e-4).all(axis=1), 0, 0])
    assert ticks[-1] - ticks[0] == pytest.approx(max(size, 9.0), abs=1e-4)  # the arrow's ends, or those of the ruler's half cm
    scale = 720 / size  # ten pixels a cell
    image = np.full((round(page[1] * scale), round(page[0] * scale)), 255, dtype=np.uint8)
    for run in runs:
        corners = np.rint(np.stack((run[:, 0], page[1] - run[:, 1]), axis=1) * scale - 0.5).astype(int)
        cv2.rectangle(image, corners.min(axis=0).tolist(), corners.max(axis=0).tolist(), 0, -1)
    seen = opencvs_tags(image)
    assert sorted(seen) == list(range(16))
    assert seen[0].mean(axis=0)[1] < seen[12].mean(axis=0)[1] and seen[0].mean(axis=0)[0] < seen[4].mean(axis=0)[0]


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


SHEET = Sheet(18.0)
LENS = Lens((1000, 750), 790.0, (502.0, 372.5), (0.08, -0.05))
POSES = [Pose.looking_at(*where) for where in (
    ((0.5, -0.3, 33.0), (0.3, 0.2, 0)), ((8.0, 2.0, 31.0), (0.5, 0, 0), 0.1), ((-6.0, 5.0, 33.0), (0, 0.4, 0), 2.1),
    ((1.0, -8.5, 34.0), (0, -0.5, 0), np.pi), ((-4.0, -3.0, 32.0), (-0.4, 0, 0), -1.5))]


def on_grey(picture, hole):
    return np.where(hole, 90, picture).astype(np.uint8)


def photograph(path, pose, lens=LENS, depth=0.0, picture=None, glare=None, exif=None, noise=0.004, seed=0):
    """A noisy, slightly blurred flash photo of the sheet on a grey material, in sRGB; the sheet is at height ``depth``."""
    picture = on_grey(*SHEET.picture(80)) if picture is None else picture
    sharp = cv2.GaussianBlur(picture, (0, 0), 2.5)  # 0.8 pixels of the photo, so that one sample a pixel is enough
    width, height = lens.size
    at = on_plane(lens, pose, np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2), depth)
    where = (at * (1, -1) / SHEET.outer + 0.5) * len(picture) - 0.5
    seen = cv2.remap(sharp, where.reshape(height, width, 2).astype(np.float32), None, cv2.INTER_LINEAR,
                     borderMode=cv2.BORDER_CONSTANT, borderValue=(70,)) / 255.0
    linear = 0.04 + 0.6 * seen + np.random.default_rng(seed).normal(0, noise, seen.shape)
    if glare is not None:
        linear += 3 * np.exp(-np.square(at - glare).sum(axis=1) / 2).reshape(linear.shape)
    shown = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-6) ** (1 / 2.4) - 0.055).clip(0, 1)
    kind = np.uint16 if path.suffix == ".png" else np.uint8
    quality = [cv2.IMWRITE_JPEG_QUALITY, 92] if kind == np.uint8 else []
    cv2.imwrite(str(path), np.rint(shown * np.iinfo(kind).max).astype(kind), quality)
    return Photo(path, lens.size, 1, {"35 mm focal length": exif} if exif else {})


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photos")
    names = ["a.jpg", "b.jpg", "c.png", "d.jpg", "e.jpg"]
    return [photograph(folder / name, pose, glare=(8.0, 7.5) if name == "b.jpg" else None, seed=i)
            for i, (name, pose) in enumerate(zip(names, POSES))]


def check(rig, poses, lens=LENS, position=0.001, texels=0.05):
    """Positions within a share of the distance, and rectified places within so many of 512 texels (RMS).

    Seen: 0.02 % and 0.012 texels.
    """
    texel = texel_positions(24).numpy().reshape(-1, 3) * SHEET.patch
    for name, pose in poses.items():
        found = rig.poses[name]
        assert np.linalg.norm(found.position - pose.position) < position * np.linalg.norm(pose.position)
        shown = on_plane(lens, pose, project(rig.lens, found, texel))
        assert np.sqrt(np.square(shown - texel[:, :2]).sum(axis=1).mean()) * 512 / SHEET.patch < texels


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
    found = _measured(grey, np.linspace(0, 1, 256, dtype=np.float32) ** 2.2, project(LENS, POSES[0], SHEET.corners[6]) + 0.7)
    assert (found is None) == (points is None)
    if found:
        assert abs(len(found[0]) - points) <= 1
        assert np.abs(found[3] - project(LENS, POSES[0], SHEET.corners[6])).max() < 0.2


def test_a_rig_from_photos(photos):
    told = []
    rig = rig_from_sheet(photos, 18.0, report=lambda text, share: told.append((text, share)))
    assert (rig.unit, rig.source, rig.size, rig.left_out, rig.notes) == ("cm", "sheet", SHEET.patch, {}, ())
    assert told[2][0] == "tags of c.png" and told[-1][0] == "poses"
    assert [share for _, share in told] == pytest.approx([0, 0.16, 0.32, 0.48, 0.64, 0.8])
    poses = {photo.name: pose for photo, pose in zip(photos, POSES)}
    check(rig, poses)
    assert rig.lens.focal == pytest.approx(LENS.focal, rel=2e-3)
    np.testing.assert_allclose(rig.lens.middle, LENS.middle, atol=0.5)
    assert max(rig.errors.values()) < 0.1
    for name, pose in poses.items():  # deviations are neither boasts nor excuses
        off = np.linalg.norm(rig.poses[name].position - pose.position)
        assert off / 4 < rig.deviations[name] < 0.002 * 33


def test_photos_are_measured_at_a_size_that_memory_holds(photos, monkeypatch):
    monkeypatch.setattr("mitsvbrdf.capture.align.tag_edges.MOST_PIXELS", 510)
    # Cells of three pixels, whose white bleeds into the black: 0.06 % and 0.15 texels were seen; half a pixel is 0.9 texels.
    check(rig_from_sheet(photos, 18.0), {photo.name: pose for photo, pose in zip(photos, POSES)}, position=0.002, texels=0.4)


def test_the_size_and_the_depth_of_the_sheet(tmp_path, photos):
    double = rig_from_sheet(photos, 36.0)
    np.testing.assert_allclose(double.poses["a.jpg"].position, 2 * POSES[0].position, rtol=2e-3, atol=0.1)
    assert double.size == 2 * SHEET.patch
    raised = [photograph(tmp_path / f"{i}.jpg", pose, depth=1.5) for i, pose in enumerate(POSES[:4])]
    check(rig_from_sheet(raised, 18.0, 1.5), {f"{i}.jpg": pose for i, pose in enumerate(POSES[:4])})


def covered(numbers):
    """The sheet with tags of these ids alone."""
    picture, hole = SHEET.picture(80)
    kept = on_grey(np.full_like(picture, 255), hole)
    scale = len(picture) / SHEET.outer
    for number in numbers:
        x, y = np.array(MIDDLES[number]) * (1, -1) * scale + len(picture) / 2
        part = slice(round(y - scale * 1.1), round(y + scale * 1.1)), slice(round(x - scale * 1.1), round(x + scale * 1.1))
        kept[part] = picture[part]
    return kept


def test_photos_that_do_not_help_are_named(tmp_path, photos):
    row = photograph(tmp_path / "row.jpg", POSES[0], picture=covered([0, 1, 2, 3, 4]))
    three = photograph(tmp_path / "three.jpg", POSES[0], picture=covered([0, 4, 8]))
    empty = photograph(tmp_path / "empty.jpg", POSES[0], picture=covered([]))
    turned = photograph(tmp_path / "turned.jpg", POSES[0], Lens((750, 1000), 790.0))
    cropped = photograph(tmp_path / "cropped.jpg", POSES[0], Lens((800, 750), 790.0))
    four = photograph(tmp_path / "four.jpg", POSES[2], picture=covered([0, 4, 8, 13]))
    bent = SHEET.picture(80)[0]
    bent[:, 1000:] = np.roll(bent, 24, axis=0)[:, 1000:]  # its right side is 3 mm lower
    bent = photograph(tmp_path / "bent.jpg", POSES[1], picture=bent)
    rig = rig_from_sheet([turned, row, *photos, three, bent, empty, cropped, four], 18.0)
    assert set(rig.poses) == {*(photo.name for photo in photos), "four.jpg"}
    assert rig.left_out["three.jpg"] == "3 of 16 tags seen, 4 needed"
    assert rig.left_out["empty.jpg"] == "none of 16 tags seen, 4 needed"
    assert rig.left_out["row.jpg"] == "5 of 16 tags seen, all in one line"
    assert "turned when it was stored" in rig.left_out["turned.jpg"]
    assert "800 x 750 pixels, the others have 1000 x 750" in rig.left_out["cropped.jpg"]
    assert "where a flat sheet would have them" in rig.left_out["bent.jpg"]
    poses = {photo.name: pose for photo, pose in zip(photos, POSES)}
    check(rig, poses | {"four.jpg": POSES[2]})


def test_a_sheet_that_is_bent_in_all_photos_is_noted(tmp_path):
    bent = on_grey(*SHEET.picture(80))
    bent[:, 1000:] = np.roll(bent, 24, axis=0)[:, 1000:]  # its right side is 3 mm lower
    rig = rig_from_sheet([photograph(tmp_path / f"{i}.jpg", pose, picture=bent) for i, pose in enumerate(POSES[:3])], 18.0)
    assert any("beside where those of a flat sheet would be" in note for note in rig.notes)


def test_too_few_photos(tmp_path, photos):
    empty = photograph(tmp_path / "empty.jpg", POSES[0], picture=covered([]))
    with pytest.raises(CaptureError, match="3 photos or more that show the sheet, got 2 of 3; empty.jpg: none of 16"):
        rig_from_sheet([photos[0], empty, photos[1]], 18.0)
    with pytest.raises(CaptureError, match="got 0 of 0"):
        rig_from_sheet([], 18.0)


def test_photos_from_straight_above_leave_the_focal_length_to_exif(tmp_path):
    """Focal length and height look alike from there: said, and told apart by EXIF as far as it goes."""
    poses = [Pose.looking_at((x, y, z), (x, y, 0), turn) for x, y, z, turn in
             ((0, 0, 33, 0), (0.5, 0, 33, 1.5), (0, 0.5, 33, 3.0))]
    focal = LENS.focal * np.hypot(36, 24) / np.hypot(*LENS.size) * 1.02  # rounded up by EXIF
    flat = [photograph(tmp_path / f"{i}.jpg", pose, exif=focal, seed=i) for i, pose in enumerate(poses)]
    known = rig_from_sheet(flat, 18.0)
    assert any("focal length stays uncertain" in note for note in known.notes)
    for i, pose in enumerate(poses):
        off = np.linalg.norm(known.poses[f"{i}.jpg"].position - pose.position)
        assert off < 0.05 * 33 and off < 3 * known.deviations[f"{i}.jpg"]
    check(known, {f"{i}.jpg": pose for i, pose in enumerate(poses)}, position=0.05)  # the rectified photos do not mind
