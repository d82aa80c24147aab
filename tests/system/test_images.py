"""Pictures that end early, are damaged or absurdly large are refused by name before anything is made of them."""

from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from mitsvbrdf.errors import CaptureError
from mitsvbrdf.system import images
from mitsvbrdf.system.images import check_whole, read_image

PIXELS = (np.random.default_rng(0).random((64, 48, 3)) * 255).astype(np.uint8)


def encoded(kind, pixels=PIXELS, **options):
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, kind, **options)
    return data.getvalue()


def png_header(width, height):
    """A PNG that ends after its header and the begin of its pixels."""
    def chunk(name, content):
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b""))


def check(tmp_path, data):
    path = tmp_path / "photo"  # what it is stands in its content
    path.write_bytes(data)
    check_whole(path, CaptureError)


@pytest.mark.parametrize("data", [
    encoded("JPEG"), encoded("JPEG", quality=30, progressive=True), encoded("JPEG", PIXELS[..., 0]),
    encoded("JPEG", PIXELS[:1, :1]), encoded("JPEG", PIXELS[:7, :40]), encoded("PNG"), encoded("PNG", PIXELS[:1, :1]),
    encoded("PNG", PIXELS.astype(np.uint16)[..., 0] * 256), encoded("JPEG") + b"what phones write behind a picture" * 50])
def test_whole_pictures_pass(tmp_path, data):
    check(tmp_path, data)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9])
@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_a_picture_that_ends_early_is_refused_by_name(tmp_path, kind, share):
    data = encoded(kind)
    with pytest.raises(CaptureError, match=f"a whole PNG or JPEG, got {tmp_path}/photo"):
        check(tmp_path, data[:int(share * len(data))])


def test_a_png_with_a_wrong_checksum_is_refused(tmp_path):
    data = bytearray(encoded("PNG"))
    data[len(data) // 2] ^= 1
    with pytest.raises(CaptureError, match="a whole PNG"):
        check(tmp_path, bytes(data))


def test_what_is_no_picture_is_refused(tmp_path):
    for data in (b"<html>404</html>", encoded("BMP"), bytes(1000)):
        with pytest.raises(CaptureError, match="a whole PNG or JPEG"):
            check(tmp_path, data)


@pytest.mark.parametrize("size, passes", [((15_811, 15_811), True), ((25_000, 10_000), True), ((25_000, 10_001), False),
                                          ((2**31 - 1, 2**31 - 1), False)])
def test_more_pixels_than_any_camera_has_are_refused_by_the_header(tmp_path, size, passes):
    data = png_header(*size)
    if passes:
        return check(tmp_path, data)
    with pytest.raises(CaptureError, match=f"at most 250 megapixels, got .* of {size[0]} x {size[1]} pixels"):
        check(tmp_path, data)


def test_the_limit_of_pillow_stays_as_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 12345)
    check(tmp_path, encoded("PNG"))
    with pytest.raises(CaptureError):
        check(tmp_path, b"")
    assert Image.MAX_IMAGE_PIXELS == 12345


@pytest.mark.parametrize("kind", ["png", "jpg"])
def test_damage_that_opencv_only_prints_is_an_error_of_reading(tmp_path, kind):
    data = encoded("JPEG" if kind == "jpg" else "PNG")
    (tmp_path / f"x.{kind}").write_bytes(data[:len(data) // 2])
    with pytest.raises(CaptureError, match="a whole PNG or JPEG"):
        read_image(tmp_path / f"x.{kind}", CaptureError)


def test_16_bits_are_read_as_they_are(tmp_path):
    values = np.array([[0, 1, 256, 65535]], np.uint16)
    Image.fromarray(values).save(tmp_path / "x.png")
    assert read_image(tmp_path / "x.png", CaptureError)[..., 0].numpy() * 65535 == pytest.approx(values, abs=0.01)


def test_a_full_disk_has_its_number_where_openexr_meets_it(tmp_path, monkeypatch):
    import errno

    import OpenEXR
    import torch

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
