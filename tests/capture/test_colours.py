"""Captures say what they converted, and leave out what a mask hides."""

import contextlib
import json

import cv2
import numpy as np
import pytest
import torch
from helpers.colour_files import save_in
from helpers.stated_captures import json_capture, text_capture

from mitsvbrdf.capture import read_capture, write_capture
from mitsvbrdf.capture.capture import Converted, converted
from mitsvbrdf.errors import CaptureError, InputWarning
from mitsvbrdf.io.colour_profile import Profile

SHOWN = np.random.default_rng(0).uniform(0.2, 0.8, (16, 16, 3))


def test_profiles_of_one_name_are_counted_together():
    stated = {"a": Profile("P3", b"1"), "b": Profile("P3", b"2"), "c": None}
    assert converted(stated, {"a": 0.0, "b": 0.5, "c": 0.0}) == {"P3": Converted(2, 0.25)}


def test_what_was_converted_is_told_once_and_kept(tmp_path):
    json_capture(tmp_path / "a", np.zeros((3, 16, 16, 3), np.uint8))
    for path in (tmp_path / "a").rglob("0*.png"):
        save_in(path, SHOWN, "Display P3", 16)
    capture = read_capture(tmp_path / "a")
    assert capture.photos.numpy() == pytest.approx(np.stack([SHOWN] * 3), abs=0.2 / 255)
    (note,) = capture.notes
    assert "3 photos" in note and "0.00%" in note and capture.transfer == "srgb"  # none is stated
    text_capture(tmp_path / "c", images=np.zeros((3, 16, 16, 3), np.uint8))
    save_in(tmp_path / "c/00.png", SHOWN, "Display P3", 16)
    assert read_capture(tmp_path / "c").transfer == "srgb"
    write_capture(capture, tmp_path / "b")
    (found,) = json.loads((tmp_path / "b" / "capture.json").read_text())["colours"].values()
    assert found == {"photos": 3, "outside": 0.0}
    assert read_capture(tmp_path / "b").notes == (note,)
    # values that were converted by their profile are those of sRGB, whatever is said of them
    assert read_capture(tmp_path / "a", transfer="linear").transfer == "srgb"
    assert read_capture(tmp_path / "a", transfer="gamma2.2").transfer == "gamma2.2"


def test_a_plain_photo_in_other_colours(tmp_path):
    save_in(tmp_path / "a.jpg", SHOWN, "ProPhoto")
    assert "sRGB" in read_capture(tmp_path).notes[0]


def test_numbered_photos_of_heic(tmp_path):
    pytest.importorskip("pillow_heif", reason='needs pip install "mitsvbrdf[heic]"')
    json_capture(tmp_path, np.zeros((3, 16, 16, 3), np.uint8))
    shown = np.full((64, 64, 3), (0.8, 0.5, 0.2))
    for path in tmp_path.rglob("0*.png"):
        save_in(path.with_suffix(".heic"), shown, "Display P3")
        path.unlink()
    capture = read_capture(tmp_path)
    assert len(capture) == 3 and capture.photos.numpy() == pytest.approx(np.stack([shown] * 3), abs=2 / 255)


def test_a_profile_that_cannot_be_used_is_told_once(tmp_path):
    from PIL import Image

    text_capture(tmp_path, images=np.zeros((3, 16, 16, 3), np.uint8))
    for path in tmp_path.glob("0*.png"):
        Image.fromarray((SHOWN * 255).astype(np.uint8)).save(path, icc_profile=b"none")
    with pytest.warns(InputWarning, match="00.png and 2 more photos: a damaged ICC profile") as told:
        capture = read_capture(tmp_path)
    assert len(told) == 1 and not capture.colours


@pytest.mark.parametrize("rows, masked, told", [
    (3, [0], None), (3, [0, 1, 2], "18.8% of the patch is masked in all photos"),
    (1, [0, 1, 2], "6.2% of the patch")])
def test_masked_pixels_are_filled_in_and_told(tmp_path, rows, masked, told):
    json_capture(tmp_path, np.full((3, 16, 16, 3), 100, np.uint8))
    for number, path in enumerate(sorted(tmp_path.rglob("0*.png"))):
        pixels = np.full((16, 16, 4), (60, 80, 100, 255), np.uint8)  # BGR
        if number in masked:
            pixels[:rows] = 0
        cv2.imwrite(str(path), pixels)
    for resolution in (None, 8):
        with pytest.warns(InputWarning, match="made up") if told else contextlib.nullcontext() as said:
            capture = read_capture(tmp_path, resolution=resolution)
        assert not told or resolution or told in str(said[0].message)
        assert np.abs(capture.photos.numpy() - np.array([100, 80, 60]) / 255).max() < 1e-6
        hidden = ~capture.measured.numpy()
        lines = rows if resolution is None else -(-rows // 2)  # an average with a masked pixel is masked
        assert hidden[masked, :lines].all() and hidden.sum() == len(masked) * lines * hidden.shape[2]
    write_capture(capture, tmp_path / "again")
    with pytest.warns(InputWarning, match="made up") if told else contextlib.nullcontext():
        again = read_capture(tmp_path / "again")
    assert torch.equal(again.measured, capture.measured)
    assert np.abs((again.photos - capture.photos).numpy()).max() < 1e-6
    cv2.imwrite(str(path), np.kron(np.ones((8, 8, 1)), [[[1] * 4, [0] * 4]] * 2) * 255)  # of each average
    for place, index in ((tmp_path, [0, 2]), (path, None)):  # asked for, and alone
        with pytest.raises(CaptureError, match="photo 0[02] of .* masked whole"):
            read_capture(place, 8, index)
    assert (again := read_capture(tmp_path, 8)).index == (0, 1) and "02 of" in again.notes[-1]
