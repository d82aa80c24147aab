"""The rig found from photos of the sheet."""

import numpy as np
import pytest
from helpers.tag_sheet import LENS, MIDDLES, POSES, SHEET, on_grey, photograph

from mitsvbrdf.capture.align.from_sheet import rig_from_sheet
from mitsvbrdf.capture.lens import Pose, on_plane, project
from mitsvbrdf.errors import CaptureError
from mitsvbrdf.views import texel_positions


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


def test_a_rig_from_photos(photos):
    told = []
    rig = rig_from_sheet(photos, 18.0, report=lambda text, share: told.append((text, share)))
    assert (rig.unit, rig.source, rig.size, rig.rejected, rig.notes) == ("cm", "sheet", SHEET.patch, {}, ())
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
    # Cells of three pixels, whose white bleeds into the black: 0.06 % and 0.15 texels were seen; half a pixel
    # is 0.9 texels.
    check(rig_from_sheet(photos, 18.0), {photo.name: pose for photo, pose in zip(photos, POSES)},
          position=0.002, texels=0.4)


@pytest.mark.slow
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
        part = slice(round(y - scale * 1.1), round(y + scale * 1.1)), slice(round(x - scale * 1.1),
                                                                            round(x + scale * 1.1))
        kept[part] = picture[part]
    return kept


@pytest.mark.slow
def test_photos_that_do_not_help_are_named(tmp_path, photos):
    row = photograph(tmp_path / "row.jpg", POSES[0], picture=covered([0, 1, 2, 3, 4]))
    three = photograph(tmp_path / "three.jpg", POSES[0], picture=covered([0, 4, 8]))
    empty = photograph(tmp_path / "empty.jpg", POSES[0], picture=covered([]))
    four = photograph(tmp_path / "four.jpg", POSES[2], picture=covered([0, 4, 8, 13]))
    bent = SHEET.picture(80)[0]
    bent[:, 1000:] = np.roll(bent, 24, axis=0)[:, 1000:]  # its right side is 3 mm lower
    bent = photograph(tmp_path / "bent.jpg", POSES[1], picture=bent)
    rig = rig_from_sheet([row, *photos, three, bent, empty, four], 18.0)
    assert set(rig.poses) == {*(photo.name for photo in photos), "four.jpg"}
    assert rig.rejected["three.jpg"] == "3 of 16 tags seen, 4 needed"
    assert rig.rejected["empty.jpg"] == "none of 16 tags seen, 4 needed"
    assert rig.rejected["row.jpg"] == "5 of 16 tags seen, all in one line"
    assert "where a flat sheet would have them" in rig.rejected["bent.jpg"]
    poses = {photo.name: pose for photo, pose in zip(photos, POSES)}
    check(rig, poses | {"four.jpg": POSES[2]})


@pytest.mark.slow
def test_a_sheet_that_is_bent_in_all_photos_is_noted(tmp_path):
    bent = on_grey(*SHEET.picture(80))
    bent[:, 1000:] = np.roll(bent, 24, axis=0)[:, 1000:]  # its right side is 3 mm lower
    rig = rig_from_sheet([photograph(tmp_path / f"{i}.jpg", pose, picture=bent)
                          for i, pose in enumerate(POSES[:3])], 18.0)
    assert any("beside where those of a flat sheet would be" in note for note in rig.notes)


def test_too_few_photos(tmp_path, photos):
    empty = photograph(tmp_path / "empty.jpg", POSES[0], picture=covered([]))
    with pytest.raises(CaptureError, match="3 photos or more that show the sheet, got 2 of 3; empty.jpg: "
                                           "none of 16"):
        rig_from_sheet([photos[0], empty, photos[1]], 18.0)


def test_photos_from_straight_above_leave_the_focal_length_to_exif(tmp_path):
    """Focal length and height look alike from there: said, and told apart by EXIF as far as it goes."""
    poses = [Pose.looking_at((x, y, z), (x, y, 0), turn)
             for x, y, z, turn in ((0, 0, 33, 0), (0.5, 0, 33, 1.5), (0, 0.5, 33, 3.0))]
    focal = LENS.focal * np.hypot(36, 24) / np.hypot(*LENS.size) * 1.02  # rounded up by EXIF
    flat = [photograph(tmp_path / f"{i}.jpg", pose, exif=focal, seed=i) for i, pose in enumerate(poses)]
    known = rig_from_sheet(flat, 18.0)
    assert any("focal length is uncertain" in note for note in known.notes)
    for i, pose in enumerate(poses):
        off = np.linalg.norm(known.poses[f"{i}.jpg"].position - pose.position)
        assert off < 0.05 * 33 and off < 3 * known.deviations[f"{i}.jpg"]
    # the rectified photos do not mind
    check(known, {f"{i}.jpg": pose for i, pose in enumerate(poses)}, position=0.05)
