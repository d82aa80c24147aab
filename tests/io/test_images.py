"""Pictures in files become tensors, and what is no flat picture is refused by name."""

import os

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from helpers.averages import area_means
from PIL import Image

from mitsvbrdf.errors import CaptureError, MapsError, MapsWarning
from mitsvbrdf.io import images
from mitsvbrdf.io.images import averaged, read_image
from mitsvbrdf.material.map_files import load_maps, save_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.relight.environment import read_environment


def test_16_bits_are_read_as_they_are(tmp_path):
    values = np.array([[0, 1, 256, 65535]], np.uint16)
    Image.fromarray(values).save(tmp_path / "x.png")
    found = read_image(tmp_path / "x.png", CaptureError)[..., 0].numpy() * 65535
    assert found == pytest.approx(values, abs=0.01)


def test_a_full_disk_has_its_number_where_openexr_meets_it(tmp_path, monkeypatch):
    import errno

    from mitsvbrdf.errors import OutputError

    def fails(*_):
        raise RuntimeError("cannot write")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(OpenEXR.File, "write", fails)
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
    data = written(tmp_path / "x.exr", {"RGB": np.zeros((4, 6, 3), np.float32)}).read_bytes()
    begin = data.index(b"dataWindow\0box2i\0") + 18 + 4
    wide = (data[:begin + 8] + (2**20).to_bytes(4, "little") + (2**20).to_bytes(4, "little")
            + data[begin + 16:])
    (tmp_path / "x.exr").write_bytes(wide)
    with pytest.raises(MapsError, match="at most 250 megapixels|readable EXR"):
        read_image(tmp_path / "x.exr", MapsError)


RNG = np.random.default_rng(0)
RED, GREEN, BLUE, OTHER = RNG.random((4, 6, 8)).astype(np.float32)


def written(path, channels, **header):
    OpenEXR.File({"type": OpenEXR.scanlineimage} | header, channels).write(str(path))
    return path


@pytest.mark.parametrize("layer", ["ViewLayer.Combined.", "beauty.", "Scene.View Layer.Combined."])
def test_a_layer_is_the_picture(layer, tmp_path):
    path = written(tmp_path / "x.exr", {layer + "R": RED, layer + "G": GREEN, layer + "B": BLUE,
                                        layer + "A": OTHER, "ViewLayer.Depth.Z": OTHER})
    assert np.array_equal(read_image(path, MapsError).numpy(), np.stack((RED, GREEN, BLUE), axis=-1))
    assert np.array_equal(read_environment(path)[..., 2].numpy(), BLUE)


def test_the_combined_layer_is_preferred_and_others_are_asked_for(tmp_path):
    layers = {f"{layer}.{c}": plane for layer in ("V.Combined", "V.Normal")
              for c, plane in zip("RGB", (RED, GREEN, BLUE) if "C" in layer else (OTHER,) * 3)}
    assert np.array_equal(read_image(written(tmp_path / "a.exr", layers), MapsError)[..., 0].numpy(), RED)
    layers = {name.replace("Combined", "Albedo"): plane for name, plane in layers.items()}
    with pytest.raises(MapsError, match="one picture.*V.Albedo.B.*V.Normal.B"):
        read_image(written(tmp_path / "b.exr", layers), MapsError)


def test_luminance_beside_its_colours_is_no_grey_picture(tmp_path):
    """Luminance and chroma, as OpenEXR's RgbaOutputFile writes them with WRITE_YC."""
    path = written(tmp_path / "x.exr", {"Y": RED, "RY": GREEN, "BY": BLUE})
    with pytest.raises(MapsError, match="R, G, B or one channel.*'BY', 'RY', 'Y'"):
        read_image(path, MapsError)


@pytest.mark.parametrize("names", ["XYZ", "xyz"])
def test_vectors_are_read_in_either_case(names, tmp_path):
    path = written(tmp_path / "x.exr", {f"n.{name}": plane for name, plane in zip(names, (RED, GREEN, BLUE))})
    assert np.array_equal(read_image(path, MapsError).numpy(), np.stack((RED, GREEN, BLUE), axis=-1))


@pytest.mark.parametrize("kinds", ["hhhf", "fhhh", "hffh"])
def test_channels_of_several_kinds_are_read(kinds, tmp_path):
    planes = [plane.astype({"h": np.float16, "f": np.float32}[kind])
              for kind, plane in zip(kinds, (RED, GREEN, BLUE, OTHER))]
    found = read_image(written(tmp_path / "x.exr", dict(zip("RGBA", planes))), MapsError)
    assert np.array_equal(found.numpy(), np.stack(planes[:3], axis=-1).astype(np.float32))


def test_the_display_window_is_what_is_shown(tmp_path):
    """Overscan is cut, and what the file does not hold is 0."""
    whole, corner = np.stack((RED, GREEN, BLUE), axis=-1), np.array
    for shown, wanted in (((1, 2, 5, 4), whole[2:5, 1:6]),
                          ((-1, -2, 7, 5), np.pad(whole, ((2, 0), (1, 0), (0, 0))))):
        held, display = ((corner(box[:2], np.int32), corner(box[2:], np.int32))
                         for box in ((0, 0, 7, 5), shown))
        path = written(tmp_path / "x.exr", {"RGB": whole}, dataWindow=held, displayWindow=display)
        assert np.array_equal(read_image(path, MapsError).numpy(), wanted)


def test_x_and_y_alone_are_no_environment(tmp_path):
    path = written(tmp_path / "x.exr", {"R": RED, "G": GREEN})
    assert read_image(path, MapsError).shape == (6, 8, 2)
    with pytest.raises(Exception, match="R, G, B or one channel"):
        read_environment(path)


@pytest.mark.parametrize("low, high", [(-3e-5, 1.004), (-0.01, 1.0), (0.2, 1.5), (-0.5, 1.0)])
def test_ringing_is_cut_with_a_word_and_more_is_refused(low, high, tmp_path):
    save_maps(flat(8), tmp_path)
    values = np.full((8, 8), 0.7, np.float32)
    values[0, :2] = low, high
    written(tmp_path / "roughness.exr", {"Y": values})
    if max(-low, high - 1) > 0.05:
        with pytest.raises(MapsError, match="its encoding"):
            load_maps(tmp_path)
        return
    with pytest.warns(MapsWarning, match="roughness.exr: . of 64 values are slightly outside"):
        found = load_maps(tmp_path)["roughness"][..., 0]
    assert found[0, 0] == 1 / 512 and found[0, 1] == 1 and (found[1:] == values[1, 0]).all()
