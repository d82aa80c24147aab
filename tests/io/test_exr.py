"""EXR files of other programs: layers, kinds of numbers, windows."""

import numpy as np
import OpenEXR
import pytest

from mitsvbrdf.errors import MapsError, MapsWarning
from mitsvbrdf.io.images import read_image
from mitsvbrdf.material.map_files import load_maps, save_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.relight.environment import read_environment

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


@pytest.mark.parametrize("low, high, refused", [(-3e-5, 1.004, False), (-0.01, 1.0, False), (0.2, 1.5, True)])
def test_ringing_is_cut_with_a_word_and_more_is_refused(low, high, refused, tmp_path):
    save_maps(flat(8), tmp_path)
    values = np.full((8, 8), 0.7, np.float32)
    values[0, :2] = low, high
    written(tmp_path / "roughness.exr", {"Y": values})
    if refused:
        with pytest.raises(MapsError, match="its encoding"):
            load_maps(tmp_path)
        return
    with pytest.warns(MapsWarning, match="roughness.exr: . of 64 values are slightly outside"):
        found = load_maps(tmp_path)["roughness"][..., 0]
    assert found[0, 0] == 1 / 512 and found[0, 1] == 1 and (found[1:] == values[1, 0]).all()
