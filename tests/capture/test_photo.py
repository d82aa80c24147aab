"""Photo files: what their headers say, and their pixels as the sensor stored them."""

import struct
import warnings

import cv2
import numpy as np
import pytest
from PIL import Image

from mitsvbrdf.capture.photo import Photo, differences, of_one_camera, photos_in, read_exif
from mitsvbrdf.capture.read import read_capture
from mitsvbrdf.errors import CaptureError, InputWarning
from mitsvbrdf.io.decode import upright


def picture(height=40, width=60):
    """Smooth and different in each corner and channel, 8 bits."""
    corners = np.array([[[250, 10, 20], [20, 240, 30]], [[30, 20, 230], [200, 200, 10]]], dtype=np.uint8)
    return cv2.resize(corners, (width, height), interpolation=cv2.INTER_LINEAR)


def exif(orientation=1, iso=100, exposure=0.01, focal=4.2, focal_35mm=26, balance=1, flash=1,
         model="Phone 1"):
    block = Image.Exif()
    block[0x0112], block[271], block[272] = orientation, "Maker", model
    block.get_ifd(0x8769).update({34855: iso, 33434: exposure, 37386: focal, 41989: focal_35mm,
                                  41987: balance, 37385: flash, 36867: "2024:05:06 07:08:09"})
    return block


def saved(path, pixels=None, **settings):
    Image.fromarray(picture() if pixels is None else pixels).save(path, quality=95, exif=exif(**settings))
    return Photo.open(path)


def test_header(tmp_path):
    photo = saved(tmp_path / "a.jpg", orientation=6, flash=0x19)
    assert (photo.name, photo.size, photo.orientation, photo.linear) == ("a.jpg", (60, 40), 6, False)
    assert photo.exif == {"ISO": 100, "exposure time": pytest.approx(0.01), "camera": "Maker Phone 1",
                          "focal length": pytest.approx(4.2), "35 mm focal length": 26, "flash": "fired",
                          "white balance": "manual", "date": "2024:05:06 07:08:09"}
    assert saved(tmp_path / "b.jpg", flash=0x10).exif["flash"] == "off"  # says the standard
    assert any("with the flash" in note for note in read_capture(tmp_path / "b.jpg").notes)
    # A turned photo is given as the sensor stored it; JPEG at quality 95 changes this picture by 7 steps at
    # most.
    assert np.abs(photo.pixels().astype(int) - picture()).max() <= 8


def test_settings_that_differ_are_named(tmp_path):
    same = [saved(tmp_path / f"{time}.jpg", exposure=time) for time in (0.01, 0.01000000002)]
    assert differences(same) == []
    other = saved(tmp_path / "c.jpg", iso=400, exposure=0.02, focal=2.1, balance=0, flash=0, model="Phone 2")
    found = differences([*same, other])
    assert [line.split(" differs")[0]
            for line in found] == ["ISO", "exposure time", "focal length", "white balance", "flash", "camera"]
    assert found[0].startswith("ISO differs: 100 in 0.01.jpg and others, 400 in c.jpg")
    assert "fired in 0.01.jpg and others, off in c.jpg" in found[4]
    assert "and 3 more" in differences([saved(tmp_path / f"{i}.jpg", iso=100 + i) for i in range(8)])[0]


def test_rubbish_in_exif_costs_no_photo(tmp_path):
    good = saved(tmp_path / "b.jpg", orientation=6, iso=0, focal_35mm=0).path.read_bytes()
    (tmp_path / "a.jpg").write_bytes(good.replace(good[good.index(b"Exif") + 6 :][:16], b"no header at all"))
    photo = Photo.open(tmp_path / "a.jpg")
    assert photo.exif == {} and photo.orientation == 1 and photo.pixels().shape == (40, 60, 3)
    assert not {"ISO", "35 mm focal length"} & read_exif(tmp_path / "b.jpg", "JPEG").keys()  # 0: unknown
    assert saved(tmp_path / "c.jpg", orientation=77).orientation == 1
    assert not {"ISO", "35 mm focal length"} & saved(tmp_path / "d.jpg", iso=65535,
                                                     focal_35mm=65535).exif.keys()
    (tmp_path / "e.jpg").write_bytes(good.replace(b"\x01\x12\x00\x03\x00\x00\x00\x01",
                                                  b"\x01\x12\x00\x03\x00\x00\x00\x02"))
    with warnings.catch_warnings(action="error"):  # two orientations are no concern of the user's
        assert Photo.open(tmp_path / "e.jpg").size == (60, 40)


def test_smaller_pixels_are_block_averages(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), picture(41, 60)[..., ::-1])
    small = Photo.open(tmp_path / "a.png").pixels(most=20)
    blocks = picture(41, 60)[:39].reshape(13, 3, 20, 3, 3).mean(axis=(1, 3))
    assert small.shape == (13, 20, 3) and np.abs(small - blocks).max() <= 0.5 + 1e-6  # rounding


