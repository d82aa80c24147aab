"""Photos of a calibrated capture are read one at a time, to the same bits as all at once; damage is named."""

import shutil
import tracemalloc
import warnings
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from helpers.averages import area_means
from helpers.made_photos import LENS, poses
from helpers.stated_captures import json_capture, photos, save, text_capture

from mitsvbrdf.capture import read_capture
from mitsvbrdf.capture.photo import Photo
from mitsvbrdf.capture.rectify import Rectified
from mitsvbrdf.capture.rig import Rig
from mitsvbrdf.errors import ConfigError, InputWarning, MitsvbrdfError, noted, strict


@pytest.mark.parametrize("make", [json_capture, text_capture])
@pytest.mark.parametrize("side", [24, 23, 16])
def test_photos_in_turn_are_what_photos_all_at_once_would_be(make, side, tmp_path):
    images = photos(3, 48)
    found = read_capture(make(tmp_path, images), resolution=side).photos.numpy()
    stacked = [cv2.resize(image.astype(np.float32) / np.float32(255), (side, side),
                          interpolation=cv2.INTER_AREA) for image in images]
    assert np.array_equal(found, stacked)
    # float32 sums of nine at most
    assert np.abs(found - [area_means(image, side) for image in images]).max() < 1e-6


def test_one_photo_at_a_time_is_in_memory(tmp_path):
    large = np.zeros((6, 1600, 1600, 3), np.uint8)  # the middles, of 512 px, are small beside them
    json_capture(tmp_path, large, idx=list(range(6)), camera_pos=[[0, 0, 17.0]] * 6, light_pos=...)
    read_capture(tmp_path, resolution=16)
    tracemalloc.start()
    try:
        read_capture(tmp_path, resolution=16)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    one = large[0].size
    assert peak < 1.5 * (one + 4 * one)  # as stored, and as float32; six would be 24 times that of one


def test_photos_kept_together_have_a_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("mitsvbrdf.capture.capture.MOST_HELD", 3 * 8 * 8)
    json_capture(tmp_path)
    assert read_capture(tmp_path, resolution=8).resolution == 8
    with pytest.raises(ConfigError, match=f"megapixels together, .* in {tmp_path}; read them at a lower "
                                           "resolution"):
        read_capture(tmp_path, resolution=9)
    monkeypatch.setattr("mitsvbrdf.capture.capture.MOST_HELD", 7 * 7)
    rig = Rig(LENS, poses(), 11.52, "cm", "sheet")  # of raw photos, before one is read
    for read in (lambda: read_capture(tmp_path / "target/00.png"), lambda: Rectified.of(
            rig, [Photo(tmp_path / name, LENS.size) for name in rig.poses], 1024, lambda text, share: None)):
        with pytest.raises(ConfigError, match="megapixels together"):
            read()


def test_a_damaged_photo_is_named_and_refused_when_strict(tmp_path):
    text_capture(tmp_path, images=photos()[:0])
    save(tmp_path, photos(side=64), ".jpg")
    data = (tmp_path / "01.jpg").read_bytes()
    (tmp_path / "01.jpg").write_bytes(data[: 2 * len(data) // 3] + b"\xff\xd9")  # too little before its end
    for _ in range(2):  # said each time, and kept, without the path
        with pytest.warns(InputWarning, match="01.jpg is damaged"):
            found = read_capture(tmp_path)
        assert len(found) == 3 and [note.split(" (")[0] for note in found.notes] == ["01.jpg is damaged"]
    with pytest.raises(MitsvbrdfError, match="01.jpg is damaged"), strict():
        read_capture(tmp_path)
    (tmp_path / "plain").mkdir()
    (tmp_path / "01.jpg").rename(tmp_path / "plain/a.jpg")
    with pytest.warns(InputWarning, match="a.jpg is damaged"):
        assert any(note.startswith("a.jpg is damaged") for note in read_capture(tmp_path / "plain").notes)


def test_notes_are_of_the_capture_that_a_thread_reads(tmp_path, monkeypatch):
    good, bad = (json_capture(tmp_path / name) for name in ("good", "bad"))
    shutil.copy(bad / "target/00.png", bad / "target/08 (1).png")
    with warnings.catch_warnings(action="ignore"), ThreadPoolExecutor(2) as pool:
        found = list(pool.map(lambda folder: (folder, read_capture(folder).notes), [good, bad] * 10))
    assert all(len(notes) == (folder == bad) for folder, notes in found)
    monkeypatch.chdir(bad)
    with pytest.warns(InputWarning), noted() as outside:
        named, = read_capture(".").notes
    assert outside == [named]
    assert named.startswith("target holds photos that are not read: 08 (1).png;")


def test_photos_without_a_number_are_named(tmp_path):
    json_capture(tmp_path)
    shutil.copy(tmp_path / "target/00.png", tmp_path / "target/08 (1).png")
    with pytest.warns(InputWarning, match=r"photos that are not read: 08 \(1\).png"):
        assert len(read_capture(tmp_path)) == 3
