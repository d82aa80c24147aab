"""Error measures against independent numpy computations, closed forms and published numbers."""

import json
import math
import sys

import numpy as np
import pytest
import torch

from mitsvbrdf.errors import BackendError, CaptureError, ConfigError, MapsError
from mitsvbrdf.io import images
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.measure.metrics import flip, gradient_error, image_error, map_rmse, photo_rmse, relative_error

MAPS = ("diffuse", "specular", "roughness", "normal")


def rms(values):
    return math.sqrt(np.mean(np.square(values)))


@pytest.mark.parametrize("encoding", ["linear", "gamma 2.2"])
def test_map_rmse_is_the_plain_formula(encoding):
    first, second = make_material("leather", 32, seed=1), make_material("leather", 32, seed=2)
    power = {"diffuse": 1 / 2.2, "specular": 1 / 2.2, "roughness": 1 if encoding == "linear" else 1 / 2.2}
    wanted = {}
    for name in MAPS:
        a, b = first[name].numpy().astype(np.float64), second[name].numpy().astype(np.float64)
        wanted[name] = rms((a - b) / 2 if name == "normal" else a ** power[name] - b ** power[name])
    wanted["mean"] = sum(wanted.values()) / 4
    assert map_rmse(first, second, encoding) == pytest.approx(wanted, rel=1e-12)


def test_map_rmse_of_a_principled_estimate():
    estimate = flat(8, "principled", base_color=0.8, metallic=0.25, roughness=0.5)
    wanted = {"diffuse": 0, "specular": 0, "roughness": 0.1, "normal": 0, "mean": 0.025}
    found = map_rmse(estimate, flat(8, diffuse=0.6, specular=0.23, roughness=0.4))
    assert found == pytest.approx(wanted, abs=1e-6)  # float32 maps


def test_map_rmse_compares_at_the_smaller_resolution():
    large = make_material("inlay", 64)
    for pair in ((large, large.resized(32)), (large.resized(32), large)):
        assert map_rmse(*pair) == pytest.approx(dict.fromkeys((*MAPS, "mean"), 0), abs=1e-12)


def test_photo_rmse_clips_and_weighs_all_pixels_alike():
    generator = np.random.default_rng(0)
    linear, photos = generator.uniform(0, 2, (3, 5, 5, 3)), generator.uniform(0, 1, (3, 5, 5, 3))
    off = np.minimum(linear, 1) ** (1 / 2.2) - photos
    total, each = photo_rmse(torch.tensor(linear), torch.tensor(photos))
    assert total == pytest.approx(rms(off), rel=1e-12)
    assert each == pytest.approx([rms(photo) for photo in off], rel=1e-12)


def test_photo_rmse_of_masked_photos_is_that_of_the_rest():
    generator = torch.Generator().manual_seed(0)
    linear, photos = torch.rand(2, 3, 4, 4, 3, generator=generator, dtype=torch.float64)
    measured = torch.ones(3, 4, 4, dtype=torch.bool)
    measured[0, :, 1] = measured[2] = False
    total, each = photo_rmse(linear, photos, "linear", measured)
    off = (linear - photos).numpy()
    assert each == pytest.approx([rms(off[0][:, [0, 2, 3]]), rms(off[1]), 0], rel=1e-12)
    assert total == pytest.approx(rms(off[measured]), rel=1e-12)


def test_image_error_statistics_and_floor():
    reference, image = torch.ones(10000, dtype=torch.float64), torch.ones(10000, dtype=torch.float64)
    image[:10] += 0.5
    image[10] -= 0.25
    stats = image_error(image, reference)
    assert stats == pytest.approx({"mean": 5.25e-4, "p99.9": 0.25, "worst": 0.5, "bias": 4.75e-4}, rel=1e-9)
    reference[0], image[0] = 0.0, 1e-3 * 0.9999  # a black pixel counts as 1e-3 of the mean
    assert image_error(image, reference)["worst"] == pytest.approx(1.0, rel=1e-9)


def test_relative_error_keeps_shape_and_sign():
    reference = torch.tensor([[1.0, 2.0], [4.0, 1e-9]])
    assert relative_error(reference * 0.5, reference)[:, 0].tolist() == [-0.5, -0.5]
    assert relative_error(reference, reference).shape == (2, 2)
    assert float(relative_error(torch.zeros(2, 2), reference)[1, 1]) == pytest.approx(
        -1e-9 / (1e-3 * 1.75), rel=1e-6)


def test_gradient_error_of_known_vectors():
    reference = torch.tensor([[3.0, 4.0], [0.0, 0.0]])
    turned = torch.tensor([[3.0, 4.0], [5.0, 0.0]])
    for gradient, l2, cosine, worst, bias in (
            (reference, 0, 1, 0, 0), (-reference, 2, -1, 2, -2), (turned, 1, 0.5**0.5, 1.25, 0)):
        wanted = {"relative_l2": l2, "cosine": cosine, "worst": worst, "bias": bias}
        assert gradient_error(gradient, reference) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("measure, given, error, said", [
    (map_rmse, (flat(4), flat(4), "gamma"), ConfigError, "gamma 2.2"),
    (photo_rmse, (torch.zeros(2, 4, 4, 3), torch.zeros(2, 8, 8, 3)), CaptureError, "N x R x R x 3"),
    (image_error, (torch.zeros(3), torch.zeros(3, 1)), MapsError, "one shape"),
    (gradient_error, (torch.zeros(3), torch.zeros(3, 1)), MapsError, "one shape")])
def test_what_cannot_be_compared_is_refused(measure, given, error, said):
    with pytest.raises(error, match=said):
        measure(*given)


def as_stored(folder):
    """Maps with the normals of the files as they are, off unit length as 8 bits or JPEG left them."""
    normal = images.read_image(folder / "normal.png", MapsError) * 2 - 1
    return SVBRDF("roughconductor", dict(load_maps(folder, encoding="gamma 2.2").maps) | {"normal": normal})


def test_published_map_errors_are_reproduced(data_folder):
    compared = 0
    for material, methods in json.loads((data_folder / "peers.json").read_text())["materials"].items():
        folder = data_folder / "materials" / material
        for method, published in methods.items():
            peer = folder / "peers" / method
            errors = map_rmse(as_stored(peer), as_stored(folder), "gamma 2.2")
            assert {name: round(errors[name], 4) for name in MAPS} == published
            unit = map_rmse(load_maps(peer, encoding="gamma 2.2"), load_maps(folder), "gamma 2.2")
            assert errors["normal"] - 0.001 < unit["normal"] < errors["normal"]
            compared += 1
    assert compared == 5


@pytest.mark.parametrize("name", ["cards-blue", "leather-brown", "book1"])
def test_published_rerendering_errors_are_reproduced(data_folder, name):
    folder = data_folder / "captures" / name
    published = json.loads((data_folder / "peers.json").read_text())["captures"][name]

    def averaged(photos):
        found = [images.read_image(path, CaptureError).double().permute(2, 0, 1)
                 for path in sorted(photos.iterdir())]
        return torch.nn.functional.interpolate(torch.stack(found), (256, 256),
                                               mode="area").permute(0, 2, 3, 1)

    total, each = photo_rmse(averaged(folder / "materialgan/rerendered"), averaged(folder / "target"),
                             "linear")
    assert round(total, 4) == published["materialgan_rerender_rmse_256"]
    assert [round(value, 4) for value in each] == published["per_view"]


def test_flip_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    with pytest.raises(BackendError, match='pip install "mitsvbrdf.flip."'):
        flip(torch.zeros(8, 8, 3), torch.zeros(8, 8, 3))