def test_photos_in_a_folder(tmp_path):
    with pytest.raises(CaptureError, match="none in"):
        photos_in(tmp_path)
    (tmp_path / "h.exr").touch()
    with pytest.raises(CaptureError, match="got h.exr in .*; export the photos among them as JPEG"):
        photos_in(tmp_path)
    (tmp_path / "h.exr").unlink()
    names = ["a.png", "b.JPG", "c.heic", "d.jfif", "e.tif", "f.webp", "g.HIF"]
    for name in (*names, ".hidden.jpg", "notes.txt"):
        (tmp_path / name).touch()
    assert [path.name for path in photos_in(tmp_path)] == names
    (tmp_path / "h.exr").touch()
    (tmp_path / "i.MOV").touch()
    with pytest.warns(InputWarning, match="files that are not read: h.exr, i.MOV; export"):
        photos_in(tmp_path)
    (tmp_path / "h.exr").unlink()
    (tmp_path / "i.MOV").unlink()
    (tmp_path / "d.dng").touch()
    with pytest.raises(CaptureError, match="1 RAW files and 7 others"):
        photos_in(tmp_path)
    with pytest.raises(CaptureError, match="no folder"):
        photos_in(tmp_path / "none")


@pytest.mark.parametrize(("name", "extra", "package"),
                         [("a.heic", "heic", "pillow_heif"), ("a.dng", "raw", "rawpy")])
def test_a_missing_extra_is_named(name, extra, package, tmp_path, monkeypatch):
    (tmp_path / name).write_bytes(b"1234ftypheic" if extra == "heic" else b"anything")
    monkeypatch.setitem(__import__("sys").modules, package, None)  # as if it were not installed
    with pytest.raises(CaptureError, match=rf'pip install "mitsvbrdf\[{extra}\]"'):
        Photo.open(tmp_path / name)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_heic_is_given_as_the_sensor_saw_it(orientation, tmp_path):
    heif = pytest.importorskip("pillow_heif", reason='needs pip install "mitsvbrdf[heic]"')
    heif.register_heif_opener()
    shown = np.rot90(picture(), {1: 0, 3: 2, 6: -1, 8: 1}[orientation])  # as the phone shows it
    Image.fromarray(shown).save(tmp_path / "a.heic", quality=95, exif=exif(orientation))
    photo = Photo.open(tmp_path / "a.heic")
    assert photo.orientation == orientation and photo.size == (60, 40) and photo.exif["ISO"] == 100
    # measured: 12; a turned picture: above 200
    assert np.abs(photo.pixels().astype(int) - picture()).max() <= 20
    (tmp_path / "b.heic").write_bytes((tmp_path / "a.heic").read_bytes()[:300])
    with pytest.raises(CaptureError, match="b.heic"):
        Photo.open(tmp_path / "b.heic").pixels()


def test_a_mirrored_heic_is_shown_as_elsewhere(tmp_path):
    pytest.importorskip("pillow_heif", reason='needs pip install "mitsvbrdf[heic]"').register_heif_opener()
    for orientation in (2, 5):
        Image.fromarray(picture()).save(tmp_path / "a.heic", quality=95, exif=exif(orientation))
        photo = Photo.open(tmp_path / "a.heic")
        shown = np.asarray(Image.open(tmp_path / "a.heic"))
        assert np.array_equal(upright(photo.pixels(), photo.orientation), shown)


def dng(path, mosaic, flip=1, white=4000, neutral=(1, 1, 1)):
    """The least of a DNG: one strip of a Bayer mosaic RGGB, 16 bits, plain, with white balance."""
    height, width = mosaic.shape
    # XYZ to linear sRGB
    matrix = [3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570]
    entries = [(254, 4, [0]), (256, 4, [width]), (257, 4, [height]), (258, 3, [16]), (259, 3, [1]),
               (262, 3, [32803]), (271, 2, b"Maker\0"), (272, 2, b"Phone\0"), (273, 4, None),
               (274, 3, [flip]), (277, 3, [1]), (278, 4, [height]), (279, 4, [mosaic.size * 2]),
               (33421, 3, [2, 2]), (33422, 1, bytes([0, 1, 1, 2])), (50706, 1, bytes([1, 4, 0, 0])),
               (50708, 2, b"Maker Phone\0"), (50714, 3, [0]), (50717, 3, [white]),
               (50721, 10, [round(x * 10000) for x in matrix]),
               (50728, 5, [round(x * 10000) for x in neutral]), (50778, 3, [21])]
    start = 8 + 2 + 12 * len(entries) + 4
    table, beyond = b"", b""
    for tag, kind, values in entries:
        if values is None:
            data, count = b"HERE", 1
        elif isinstance(values, bytes):
            data, count = values, len(values)
        elif kind in (5, 10):
            data, count = b"".join(struct.pack("<iI", x, 10000) for x in values), len(values)
        else:
            data, count = struct.pack(f"<{len(values)}{'H' if kind == 3 else 'I'}", *values), len(values)
        if len(data) > 4:
            table += struct.pack("<HHII", tag, kind, count, start + len(beyond))
            beyond += data + b"\0" * (len(data) % 2)
        else:
            table += struct.pack("<HHI", tag, kind, count) + data.ljust(4, b"\0")
    table = table.replace(b"HERE", struct.pack("<I", start + len(beyond)))
    path.write_bytes(b"II*\0" + struct.pack("<IH", 8, len(entries)) + table + struct.pack("<I", 0) + beyond
                     + mosaic.astype("<u2").tobytes())
    return path


