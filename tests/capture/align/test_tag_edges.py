"""Edges of tags to hundredths of a pixel."""

import cv2
import numpy as np
import pytest
from helpers.tag_sheet import LENS, POSES, SHEET, on_grey, photograph

from mitsvbrdf.capture.align.from_sheet import rig_from_sheet
from mitsvbrdf.capture.align.tag_edges import _measured, find_edges
from mitsvbrdf.capture.lens import Lens, Pose, project
from mitsvbrdf.capture.photo import Photo


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


# Pictures hardly larger than the frame of tags, of a lens that bends; how many tags have all or part in them.
CLOSE = Lens((760, 760), 1400.0, (381.0, 378.0), (0.03, 0.0))


@pytest.mark.parametrize("position, target, least", [
    ((0.5, -0.3, 32.7), (0, 0, 0), 16), ((3, 2, 32.7), (0, 0, 0), 16), ((-4, 3, 32.4), (0.1, 0.1, 0), 14),
    ((2, 3, 31.6), (0, 0, 0), 14), ((2, 3, 32), (1.2, 0, 0), 14)])
def test_tags_that_the_edge_of_the_photo_cuts_are_measured_inside(tmp_path, position, target, least):
    pose = Pose.looking_at(position, target)
    edges = find_edges(photograph(tmp_path / "close.jpg", pose, lens=CLOSE), SHEET)
    assert len(edges.corners) >= least and not edges.trimmed
    points = np.column_stack((edges.plane, np.zeros(len(edges.plane))))
    off = ((edges.pixels - project(CLOSE, pose, points)) * edges.across).sum(axis=1)
    # Seen: RMS 0.03, corners beyond the edge 0.5.
    assert np.sqrt(np.square(off).mean()) < 0.06 and abs(off.mean()) < 0.01
    for number, four in edges.corners.items():
        assert np.abs(four - project(CLOSE, pose, SHEET.corners[number])).max() < 1.0


@pytest.mark.parametrize("around", [pytest.param(0, marks=pytest.mark.slow), 20])
def test_a_sheet_cut_at_its_tags_on_a_dark_material(tmp_path, around):
    picture, hole = SHEET.picture(80)
    rim = round(2 * SHEET.cell * 80)
    for dark in (np.s_[:rim], np.s_[-rim:], np.s_[:, :rim], np.s_[:, -rim:], hole):
        picture[dark] = around
    pose = POSES[1]
    edges = find_edges(photograph(tmp_path / "cut.jpg", pose, picture=picture), SHEET)
    assert len(edges.corners) == 16 and edges.trimmed
    for number, four in edges.corners.items():
        assert np.abs(four - project(LENS, pose, SHEET.corners[number])).max() < 0.3


@pytest.mark.slow
def test_a_mirrored_photo_and_a_print_in_negative_are_named(tmp_path):
    photo = photograph(tmp_path / "mirrored.png", POSES[1])
    cv2.imwrite(str(photo.path), cv2.flip(cv2.imread(str(photo.path), cv2.IMREAD_UNCHANGED), 1))
    negative = photograph(tmp_path / "negative.jpg", POSES[0],
                          picture=on_grey(255 - SHEET.picture(80)[0], SHEET.picture(80)[1]))
    for shown, word in ((photo, "mirrored: 16 of 16"), (negative, "negative: 16 of 16")):
        edges = find_edges(shown, SHEET)
        assert not edges.corners and word in edges.fault


@pytest.mark.slow
def test_real_photos_rectified_to_the_frame_of_tags(data_folder):
    """All 16 tags touch the pictures' edge. That is where they are; where cameras were is not known."""
    folder = data_folder / "sheets" / "bath_tile"
    if not folder.is_dir():
        pytest.skip(f"needs the photos of a sheet: none at {folder}")
    photos = [Photo.open(path) for path in sorted(folder.glob("*.jpg"))]
    assert len(photos) == 9
    edges = [find_edges(photo, SHEET) for photo in photos]
    assert all(len(each.corners) == 16 for each in edges)
    rig = rig_from_sheet(photos, 17.0)
    assert set(rig.tags.values()) == {16} and len(rig.tags) == 9
    assert rig.source == "none" and rig.size == pytest.approx(0.64 * 17)
    assert max(rig.errors.values()) < 1.2  # pixels; of the nine 0.92 to 1.07
    patch = np.array([(-1, 1, 0), (1, 1, 0), (1, -1, 0), (-1, -1, 0)]) * rig.size / 2
    for each, pose in zip(edges, rig.poses.values()):  # the homography of OpenCV leaves 1.5 to 1.7 pixels RMS
        printed = np.concatenate([SHEET.corners[number][:, :2] for number in each.corners]) * 17 / SHEET.size
        flat, _ = cv2.findHomography(printed, np.concatenate(list(each.corners.values())))
        other = cv2.perspectiveTransform(patch[None, :, :2], flat)[0]
        assert np.abs(project(rig.lens, pose, patch) - other).max() < 1.5  # seen: 0.8
