"""Pictures in files become tensors, and what is no flat picture is refused by name."""

from __future__ import annotations

import os

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from helpers.averages import area_means
from PIL import Image

from mitsvbrdf.errors import CaptureError, MapsError
from mitsvbrdf.io import images
from mitsvbrdf.io.images import averaged, read_image


def test_16_bits_are_read_as_they_are(tmp_path):
    values = np.array([[0, 1, 256, 65535]], np.uint16)
    Image.fromarray(values).save(tmp_path / "x.png")
    found = read_image(tmp_path / "x.png", CaptureError)[..., 0].numpy() * 65535
    assert found == pytest.approx(values, abs=0.01)


def test_a_full_disk_has_its_number_where_openexr_meets_it(tmp_path, monkeypatch):
    import errno

    from mitsvbrdf.errors import OutputError

    class Full:
        def __init__(self, *_):
            pass

        def write(self, name):
            raise RuntimeError("cannot write")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(OpenEXR, "File", Full)
    with pytest.raises(OutputError, match="cannot write"):
        images.write_exr(tmp_path / "x.exr", torch.zeros(2, 2, 3))
    monkeypatch.setattr(images.Path, "write_bytes", full)
    with pytest.raises(OutputError) as found:
        images.write_exr(tmp_path / "x.exr", torch.zeros(2, 2, 3))
    assert found.value.__context__.errno == errno.ENOSPC and not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("size, side", [(96, 32), (100, 64), (97, 32), (90, 40), (64, 64), (48, 1), (65, 64)])
def test_photos_shrink_in_bands_to_the_same_bits(size, side, kind, monkeypatch):
    pixels = np.random.default_rng(size).integers(0, np.iinfo(kind).max, (size, size, 3), kind, endpoint=True)
    whole = pixels.astype(np.float32) / np.float32(np.iinfo(kind).max)
    at_once = cv2.resize(whole, (side, side), interpolation=cv2.INTER_AREA) if side < size else whole
    assert np.abs(at_once - area_means(pixels, side)).max() < 3e-6  # float32 sums
    for band in (1, 40 * size, 2**22):
        monkeypatch.setattr(images, "BAND", band)
        assert np.array_equal(averaged(pixels, side), at_once)


def exr(path, **options):
    OpenEXR.File({"type": OpenEXR.scanlineimage} | options,
                 {"RGB": np.zeros((4, 6, 3), np.float32)}).write(str(path))


def test_an_exr_that_is_no_flat_picture_is_refused(tmp_path):
    part = {"RGB": np.zeros((4, 6, 3), np.float32)}
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage, "name": name}, dict(part), name) for name in "ab"]
    OpenEXR.File(parts).write(str(tmp_path / "parts.exr"))
    deep = np.empty((4, 6), dtype=object)
    for place in np.ndindex(4, 6):
        deep[place] = np.ones(2, np.float32)
    about = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    OpenEXR.File(about, {"R": deep, "G": deep, "B": deep}).write(str(tmp_path / "deep.exr"))
    (tmp_path / "text.exr").write_text("no picture")
    os.mkfifo(tmp_path / "pipe.exr")
    for name, word in {"parts": "of 2 parts", "deep": "deepscanline", "text": "readable EXR",
                       "pipe": "no file at"}.items():
        with pytest.raises(MapsError, match=f"{word}.*" if name == "text"
                           else f"{name}.exr.*{word}|{word}.*{name}.exr"):
            read_image(tmp_path / f"{name}.exr", MapsError)


def test_an_exr_of_absurd_size_is_refused_by_its_header(tmp_path):
    exr(tmp_path / "x.exr")
    data = (tmp_path / "x.exr").read_bytes()
    begin = data.index(b"dataWindow\0box2i\0") + 18 + 4
    wide = (data[:begin + 8] + (2**20).to_bytes(4, "little") + (2**20).to_bytes(4, "little")
            + data[begin + 16:])
    (tmp_path / "x.exr").write_bytes(wide)
    with pytest.raises(MapsError, match="at most 250 megapixels|readable EXR"):
        read_image(tmp_path / "x.exr", MapsError)