def test_raw_is_linear_whatever_else_is_in_the_picture(tmp_path):
    pytest.importorskip("rawpy", reason='needs pip install "mitsvbrdf[raw]"')
    dark = np.full((64, 96), 500)
    half = dark.copy()
    half[:, 48:] = 2000  # automatic brightness would change the left half with it
    one, two = (Photo.open(dng(tmp_path / f"{i}.dng", mosaic)) for i, mosaic in enumerate((dark, half)))
    assert one.linear and one.size == (96, 64) and one.orientation == 1
    low, both = (photo.pixels().astype(float)[8:-8, 8:-8] / 65535 for photo in (one, two))
    assert low.shape[2] == 3 and one.pixels().dtype == np.uint16
    left, right = both[:, :30].mean(axis=(0, 1)), both[:, -30:].mean(axis=(0, 1))
    # Measured: 0.1250 = 500 / 4000 and 4.000 times that; 2 % is room for other versions of LibRaw.
    assert np.allclose(low.mean(axis=(0, 1)), 0.125, rtol=0.02)
    assert np.allclose(left, low.mean(axis=(0, 1)), rtol=0.01) and np.allclose(right / left, 4, rtol=0.01)
    turned = Photo.open(dng(tmp_path / "2.dng", dark, flip=6))
    assert turned.size == (96, 64) and turned.orientation == 6 and turned.pixels().shape == (64, 96, 3)
    (tmp_path / "3.dng").write_bytes(b"II*\0 no raw file")
    with pytest.raises(CaptureError, match="3.dng"):
        Photo.open(tmp_path / "3.dng")


def test_raw_files_share_one_white_balance(tmp_path):
    pytest.importorskip("rawpy", reason='needs pip install "mitsvbrdf[raw]"')
    mosaic = np.full((64, 96), 500)
    photos = [Photo.open(dng(tmp_path / f"{i}.dng", mosaic, neutral=neutral))
              for i, neutral in enumerate([(0.5, 1, 0.6), (0.5, 1, 0.6), (0.4, 1, 0.75)])]
    kept, _, notes = of_one_camera(photos)
    values = [photo.pixels()[32, 48].astype(float) for photo in kept]
    assert np.array_equal(values[0], photos[0].pixels()[32, 48])  # as it was shot
    assert np.array_equal(values[0], values[2])
    # the third by itself: red as much stronger as its own balance says
    assert photos[2].pixels()[32, 48, 0] / values[0][0] == pytest.approx(0.5 / 0.4, rel=1e-3)
    assert any("white balance differs in 1 of 3 RAW files" in note and "0.dng" in note for note in notes)
    assert of_one_camera(photos[:2])[2] == []
    with pytest.raises(CaptureError, match="two of 0.dng"):  # as from two folders
        of_one_camera([*photos, photos[0]])


def test_files_are_what_they_hold_whatever_their_names_are(tmp_path):
    heif = pytest.importorskip("pillow_heif", reason='needs pip install "mitsvbrdf[heic]"')
    pytest.importorskip("rawpy", reason='needs pip install "mitsvbrdf[raw]"')
    heif.register_heif_opener()
    for name, kind in [("a.jpg", "HEIF"), ("b.heic", "JPEG"), ("c.png", "WEBP"), ("d.jfif", "JPEG"),
                       ("e.tif", "TIFF"), ("f.HIF", "HEIF"), ("g.jpg", "PNG"), ("h.dng", "JPEG")]:
        Image.fromarray(picture()).save(tmp_path / name, kind, quality=95, exif=exif())
        photo = Photo.open(tmp_path / name)
        assert np.abs(photo.pixels().astype(int) - picture()).max() <= 20, name
        assert photo.exif["camera"] == "Maker Phone 1" and not photo.linear
    assert Photo.open(dng(tmp_path / "i.tif", np.full((64, 96), 500))).linear


@pytest.mark.parametrize("name", ["a.jpg", "b.png", "c.heic"])
def test_postscript_is_handed_to_no_program(name, tmp_path, monkeypatch):
    if name.endswith("heic"):
        pytest.importorskip("pillow_heif", reason='needs pip install "mitsvbrdf[heic]"')
    monkeypatch.setattr("PIL.EpsImagePlugin.Ghostscript", lambda *_, **__: pytest.fail("ran Ghostscript"))
    (tmp_path / name).write_bytes(
        b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 64 64\n%%EndComments\nshowpage\n%%EOF\n")
    Image.init()  # all formats
    with pytest.raises(CaptureError, match=name):
        Photo.open(tmp_path / name).pixels()


def test_a_strip_that_cannot_be_shrunk_is_named(tmp_path):
    cv2.imwrite(str(tmp_path / "strip.png"), picture(3, 400))
    with pytest.raises(CaptureError, match="strip.png"):
        Photo.open(tmp_path / "strip.png").pixels(most=50)
