"""Photos that are cut short, damaged or too large are named; whole ones are read as others read them."""

import io
import os
import struct
import subprocess
import sys
import warnings
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps

from mitsvbrdf.errors import CaptureError, InputWarning, MitsvbrdfError, strict
from mitsvbrdf.io.decode import header, picture, upright

PIXELS = (np.random.default_rng(0).random((64, 48, 3)) * 255).astype(np.uint8)


def decoded(path, error):
    return picture(path, error).pixels


def encoded(kind, pixels=PIXELS, orientation=1, **options):
    data, exif = io.BytesIO(), Image.Exif()
    exif[0x0112] = orientation
    pixels = pixels if isinstance(pixels, Image.Image) else Image.fromarray(pixels)
    pixels.save(data, kind, exif=exif, **options)
    return data.getvalue()


def png_header(width, height):
    """A PNG that ends after its header and the begin of its pixels."""
    def chunk(name, content):
        return (struct.pack(">I", len(content)) + name + content
                + struct.pack(">I", zlib.crc32(name + content)))

    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b""))


def read(tmp_path, data):
    path = tmp_path / "photo"  # what it is stands in its content
    path.write_bytes(data)
    return decoded(path, CaptureError)


WHOLE = {"jpeg": encoded("JPEG"), "progressive": encoded("JPEG", quality=30, progressive=True),
         "grey": encoded("JPEG", PIXELS[..., 0]), "colour in full": encoded("JPEG", subsampling=0),
         "one pixel": encoded("JPEG", PIXELS[:1, :1]), "odd": encoded("JPEG", PIXELS[:7, :41]),
         "png": encoded("PNG"), "png of one pixel": encoded("PNG", PIXELS[:1, :1]),
         "alpha": encoded("PNG", np.dstack((PIXELS, PIXELS[..., 0]))),
         "grey png": encoded("PNG", PIXELS[..., 0]),
         "palette": encoded("PNG", Image.fromarray(PIXELS).quantize(256)),
         "16 bits": encoded("PNG", PIXELS.astype(np.uint16)[..., 0] * 256),
         "16 bits of colour": cv2.imencode(".png", PIXELS * np.uint16(257) + np.uint16(3))[1].tobytes(),
         "more behind": encoded("JPEG") + b"what phones write behind a picture" * 50}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", WHOLE)
def test_whole_pictures_are_read_as_opencv_reads_them(kind, tmp_path):
    pixels = read(tmp_path, WHOLE[kind])
    other = cv2.imdecode(np.frombuffer(WHOLE[kind], np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    assert pixels.dtype == other.dtype and np.array_equal(pixels, other[..., ::-1])


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_the_header_alone(kind, tmp_path):
    (tmp_path / "photo").write_bytes(encoded(kind, orientation=6)[:900])
    assert header(tmp_path / "photo", CaptureError) == (kind, (48, 64), 6, "RGB", None, 8, False)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_turned_as_pillow_turns_them(orientation):
    turned = ImageOps.exif_transpose(Image.open(io.BytesIO(encoded("PNG", orientation=orientation))))
    assert np.array_equal(upright(PIXELS, orientation), np.asarray(turned))


@pytest.mark.parametrize("orientation", [2, 3, 6])
@pytest.mark.parametrize("mode", ["P", "1"])
def test_a_tiff_that_pillow_decodes_is_turned_once(mode, orientation, tmp_path):
    picture = Image.fromarray(PIXELS).quantize(16) if mode == "P" else Image.fromarray(PIXELS).convert("1")
    found = read(tmp_path, encoded("TIFF", picture, orientation))
    about = header(tmp_path / "photo", CaptureError)
    assert np.array_equal(upright(found, about.orientation),
                          upright(np.asarray(picture.convert("RGB")), orientation))
    assert about.size == found.shape[1::-1]


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9])
@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_a_picture_that_ends_early_is_refused_by_name(tmp_path, kind, share):
    data = encoded(kind)
    with pytest.raises(CaptureError, match=f"a whole PNG, .*, got {tmp_path}/photo"):
        read(tmp_path, data[:int(share * len(data))])


