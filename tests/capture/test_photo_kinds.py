"""TIFF files, and the masks of all kinds."""

import cv2
import numpy as np
import pytest
from helpers.colour_files import tiff
from PIL import Image

from mitsvbrdf.capture.photo import Photo
from mitsvbrdf.errors import CaptureError

PICTURE = np.random.default_rng(0).integers(1, 255, (40, 60, 3), np.uint8)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_tiff_of_8_and_16_bits(orientation, tmp_path):
    block = Image.Exif()
    block[0x0112] = orientation
    Image.fromarray(PICTURE).save(tmp_path / "a.tif", compression="tiff_lzw", exif=block)
    photo = Photo.open(tmp_path / "a.tif")
    assert np.array_equal(photo.pixels(), PICTURE)
    assert (photo.size, photo.orientation) == ((60, 40), orientation)
    wide = PICTURE.astype(np.uint16) * 257 + 3
    (tmp_path / "b.tif").write_bytes(tiff(wide, b""))
    assert np.array_equal(Photo.open(tmp_path / "b.tif").pixels(), wide)
    Image.fromarray(PICTURE[..., 0]).save(tmp_path / "c.tif")
    assert np.array_equal(Photo.open(tmp_path / "c.tif").pixels(), np.repeat(PICTURE[..., :1], 3, axis=2))
    cv2.imwrite(str(tmp_path / "d.tif"), PICTURE.astype(np.float32))
    with pytest.raises(CaptureError, match="d.tif"):
        Photo.open(tmp_path / "d.tif").pixels()


@pytest.mark.parametrize("name", ["a.png", "a16.png", "a.webp", "a.tif", "a16.tif"])
def test_masked_pixels_are_told(name, tmp_path):
    alpha = np.full((40, 60), 255, np.uint8)
    alpha[:10] = 0
    pixels = np.dstack((PICTURE, alpha))
    if name == "a16.png":
        cv2.imwrite(str(tmp_path / name), pixels[..., [2, 1, 0, 3]].astype(np.uint16) * 257)
    elif name == "a16.tif":
        (tmp_path / name).write_bytes(tiff(pixels.astype(np.uint16) * 257, b""))
    else:
        Image.fromarray(pixels).save(tmp_path / name, **({"lossless": True} if "webp" in name else {}))
    found = Photo.open(tmp_path / name).read()
    assert np.array_equal(found.opaque, alpha > 0) and not found.pixels[:10].any()
    step = 257 if "16" in name else 1
    assert np.array_equal(found.pixels[10:], PICTURE[10:].astype(int) * step)
