"""What the numbers of a map's file mean where a profile, a habit and the user say different things."""

import warnings

import imagecodecs
import numpy as np
import pytest
import torch
from helpers.colour_files import SRGB
from helpers.map_files import UP, written
from PIL import Image

from mitsvbrdf.errors import AssumedWarning, MapsError
from mitsvbrdf.evaluate import evaluate_maps
from mitsvbrdf.io.images import write_exr
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.material.maps import flat

LINEAR = imagecodecs.cms_profile("rgb", whitepoint=SRGB[6:], primaries=SRGB[:6], gamma=1.0)


@pytest.mark.parametrize("encoding", [None, "linear", "diffuse=srgb"])
@pytest.mark.parametrize("names", ["diffuse specular roughness normal", "x_COLOR x_SPEC x_GLOSS x_NRM"])
def test_a_profile_counts_before_a_habit_and_never_twice(names, encoding, tmp_path):
    """Linear colours with a profile that says so: stated to be linear, they stay as they are."""
    for name, value in zip(names.split(), ((64, 128, 200), (90, 60, 30), 117, UP)):
        pixels = np.full((8, 8, 3), value, np.uint8)
        Image.fromarray(pixels).save(tmp_path / f"{name}.png", icc_profile=LINEAR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AssumedWarning)
        found = load_maps(tmp_path, encoding=encoding)
    assert found["diffuse"][0, 0].tolist() == pytest.approx([64 / 255, 128 / 255, 200 / 255], abs=1e-4)
    assert found["specular"][0, 0].tolist() == pytest.approx([90 / 255, 60 / 255, 30 / 255], abs=1e-4)


def test_the_roughness_of_an_exr_is_measured_as_stored(tmp_path):
    for name, value in flat(8, roughness=0.25).maps.items():
        write_exr(tmp_path / f"{name}.exr", value)
    assert evaluate_maps(flat(8, roughness=0.5), tmp_path)["roughness"] == pytest.approx(0.25)


@pytest.mark.parametrize("level", [-0.5, 255.0])
def test_a_specular_level_out_of_range_is_refused(level, tmp_path):
    levels = {"specular_level": torch.full((8, 8, 1), level)}
    for name, value in (dict(flat(8, "principled").maps) | levels).items():
        write_exr(tmp_path / f"{name}.exr", value)
    with pytest.warns(AssumedWarning), pytest.raises(MapsError, match="specular_level.exr"):
        load_maps(tmp_path)


def test_an_encoding_asked_of_an_exr_is_said_not_to_count(tmp_path):
    folder = written(tmp_path, diffuse=128, specular=60, roughness=128, normal=UP)
    write_exr(folder / "diffuse.exr", torch.full((8, 8, 3), 0.3))
    with pytest.warns(AssumedWarning, match="EXR, which is linear: diffuse"):
        assert load_maps(folder, encoding="diffuse=srgb")["diffuse"][0, 0, 0].item() == pytest.approx(0.3)
