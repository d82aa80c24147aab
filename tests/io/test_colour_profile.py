"""Pictures in other colours than sRGB's come out as the sRGB picture they were made from, by closed forms."""

import io
import struct

import imagecodecs
import numpy as np
import OpenEXR
import pytest
from helpers import colour_files
from PIL import Image, ImageCms

from mitsvbrdf.errors import CaptureError, InputWarning, MapsError
from mitsvbrdf.io.decode import header, picture
from mitsvbrdf.io.images import read_image

INSIDE = np.stack(np.meshgrid(*[np.linspace(0.02, 0.98, 9)] * 3), axis=-1).reshape(27, 27, 3)


def read_in(path, space, bits=8, display=INSIDE):
    colour_files.save_in(path, np.repeat(np.repeat(display, 8, axis=0), 8, axis=1), space, bits)
    return picture(path, CaptureError)


@pytest.mark.parametrize("space", colour_files.SPACES)
@pytest.mark.parametrize(("name", "bits", "steps"), [("a.png", 8, 1.5), ("a.png", 16, 0.1), ("a.tif", 8, 1.5),
                                                     ("a.tif", 16, 0.1), ("a.webp", 8, 1.5)])
def test_a_picture_is_read_as_the_one_in_srgb(tmp_path, space, name, bits, steps):
    found = read_in(tmp_path / name, space, bits)
    error = np.abs(found.pixels[4::8, 4::8] / 65535 - INSIDE)
    # a step of a wide space's darkest values is several of sRGB's
    assert found.pixels.dtype == np.uint16 and found.outside == 0
    assert np.median(error) < 0.5 * steps / 255 and error.mean() < steps / 255
    assert bits == 8 or error.max() < 1 / 255


@pytest.mark.parametrize("space", colour_files.SPACES)
@pytest.mark.parametrize("name", ["a.jpg", "a.heic"])
def test_lossy_pictures_too(tmp_path, space, name):
    if name == "a.heic":
        pytest.importorskip("pillow_heif", reason='needs pip install "mitsvbrdf[heic]"')
    error = read_in(tmp_path / name, space).pixels[4::8, 4::8] / 65535 - INSIDE
    assert np.abs(np.median(error)) < 1 / 255 and np.median(np.abs(error)) < 2 / 255
    # what is read of it without its profile
    assert np.median(np.abs(colour_files.encoded_in(INSIDE, space) - INSIDE)) > 4 / 255


def test_colours_outside_are_counted(tmp_path):
    half = np.full((8, 8, 3), 0.5)
    half[:, :4] = (1.2, -0.1, 0.1)  # a red of Display P3
    assert read_in(tmp_path / "a.png", "Display P3", 16, half).outside == pytest.approx(0.5)


def test_pictures_in_srgb_keep_their_bits(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 255, (9, 9, 3), np.uint8)
    for profile in (ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(),
                    imagecodecs.cms_profile("srgb"), colour_files.icc_of(colour_files.SRGB, None)):
        Image.fromarray(pixels).save(tmp_path / "a.png", icc_profile=profile)
        assert np.array_equal(picture(tmp_path / "a.png", CaptureError).pixels, pixels)
        assert header(tmp_path / "a.png", CaptureError).profile is None


def png_with(path, kind, content, colour=(184, 56, 42)):
    data = io.BytesIO()
    Image.new("RGB", (4, 4), colour).save(data, "PNG")
    path.write_bytes(colour_files.with_chunk(data.getvalue(), kind, content))
    return path


def test_code_points_and_gamma_of_a_png(tmp_path):
    # Display P3 with sRGB's curve, by code points (ITU-T H.273); the value is ImageMagick's
    found = picture(png_with(tmp_path / "a.png", b"cICP", bytes((12, 13, 0, 1))), CaptureError)
    assert np.abs(found.pixels[0, 0] / 257 - (200, 40, 30)).max() < 1
    # linear: 0.5 is 0.735 in sRGB
    linear = png_with(tmp_path / "b.png", b"gAMA", struct.pack(">I", 100_000), (128,) * 3)
    assert picture(linear, CaptureError).pixels[0, 0] / 65535 == pytest.approx(0.7365, abs=2e-3)
    assert not header(png_with(tmp_path / "c.png", b"gAMA", struct.pack(">I", 45455)), CaptureError).profile


# what ImageMagick 6.9 makes of a colour: convert -profile SPACE -intent relative -profile sRGB
BY_IMAGEMAGICK = {"Display P3": ((184, 56, 42), (200.1, 39.8, 29.9)), "Rec. 2020": ((150, 110, 80),
                  (171.3, 103.8, 74.0)), "Adobe RGB": ((184, 56, 42), (213.4, 53.0, 36.7))}


@pytest.mark.parametrize(("space", "primaries"), [("Display P3", 12), ("Rec. 2020", 9)])
@pytest.mark.parametrize("bits", [8, 10])
def test_code_points_of_heic(tmp_path, space, primaries, bits):
    heif = pytest.importorskip("pillow_heif", reason='needs pip install "mitsvbrdf[heic]"')
    stored, shown = BY_IMAGEMAGICK[space]
    pixels = np.full((64, 64, 3), stored, np.uint8)
    made = (heif.from_pillow(Image.fromarray(pixels)) if bits == 8 else
            heif.from_bytes("RGB;16", (64, 64), (pixels * np.uint16(257)).tobytes()))
    made.save(tmp_path / "a.heic", quality=-1, chroma=444, save_nclx_profile=True, full_range_flag=1,
              color_primaries=primaries, transfer_characteristics=13, matrix_coefficients=6)
    found = picture(tmp_path / "a.heic", CaptureError).pixels
    assert found.dtype == np.uint16
    assert np.abs(np.median(found, axis=(0, 1)) / 257 - shown).max() < (2 if bits == 8 else 0.6)