def test_a_png_with_a_wrong_checksum_is_refused(tmp_path):
    data = bytearray(encoded("PNG"))
    data[len(data) // 2] ^= 1
    with pytest.raises(CaptureError, match="a whole PNG"):
        read(tmp_path, bytes(data))


def test_what_is_no_picture_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # opening it would wait for ever
    for data in (b"<html>404</html>", encoded("BMP"), bytes(1000)):
        with pytest.raises(CaptureError, match="a whole PNG"):
            read(tmp_path, data)
    for path in (tmp_path / "pipe", tmp_path, tmp_path / "none"):
        with pytest.raises(CaptureError, match=f"no file at {path}"):
            decoded(path, CaptureError)


def flipped(count):
    """JPEGs with one bit turned over in what follows the header."""
    data = encoded("JPEG", quality=80)
    begin = data.index(b"\xff\xda") + 14
    for place in np.random.default_rng(0).integers(8 * begin, 8 * (len(data) - 2), count):
        wrong = bytearray(data)
        wrong[place // 8] ^= 1 << place % 8
        yield bytes(wrong)


def heard_by_opencv(folder):
    """For each file by its name, what OpenCV's decoder prints, in a process of its own."""
    code = """
import os, sys, cv2
for name in sorted(os.listdir(sys.argv[1])):
    os.write(2, f"\\nfile {name}\\n".encode())
    cv2.imread(os.path.join(sys.argv[1], name))
"""
    printed = subprocess.run([sys.executable, "-c", code, folder], capture_output=True, text=True,
                             check=True).stderr
    return {part.split("\n")[0]: "Corrupt JPEG" in part or "Premature end" in part
            for part in printed.split("\nfile ")[1:]}


def test_a_decoder_that_complains_is_heard(tmp_path):
    for number, data in enumerate(flipped(40)):
        (tmp_path / f"{number:02d}").write_bytes(data)
    complained = heard_by_opencv(tmp_path)
    assert 5 < sum(complained.values()) < 40  # else this tests nothing
    for name, loud in complained.items():
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            try:
                decoded(tmp_path / name, CaptureError)
            except CaptureError as error:
                heard.append(error)
        assert bool(heard) == loud, name
        assert all(str(tmp_path / name) in str(getattr(each, "message", each)) for each in heard)
        if loud:
            with pytest.raises(MitsvbrdfError, match=f"{tmp_path / name}"), strict():
                decoded(tmp_path / name, CaptureError)


def test_what_is_read_of_a_damaged_picture_is_what_opencv_reads(tmp_path):
    for data in flipped(10):
        with warnings.catch_warnings(action="ignore", category=InputWarning):
            try:
                pixels = read(tmp_path, data)
            except CaptureError:
                continue
        other = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert np.array_equal(pixels, other[..., ::-1])


@pytest.mark.parametrize("size, passes", [((15_811, 15_811), True), ((25_000, 10_000), True),
                                          ((25_000, 10_001), False), ((2**31 - 1, 2**31 - 1), False)])
def test_more_pixels_than_any_camera_has_are_refused_by_the_header(tmp_path, size, passes):
    (tmp_path / "photo").write_bytes(png_header(*size))
    if passes:
        assert header(tmp_path / "photo", CaptureError).size == size
        return
    with pytest.raises(CaptureError, match=f"at most 250 megapixels, got .* of {size[0]} x {size[1]} pixels"):
        header(tmp_path / "photo", CaptureError)


def test_the_limit_of_pillow_stays_as_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 12345)
    read(tmp_path, encoded("PNG"))
    with pytest.raises(CaptureError):
        read(tmp_path, b"")
    assert Image.MAX_IMAGE_PIXELS == 12345


# written by Pillow; ImageMagick 6.9 reads the same values
@pytest.mark.parametrize("mode, tags, value, options", [
    ("P", {}, (204, 51, 51), {}), ("1", {}, (255,) * 3, {}), ("1", {}, (255,) * 3, {"compression": "group4"}),
    ("L", {262: 0}, (60,) * 3, {}), ("LA", {}, (60,) * 3, {})])
def test_tiffs_that_store_no_plain_numbers(tmp_path, mode, tags, value, options):
    colour = value if mode == "P" else value[0]
    image = Image.new("RGB" if mode == "P" else "L", (16, 16), colour).convert(mode)
    image.save(tmp_path / "a.tif", tiffinfo=tags, **options)
    assert (decoded(tmp_path / "a.tif", CaptureError) == value).all()


@pytest.mark.parametrize("bits, stored, values", [  # 15, 1023 and 4095 are white
    (4, "09 9F F9 90", [[0, 153, 153, 255], [255, 153, 153, 0]]),
    (10, "00 26 69 9B FF FF E6 69 98 00", [[0, 39334, 39334, 65535], [65535, 39334, 39334, 0]]),
    (12, "00 09 99 99 9F FF FF F9 99 99 90 00", [[0, 39321, 39321, 65535], [65535, 39321, 39321, 0]])])
def test_grey_tiffs_of_other_bits(tmp_path, bits, stored, values):
    entries = [(256, 4, 1, 4), (257, 4, 1, 2), (258, 3, 1, bits), (259, 3, 1, 1), (262, 3, 1, 1),
               (273, 4, 1, 200), (277, 3, 1, 1), (278, 4, 1, 2), (279, 4, 1, bits)]
    table = b"".join(struct.pack("<HHII", *entry) for entry in entries)
    head = b"II*\0" + struct.pack("<IH", 8, len(entries)) + table + bytes(4)
    assert read(tmp_path, head.ljust(200, b"\0") + bytes.fromhex(stored))[..., 0].tolist() == values


@pytest.mark.parametrize("name", ["a.jpg", "a.tif"])
@pytest.mark.parametrize("profile", [None, b"of some printer"])
def test_inks_are_refused_by_name(tmp_path, name, profile):
    Image.new("CMYK", (16, 16), (30, 180, 200, 40)).save(tmp_path / name, icc_profile=profile)
    with pytest.raises(CaptureError, match=f"a picture in RGB or grey, got .*/{name} in CMYK; convert"):
        decoded(tmp_path / name, CaptureError)


@pytest.mark.parametrize("mode, bits", [("RGB;16", 10), ("RGB;16", 12), ("L;16", 10), ("RGBA;16", 10)])
def test_heic_keeps_the_bits_it_has(tmp_path, mode, bits, monkeypatch):
    heif = pytest.importorskip("pillow_heif", reason='needs pip install "mitsvbrdf[heic]"')
    monkeypatch.setattr(heif.options, "SAVE_HDR_TO_12_BIT", bits == 12)
    ramp = np.linspace(0, 65535, 1024).astype(np.uint16)[None, :, None].repeat(64, axis=0)
    pixels = ramp.repeat({"L": 1, "RGB": 3, "RGBA": 4}[mode[:-3]], axis=2)
    if mode == "RGBA;16":
        pixels[..., 3] = 65535
    heif.from_bytes(mode, (1024, 64), pixels.tobytes()).save(tmp_path / "a.heic", quality=-1, chroma=444)
    found = decoded(tmp_path / "a.heic", CaptureError)
    assert found.dtype == np.uint16 and found.shape == (64, 1024, 3) and len(np.unique(found[..., 1])) > 1000
    assert np.abs(found.astype(int) - ramp).max() <= 2 * 65535 / (2**bits - 1) and found.max() == 65535


def test_heic_of_tiles_that_ends_early_is_refused(tmp_path):
    heif = pytest.importorskip("pillow_heif", reason='needs pip install "mitsvbrdf[heic]"')
    noise = Image.fromarray(np.random.default_rng(0).integers(0, 255, (256, 256, 3), dtype=np.uint8))
    heif.from_pillow(noise).save(tmp_path / "a.heic", quality=90, tile_size=64)
    whole = (tmp_path / "a.heic").read_bytes()
    assert decoded(tmp_path / "a.heic", CaptureError).shape == (256, 256, 3)
    # a phone writes more behind its photo, be it a box or not
    assert read(tmp_path, whole + b"\0\0\0\x09sefd1" + b"\0\1\0\x09SEFH").shape == (256, 256, 3)
    for share in (0.999, 0.9, 0.5, 0.1):
        with pytest.raises(CaptureError, match="HEIC file, got .*: it ends early; copy"):
            read(tmp_path, whole[:int(len(whole) * share)])
