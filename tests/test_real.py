"""The real thing: nine photos of `cards-blue`. Minutes long; `./run slow`."""

import json

import pytest
from helpers import ANALYTIC

from mitsvbrdf import cli
from mitsvbrdf.capture import Capture, guess_diffuse, read_capture
from mitsvbrdf.color import encode, to_display
from mitsvbrdf.evaluate import evaluate_maps
from mitsvbrdf.fit import HierarchicalConfig, fit_svbrdf
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.measure.burn_in import burn_in
from mitsvbrdf.render import make_renderer
from mitsvbrdf.synth import photograph

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["roughconductor", "principled"])
def fitted(request, data_folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("cards") / request.param
    arguments = ["fit", str(data_folder / "captures/cards-blue"), "-o", str(out), "--bsdf", request.param]
    assert cli.main([*arguments, "--budget", "60", "--views", "0,1,2,3,5,6,8"]) == 0
    return request.param, out


def test_renderers_meet_every_tolerance_on_fitted_maps(fitted, data_folder):
    # Both BSDFs, every renderer, with the flash where the fit found it.
    capture = str(data_folder / "captures/cards-blue")
    assert cli.main(["crosscheck", str(fitted[1]), "--views", capture, "--repeats", "1"]) == 0


def test_renderers_meet_every_tolerance_on_known_materials(data_folder):
    capture = str(data_folder / "captures/cards-blue")
    for folder in sorted((data_folder / "materials").iterdir()):
        assert cli.main(["crosscheck", str(folder), "--views", capture, "--repeats", "1"]) == 0, folder.name


def test_photos_left_out_are_predicted(fitted, data_folder, tmp_path, request):
    bsdf, out = fitted
    if bsdf == "principled":  # strict: the day it is met, this has to go
        request.applymarker(pytest.mark.xfail(reason="misses the goal: measured 0.085", strict=True))
    figures = tmp_path / "e.json"
    capture = str(data_folder / "captures/cards-blue")
    assert cli.main(["evaluate", str(out), "--capture", capture, "--views", "4,7", "--json",
                     str(figures)]) == 0
    error = json.loads(figures.read_text())["rerender_rmse"]
    print(bsdf, "photos 4 and 7:", error)
    assert error <= 0.08  # measured with roughconductor: 0.068


def test_known_materials_come_back(data_folder):
    # The bars are those of MaterialGAN, trained on a large data set, on materials of the same kind (paper,
    # tables 1 and 2, and peers.json), at 256 px. Measured there: see README.
    views, errors = read_capture(data_folder / "captures/cards-blue").views, []
    for folder in sorted((data_folder / "materials").iterdir()):
        capture = photograph(load_maps(folder).resized(128), views, make_renderer("mitsuba"))
        result = fit_svbrdf(capture, make_renderer("mitsuba"), HierarchicalConfig(budget=300))
        errors.append(evaluate_maps(result.svbrdf, folder))
        print(folder.name, errors[-1])
    mean = {name: sum(e[name] for e in errors) / len(errors) for name in errors[0]}
    for name, bar in {"diffuse": 0.030, "specular": 0.024, "roughness": 0.047, "normal": 0.040}.items():
        assert mean[name] <= bar, mean


def test_nothing_is_burnt_in(data_folder):
    # Roughness and specular of the capture that burns in worst: 0.67 in MaterialGAN's published roughness,
    # 0.79 with `hybrid`.
    capture = read_capture(data_folder / "captures/wood-bamboo", resolution=256)
    result = fit_svbrdf(capture, make_renderer("mitsuba"), HierarchicalConfig(budget=300))
    assert max(burn_in(result.svbrdf, result.views).values()) <= 0.10


def test_robust_guess_on_known_materials(data_folder):
    # Measured at 256 px: 0.048 (the paper's minimum: 0.085; the paper prints 0.070 for its own materials).
    views = read_capture(data_folder / "captures/cards-blue").views
    errors = []
    for folder in sorted((data_folder / "materials").iterdir()):
        truth = load_maps(folder).resized(256)
        photos = (to_display(ANALYTIC.render(truth, views)) * 255).round() / 255
        guess = guess_diffuse(Capture(photos, views))
        errors.append(float((encode(guess) - encode(truth["diffuse"])).square().mean().sqrt()))
    assert sum(errors) / len(errors) <= 0.05, errors