@pytest.mark.parametrize("name", ["a.jpg", "a.webp"])
def test_exif_alone(tmp_path, name):
    stored, shown = BY_IMAGEMAGICK["Adobe RGB"]

    def read(space=None, rules=None):
        exif = Image.Exif()
        exif[0x8769] = {0xA001: space} if space else {}
        if rules:  # of Exif's own block, which Pillow writes with its numbers alone
            exif[0x8769][0xA005] = {1: rules}
        how = {"a.jpg": {"quality": 98, "subsampling": 0}, "a.webp": {"lossless": True}}.get(name, {})
        Image.new("RGB", (16, 16), stored).save(tmp_path / name, exif=exif, **how)
        return picture(tmp_path / name, CaptureError).pixels[8, 8], header(tmp_path / name, CaptureError)

    for found, _ in (read(rules="R03"), read(65535, "R03"), read(2)):
        assert np.abs(found / 257 - shown).max() < 1.5
    for found, about in (read(1), read(rules="R98"), read(65535, "R98")):
        assert about.profile is None and np.abs(found.astype(int) - stored).max() <= 1
    found, about = read(65535)
    assert "uncalibrated" in about.profile.name and about.profile.reason


def test_grey_profiles(tmp_path):
    icc = imagecodecs.cms_profile("gray", whitepoint=(0.3127, 0.3290), gamma=1.0)
    Image.new("L", (4, 4), 128).save(tmp_path / "a.png", icc_profile=icc)
    assert picture(tmp_path / "a.png", CaptureError).pixels[0, 0] / 65535 == pytest.approx(0.7365, abs=2e-3)
    Image.new("RGB", (4, 4), 128).save(tmp_path / "b.png", icc_profile=icc)
    assert "grey" in header(tmp_path / "b.png", CaptureError).profile.reason


@pytest.mark.parametrize(("points", "name"), [((9, 16, 0, 1), "PQ"), ((9, 18, 0, 1), "HLG"),
                                              ((77, 13, 0, 1), "primaries 77"), ((0,) * 32, "cHRM of PNG")])
def test_what_cannot_be_used_is_named(tmp_path, points, name):
    path = png_with(tmp_path / "a.png", b"cICP" if len(points) == 4 else b"cHRM", bytes(points))
    with pytest.warns(InputWarning, match=f"a.png.*{name}.*cannot be used"):
        read_image(path, MapsError)
    Image.new("RGB", (4, 4), 128).save(tmp_path / "b.png", icc_profile=b"no profile")
    with pytest.warns(InputWarning, match="b.png.*damaged ICC profile cannot be used"):
        read_image(tmp_path / "b.png", MapsError)


@pytest.mark.parametrize(("make", "full", "wrong"), [("SONY", 0, True), ("SONY", 1, False),
                                                     ("Google", 0, False)])
def test_the_limited_range_that_sony_states_of_full_range_is_named(tmp_path, make, full, wrong):
    heif = pytest.importorskip("pillow_heif", reason='needs pip install "mitsvbrdf[heic]"')
    exif = Image.Exif()
    exif[271] = make
    heif.from_pillow(Image.new("RGB", (64, 64), 128)).save(
        tmp_path / "a.heic", exif=exif.tobytes(), save_nclx_profile=True, full_range_flag=full,
        color_primaries=1, transfer_characteristics=13, matrix_coefficients=6)
    found = header(tmp_path / "a.heic", CaptureError).profile
    assert bool(found and found.name == "limited range" and "Sony" in found.reason) == wrong


def test_numbers_that_are_no_colours_stay(tmp_path):
    colour_files.save_in(tmp_path / "a.png", INSIDE, "Adobe RGB", 8)
    stored = np.asarray(Image.open(tmp_path / "a.png")) / np.float32(255)
    assert np.array_equal(read_image(tmp_path / "a.png", MapsError, data=True).numpy(), stored)


@pytest.mark.parametrize("space", [*colour_files.SPACES, "ACES"])
def test_chromaticities_of_an_exr(tmp_path, space):
    linear = INSIDE.astype(np.float32)
    corners = colour_files.ACES if space == "ACES" else colour_files.SPACES[space][0]
    stored = colour_files.encoded_in(linear, corners, curve=False)
    colour_files.with_chromaticities(tmp_path / "a.exr", stored, corners)
    assert read_image(tmp_path / "a.exr", MapsError).numpy() == pytest.approx(linear, abs=2e-3)
    assert np.abs(read_image(tmp_path / "a.exr", MapsError, data=True).numpy() - linear).max() > 0.02


def test_an_exr_outside_of_rec709_is_told(tmp_path):
    corners = colour_files.SPACES["Display P3"][0]
    colour_files.with_chromaticities(tmp_path / "a.exr", np.full((4, 4, 3), (1, 0, 0), np.float32), corners)
    with pytest.warns(InputWarning, match="a.exr: 100.00% of the pixels"):
        assert read_image(tmp_path / "a.exr", MapsError)[0, 0].tolist() == [1, 0, 0]
    colour_files.with_chromaticities(tmp_path / "b.exr", np.ones((4, 4, 3), np.float32), (0.3,) * 8)
    with pytest.raises(MapsError, match="b.exr.*span no colours"):
        read_image(tmp_path / "b.exr", MapsError)
    assert OpenEXR.File(str(tmp_path / "a.exr")).channels()["RGB"].pixels.shape == (4, 4, 3)
