"""What surrounds the shapes, against closed forms."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from helpers.variants import mostly_slow

from mitsvbrdf.errors import ConfigError
from mitsvbrdf.io import images
from mitsvbrdf.relight import environment


@pytest.mark.parametrize("suffix", mostly_slow(["studio", "sunsky", ".exr", ".hdr"], "studio", ".hdr"))
def test_white_that_faces_up_has_luminance_0_8(mi, suffix, tmp_path):
    name = suffix
    if suffix.startswith("."):
        name = str(tmp_path / f"sky{suffix}")
        image = 5 * torch.rand(9, 24, 3, generator=torch.Generator().manual_seed(1))
        image[2, 5] = 300
        if suffix == ".exr":
            images.write_exr(Path(name), image)
        else:
            cv2.imwrite(name, np.ascontiguousarray(image.numpy()[..., ::-1]))
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "direct"}, **environment.make_environment(mi, name).emitters,
        "sensor": {"type": "perspective",
                   "to_world": mi.ScalarTransform4f().look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]),
                   "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}},
        "plane": {"type": "rectangle",
                  "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}}})
    white = torch.from_numpy(np.array(mi.render(scene, spp=16384)))[..., :3].mean(dim=(0, 1))
    # 262,144 samples: noise below 0.2 %; the sunsky file's scale has four digits.
    assert float(white.double() @ environment.LUMINANCE) == pytest.approx(0.8, rel=0.01)


def test_a_radiance_file_is_read_in_the_order_red_green_blue(tmp_path):
    # RGBE (Ward 1991): mantissa / 256 * 2 ** (exponent - 128), top row first.
    pixels = [(128, 64, 32, 129), (0, 0, 200, 128)] * 3 + [(64, 0, 0, 131)] * 2
    path = tmp_path / "sky.hdr"
    path.write_bytes(
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 2\n" + bytes(v for pixel in pixels for v in pixel))
    image = environment.read_environment(path)
    assert image[0].tolist() == [[1, 0.5, 0.25], [0, 0, 200 / 256]] and image[3].tolist() == [[2, 0, 0]] * 2


def test_white_luminance_of_a_half_lit_sky():
    # Closed form: the upper hemisphere at 1 gives 1; the cap within 60 degrees of the zenith sin^2 60 = 3/4.
    assert environment.white_luminance(torch.ones(5, 4, 3)) == pytest.approx(1, rel=1e-5)
    theta = torch.linspace(0, math.pi, 1801)
    cap = (theta < math.pi / 3).double()[:, None, None].expand(-1, 2, 3)
    assert environment.white_luminance(cap) == pytest.approx(0.75, rel=2e-3)  # one row of 1800 is the edge
    line = torch.zeros(5001, 1, 3)
    line[777] = 5000 / math.pi  # over its height, light of 1: 2 cos sin of its angle
    assert environment.white_luminance(line) == pytest.approx(math.sin(2 * math.pi * 777 / 5000), rel=1e-4)
    # a row's sum is no float32
    assert environment.white_luminance(torch.full((5, 4, 3), 1e38)) == pytest.approx(1e38, rel=1e-5)


def test_the_middle_of_an_environment_is_ahead_and_its_right_is_right(mi, tmp_path):
    image = torch.full((64, 128, 3), 0.1)
    # red right, green left, blue below
    image[:32, 64:, 0], image[:32, :64, 1], image[32:, :, 2] = 1.0, 1.0, 1.0
    images.write_exr(tmp_path / "sky.exr", image)
    around = environment.make_environment(mi, str(tmp_path / "sky.exr"))
    scene = mi.load_dict({"type": "scene", "integrator": {"type": "path"}, **around.emitters, "sensor": {
        "type": "perspective", "fov": 80,
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 1, 0], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}}})

    def colours():
        picture = np.array(mi.render(scene, spp=16))[..., :3]
        return [int(picture[row, column].argmax()) for row, column in ((1, 1), (1, 6), (6, 1), (6, 6))]

    assert colours() == [1, 0, 2, 2]
    held = mi.traverse(scene)
    for key, value in around.turned(180).items():
        held[key] = value
    held.update()
    assert colours() == [0, 1, 2, 2]


@pytest.mark.parametrize("what, change", [
    ("no file", None), ("NaN", lambda i: i.index_fill_(0, torch.tensor([2]), math.nan)),
    ("negative", lambda i: i.sub_(1.5)), ("2 x 3 pixels", lambda i: i.resize_(2, 2, 3)),
    ("black there", lambda i: i[:5].zero_())])
def test_environments_that_cannot_be_used_are_refused(mi, what, change, tmp_path):
    path = tmp_path / "sky.exr"
    if change:
        image = torch.ones(8, 16, 3)
        change(image)
        images.write_exr(path, image)
    with pytest.raises(ConfigError, match=what):
        environment.make_environment(mi, str(path))


def test_files_that_are_no_environment_are_refused(mi, tmp_path):
    for name in ("sky.exr", "sky.hdr"):
        (tmp_path / name).write_bytes(b"no picture")
        with pytest.raises(ConfigError, match="readable"):
            environment.make_environment(mi, str(tmp_path / name))
    for name in ("sky.png", "stuido"):
        with pytest.raises(ConfigError, match="studio"):
            environment.make_environment(mi, name)


def test_the_studio_is_lit_from_three_sides():
    image = environment.studio(64)
    assert image.shape == (64, 128, 3) and bool((image > 0).all())
    bright = (image.amax(dim=-1) > 2).long()
    assert int(bright.sum()) < 0.1 * bright.numel()
    columns = bright.any(dim=0).long()
    assert int((columns.diff(append=columns[:1]) == 1).sum()) == 3


@pytest.mark.parametrize("size, word", [("-Y 99999 +X 99999", "250 megapixels"),
                                        ("-Y 9999999999 +X 9", "250 megapixels"),
                                         ("-Y 4 +X 0", "none"), ("+Y 4 +X 4", "none"), ("", "none")])
def test_a_picture_of_an_impossible_size_is_refused_from_its_header(size, word, tmp_path):
    path = tmp_path / "sky.hdr"
    cv2.imwrite(str(path), np.ones((4, 4, 3), np.float32))
    assert environment.read_environment(path).shape == (4, 4, 3)
    path.write_bytes(path.read_bytes().replace(b"-Y 4 +X 4", size.encode()))
    with pytest.raises(ConfigError, match=word):
        environment.read_environment(path)
