"""What other people's test suites use: renderers that must agree, golden files, the Z-test, and the pytest plugin."""

from __future__ import annotations

import importlib
import math
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import flip_evaluator  # noqa: F401  (what is loaded here stays loaded after the small suites in this process)
import mpmath
import numpy as np
import OpenEXR
import pytest
import torch

from mitsvbrdf.errors import ConfigError, MapsError
from mitsvbrdf.export.mitsuba import write_scene
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.measure.z_test import _normal_score
from mitsvbrdf.render import make_renderer
from mitsvbrdf.testing import (
    assert_matches_golden,
    assert_renderers_agree,
    assert_z_test,
    random_material,
    running,
    z_test,
)
from mitsvbrdf.views import nine_view_grid

ROOT = Path(__file__).parent.parent
PLUGIN = "mitsvbrdf.testing.plugin"
TWO = nine_view_grid().pick([0, 4])


@pytest.fixture
def report(tmp_path):
    """Pages of comparisons that are meant to fail go here instead of beside those of this suite."""
    run = running.Run(report=tmp_path / "report")
    with running.running(running.Caller("tests/test_a.py::test_b[c/d]", tmp_path / "test_a.py", run)):
        yield run.report


class Wrong:
    """The float32 twin with something changed on the way in or out."""

    name = "wrong"

    def __init__(self, maps=lambda maps: maps, image=lambda image: image):
        self.twin, self.maps, self.image = make_renderer("analytic"), maps, image

    def render(self, svbrdf, views):
        return self.image(self.twin.render(SVBRDF(svbrdf.bsdf, self.maps(dict(svbrdf.maps))), views))


def with_gradient_off(name, factor):
    """The same values of a map, with a gradient that is off by this factor."""
    return lambda maps: maps | {name: maps[name] * factor - maps[name].detach() * (factor - 1)}


WIDE = {"image_mean": 1e-5, "image_p999": 1e-4, "gradients": 1e-4}


@pytest.mark.parametrize("bsdf", ["roughconductor", "principled"])
def test_renderers_that_agree_pass_and_leave_no_page(bsdf, report):
    assert_renderers_agree(random_material(bsdf, 16), TWO, ("analytic", Wrong()), **WIDE)
    assert not report.exists()


def test_a_wrong_gradient_is_named(report):
    wrong = Wrong(with_gradient_off("roughness", 1.01))
    with pytest.raises(AssertionError) as caught:
        assert_renderers_agree(random_material("roughconductor", 16), TWO, ("analytic", wrong), **WIDE)
    lines = str(caught.value).splitlines()
    assert lines[0] == "wrong differs from analytic64"
    assert lines[1] == "  wrong: gradient of roughness, relative L2: 0.01, limit 0.0001"
    assert lines[2].startswith("  page: ") and len(lines) == 3  # nothing else is off
    text = Path(lines[2].removeprefix("  page: ")).read_text()
    assert text.count("wrong: ") == 6 and text.count("analytic: ") == 6  # all figures of both
    assert text.count('class="text bad"') == 1
    assert text.count("data:image/png") == 2 * 4 + 4 * 3  # two views of four pictures, four gradients of three
    assert not re.search(r"""(src|href)=["'](?!data:)""", text)  # self-contained


@pytest.mark.parametrize("image, missed", [
    (lambda x: x * 1.001, ["image, mean relative error: 0.001", "image, 99.9 % of the values within: 0.001"]),
    (lambda x: x * torch.where(torch.arange(x.numel()).reshape(x.shape) % 700 == 0, 1.01, 1.0),
     ["image, mean relative error: 1.9", "image, 99.9 % of the values within: 0.01"]),
    (lambda x: x * torch.where(torch.arange(x.numel()).reshape(x.shape) == 5, torch.nan, 1.0),
     ["image, mean relative error: nan"])])
def test_a_wrong_image_is_named(image, missed, report):
    with pytest.raises(AssertionError) as caught:
        assert_renderers_agree(flat(16), TWO, [Wrong(image=image)], **(WIDE | {"gradients": math.inf}))
    lines = str(caught.value).splitlines()[1:-1]
    assert len(lines) == len(missed)
    for line, start in zip(lines, missed):
        assert line.startswith(f"  wrong: {start}")


def test_an_infinite_limit_asks_for_no_gradient(report):
    undifferentiable = Wrong(image=torch.Tensor.detach)
    limits = {"image_mean": 1e-5, "image_p999": 1e-4}
    assert_renderers_agree(flat(8), TWO, [undifferentiable], gradients=math.inf, **limits)
    with pytest.raises(ConfigError, match="gradients=math.inf"):
        assert_renderers_agree(flat(8), TWO, [undifferentiable], gradients=1.0, **limits)


def test_gradients_that_are_both_zero_agree(report):
    dark = Wrong(lambda maps: maps | {"normal": maps["normal"] * torch.tensor([1.0, 1.0, -1.0])})
    assert_renderers_agree(flat(8), TWO, [dark], reference=dark, **WIDE)
    with pytest.raises(AssertionError, match="gradient of diffuse, relative L2: inf"):
        assert_renderers_agree(flat(8), TWO, ["analytic"], reference=dark, **WIDE)


def test_a_renderer_of_somebody_else_needs_limits():
    with pytest.raises(ConfigError, match="limits for the renderer 'wrong'"):
        assert_renderers_agree(flat(8), TWO, [Wrong()], image_mean=1.0)


def test_a_page_that_cannot_be_written_does_not_hide_the_failure(report):
    report.write_text("a file where the folder should be")
    with pytest.raises(AssertionError, match=r"image, mean relative error: 0\.01(.|\n)*page: none \(expected to write"):
        assert_renderers_agree(flat(8), TWO, [Wrong(image=lambda x: x * 1.01)], **WIDE)


FOREIGN = """
    import torch
    from mitsvbrdf.material.maps import flat
    from mitsvbrdf.testing import assert_matches_golden

    def test_picture():
        assert_matches_golden(torch.full((4, 5, 3), {grey}), "grey")

    def test_views():
        assert_matches_golden(torch.rand({shape}, generator=torch.Generator().manual_seed(0)), "views")

    def test_maps():
        assert_matches_golden(flat(4, roughness={roughness}), "maps")
"""


class Suite:
    """A tiny test suite of somebody else, and where its golden files and pages go."""

    def __init__(self, pytester):
        self.pytester, self.folder = pytester, pytester.path
        self.golden, self.report = self.folder / "golden" / "test_foreign", self.folder / ".mitsvbrdf-report"

    def write(self, grey=0.5, shape=(2, 4, 4, 3), roughness=0.5):
        self.pytester.makepyfile(test_foreign=FOREIGN.format(grey=grey, shape=shape, roughness=roughness))
        return self

    def run(self, *options, **outcomes):
        done = self.pytester.runpytest("-p", PLUGIN, "-p", "no:cacheprovider", *options)
        done.assert_outcomes(**outcomes)
        return done.stdout.str()

    def kept(self):
        return {path.name: path.read_bytes() for path in self.golden.iterdir()}


@pytest.fixture
def loaded():
    """Mitsuba and the lazy modules of Dr.Jit, loaded for good.

    After each run ``pytester`` makes Python forget what has been loaded meanwhile, and neither survives being loaded twice.
    Lazy modules load when first asked for anything, as a failing test asks every module.
    """
    make_renderer("mitsuba-scene").render(flat(2), TWO)
    for module in list(sys.modules.values()):
        hasattr(module, "__file__")


@pytest.fixture
def suite(loaded, pytester, monkeypatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # no plugins but ours, whatever is installed here
    return Suite(pytester).write()


@pytest.fixture
def accepted(suite):
    suite.run("--mitsvbrdf-update", passed=3)
    return suite


def test_a_missing_golden_file_fails_with_the_way_out(suite):
    said = suite.run(failed=3)
    assert "grey has no golden file yet" in said
    assert "to accept it: pytest --mitsvbrdf-update test_foreign.py::test_picture" in said
    assert not suite.golden.exists()
    (page_,) = suite.report.glob("*-grey.html")
    assert f"page: {page_}" in said and page_.read_text().count("data:image/png") == 1
    assert [p.name for p in suite.report.glob("*-grey.exr")] == [page_.name.replace(".html", ".exr")]
    assert (suite.report / ".gitignore").read_text() == "*\n"


def test_accepted_results_match_and_are_plain_exr_files(accepted):
    assert sorted(accepted.kept()) == ["grey.exr", "maps.exr", "views.exr"]
    accepted.run(passed=3)
    assert not accepted.report.exists()
    picture = OpenEXR.File(str(accepted.golden / "grey.exr")).channels()["RGB"].pixels
    assert picture.shape == (4, 5, 3) and picture.dtype == np.float32 and (picture == 0.5).all()
    views = OpenEXR.File(str(accepted.golden / "views.exr"), separate_channels=True).channels()
    expected = torch.rand(2, 4, 4, 3, generator=torch.Generator().manual_seed(0)).numpy()
    assert np.array_equal(views["view001.G"].pixels, expected[1, ..., 1])
    maps = OpenEXR.File(str(accepted.golden / "maps.exr"), separate_channels=True).channels()
    assert len(maps) == 10 and (maps["normal.B"].pixels == 1).all() and (maps["roughness.Y"].pixels == 0.5).all()


def test_a_changed_result_fails_and_touches_no_golden_file(accepted):
    before = accepted.kept()
    said = accepted.write(grey=0.501, roughness=0.49).run("--mitsvbrdf-report", "pages", failed=2, passed=1)
    assert accepted.kept() == before
    assert "largest difference, in tolerances: 19.6, limit 1" in said  # 0.001 / (1e-6 + 1e-4 / 2)
    assert "60 of 60 values are off, worst at (row, column, channel) (0, 0, 0): 0.501, golden 0.5" in said
    assert "roughness: largest difference, in tolerances: 196" in said and "diffuse: largest" not in said
    pages = sorted((accepted.folder / "pages").glob("*.html"))
    assert len(pages) == 2 and not accepted.report.exists()
    assert pages[1].read_text().count("data:image/png") == 4 and pages[0].read_text().count("data:image/png") == 16
    (fresh,) = (accepted.folder / "pages").glob("*grey.exr")
    assert (OpenEXR.File(str(fresh)).channels()["RGB"].pixels == np.float32(0.501)).all()


def test_updating_replaces_what_changed_alone(accepted):
    before = accepted.kept()
    said = accepted.write(grey=0.6, roughness=0.5 + 1e-6).run("--mitsvbrdf-update", passed=3)
    assert said.count("mitsvbrdf: wrote") == 1 and f"mitsvbrdf: wrote {accepted.golden / 'grey.exr'}" in said
    after = accepted.kept()
    assert after["grey.exr"] != before["grey.exr"] and after["maps.exr"] == before["maps.exr"]
    accepted.run(passed=3)


def test_another_shape_is_told(accepted):
    said = accepted.write(shape=(1, 4, 4, 3)).run("-k", "views", failed=1, deselected=2)
    assert "views has another shape than its golden file: view000 4 x 4 x 3 instead of view000 4 x 4 x 3, view001" in said


def test_update_where_nothing_can_be_written_says_so(suite):
    suite.golden.parent.write_text("a file where the folder should be")
    said = suite.run("--mitsvbrdf-update", failed=3)
    assert "OutputError: expected to write" in said and "wrote" not in said
    assert [p.name for p in suite.folder.iterdir() if "golden" in p.name] == ["golden"]


def test_a_report_that_cannot_be_written_does_not_hide_what_changed(accepted):
    accepted.report.write_text("a file where the folder should be")
    said = accepted.write(grey=0.501).run(failed=1, passed=2)
    assert "grey does not match its golden file" in said
    assert "new result: none (expected to write" in said and "page: none (expected to write" in said


def test_a_spoilt_golden_file_is_an_error_not_a_match(accepted):
    (accepted.golden / "grey.exr").write_bytes(b"half a file")
    assert "expected a golden EXR file" in accepted.run("-k", "picture", failed=1, deselected=2)


@pytest.mark.parametrize("channels", [("R", "B"), ("G",), ("normal.R", "normal.G")])
def test_a_golden_file_without_all_channels_is_an_error_until_it_is_replaced(accepted, channels):
    import OpenEXR

    part = {name: torch.zeros(4, 4).numpy() for name in channels}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, part).write(str(accepted.golden / "grey.exr"))
    said = accepted.run("-k", "picture", failed=1, deselected=2)
    assert "expected a golden EXR file" in said and f"channels {sorted(channels)}" in said
    accepted.run("-k", "picture", "--mitsvbrdf-update", passed=1, deselected=2)
    accepted.run(passed=3)


@pytest.mark.parametrize("second", ["same", "Same"])  # some file systems know no capitals
def test_a_name_used_twice_is_an_error(suite, second):
    suite.pytester.makepyfile(test_foreign=f"""
        import pytest, torch
        from mitsvbrdf.testing import assert_matches_golden

        @pytest.mark.parametrize("name", ["same", "{second}"])
        def test_one(name):
            assert_matches_golden(torch.zeros(2, 2, 3), name)
    """)
    said = suite.run("--mitsvbrdf-update", passed=1, failed=1)
    assert "each golden name once in a run" in said and "put the parameters of the test into the name" in said


def test_a_test_that_is_repeated_may_use_its_name_again(suite):
    suite.pytester.makeconftest("""
        from _pytest.runner import runtestprotocol

        def pytest_runtest_protocol(item, nextitem):
            runtestprotocol(item, nextitem=nextitem, log=False)  # as pytest-rerunfailures does
            return None
    """)
    suite.run("--mitsvbrdf-update", passed=3)
    suite.run(passed=3)


def test_the_suite_of_the_docs(suite):
    (block,) = re.findall(r"^## A first suite\n(?:.+\n)+\n((?:(?:    .*)?\n)+)", (ROOT / "docs/testing.md").read_text(), re.M)
    suite.pytester.makepyfile(test_foreign=block)
    suite.run(failed=1, passed=2)
    suite.run("--mitsvbrdf-update", passed=3)
    assert sorted(suite.kept()) == ["maps.exr", "views.exr"]
    suite.run(passed=3)


def test_flip_may_decide_alone(suite):
    for value, outcome in ((0.5, "passed"), (0.505, "passed"), (0.7, "failed")):
        suite.pytester.makepyfile(test_foreign=f"""
            import math, torch
            from mitsvbrdf.testing import assert_matches_golden

            def test_look():
                assert_matches_golden(torch.full((8, 8, 3), {value}), "look", rtol=math.inf, flip=0.05)
        """)
        said = suite.run(*(["--mitsvbrdf-update"] if value == 0.5 else []), **{outcome: 1})
    assert "mean FLIP error: 0." in said and "limit 0.05" in said


@pytest.mark.parametrize("result, name, error, said", [
    (torch.zeros(4, 4), "a", MapsError, "H x W x 3"),
    (torch.zeros(0, 4, 4, 3), "a", MapsError, "H x W x 3"),
    (torch.full((4, 4, 3), math.nan), "a", AssertionError, "not finite"),
    (torch.zeros(4, 4, 3), "../a", ConfigError, "file name"),
    (torch.zeros(4, 4, 3), "", ConfigError, "file name"), (torch.zeros(4, 4, 3), "n" * 101, ConfigError, "100 at most")])
def test_results_and_names_that_cannot_be_golden(result, name, error, said, report):
    with pytest.raises(error, match=said):
        assert_matches_golden(result, name)


def test_golden_files_need_a_running_test():
    with running.running(running.Caller("", None, running.Run())), pytest.raises(ConfigError, match="pytest plugin"):
        assert_matches_golden(torch.zeros(4, 4, 3), "a")


def test_the_plugin_is_light(tmp_path):
    # In a process of its own: a suite that asks for none of it pays for neither torch nor Mitsuba.
    (tmp_path / "test_alone.py").write_text("""
import sys

def test_light(request):
    assert request.config.pluginmanager.has_plugin("mitsvbrdf.testing.plugin")
    assert not {"torch", "mitsuba", "drjit", "cv2", "matplotlib", "numpy"} & set(sys.modules)
""")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", PLUGIN, "-p", "no:cacheprovider", "."], cwd=tmp_path,
                          env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_entry_point_and_the_module_are_one_plugin(suite):
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["pytest11"]
    assert declared == {PLUGIN: PLUGIN}
    assert importlib.import_module(PLUGIN).pytest_addoption
    suite.pytester.makeconftest(f"pytest_plugins = ['{PLUGIN}']")
    suite.run(failed=3)  # -p and conftest together


def noisy(seed, bias=1.0, side=16, passes=16):
    """Passes of a picture with normal noise, and what it should be: 5 % noise in their mean."""
    g = torch.Generator().manual_seed(seed)
    truth = torch.rand(side, side, 3, generator=g, dtype=torch.float64) + 0.5
    return bias * (truth + 0.05 * passes**0.5 * torch.randn(passes, side, side, 3, generator=g, dtype=torch.float64)), truth


@pytest.mark.parametrize("known_variance", [False, True])
def test_noise_alone_fails_as_often_as_stated(known_variance):
    failed = 0
    for seed in range(300):
        passes, truth = noisy(seed, passes=1 if known_variance else 16)
        spread = torch.full_like(truth, 0.05**2) if known_variance else passes
        failed += not z_test(passes.mean(dim=0), spread, truth, significance=0.1).passed
    assert 15 <= failed <= 48  # 30 expected; the binomial distribution leaves this range once in 600 times


def test_a_bias_of_two_percent_hides_in_each_pixel_but_not_in_all():
    for seed in range(50):
        passes, truth = noisy(seed, bias=1.02)
        found = z_test(passes.mean(dim=0), passes, truth)
        assert not found.passed and (found.bias > found.bias_limit).all()
        assert found.outside <= 2 / truth.numel()


def test_one_wrong_pixel_is_found_unless_outliers_are_allowed():
    passes, truth = noisy(0)
    passes[:, 3, 4] += 1.0
    found = z_test(passes.mean(dim=0), passes, truth)
    assert found.outside == 3 / truth.numel() and not found.passed
    assert not z_test(passes.mean(dim=0), passes, truth, outliers=2 / truth.numel()).passed
    assert z_test(passes.mean(dim=0), passes, truth, outliers=3 / truth.numel()).passed


def test_noise_of_the_reference_counts_too():
    image, truth = noisy(1, passes=1)
    other, _ = noisy(2, passes=1)
    variance = torch.full_like(truth, 0.05**2)
    off = noisy(1)[1] + (other[0] - noisy(2)[1]) * 3  # noise three times as strong
    assert not z_test(image[0], variance, off).passed
    assert z_test(image[0], variance, off, reference_variance=9 * variance).passed


def test_limits_and_scores_against_mpmath():
    found = z_test(torch.zeros(5, 7, 3), torch.ones(5, 7, 3), torch.zeros(5, 7, 3), significance=0.02)
    for limit, count in ((found.z_limit, 105), (found.bias_limit, 3)):
        in_all = (1 - mpmath.erfc(limit / mpmath.sqrt(2))) ** count
        assert float(in_all**2) == pytest.approx(0.98, rel=1e-9)
    for degrees, t in ((7, 4.0), (15, 6.0), (63, 6.0)):
        score = float(_normal_score(torch.tensor(-t, dtype=torch.float64), degrees))
        tail = mpmath.betainc(degrees / 2, 0.5, 0, degrees / (degrees + t**2), regularized=True)
        assert score < 0 and float(mpmath.erfc(-score / mpmath.sqrt(2)) / tail) == pytest.approx(1, abs=0.05)


def test_what_is_exactly_equal_or_not_a_number():
    one, nothing = torch.ones(4, 4, 3), torch.zeros(4, 4, 3)
    assert z_test(one, nothing, one * (1 + 1e-6)).passed  # no noise, and no more than rounding apart
    assert not z_test(one, nothing, one * 1.001).passed
    found = z_test(torch.where(torch.arange(48).reshape(4, 4, 3) == 7, torch.nan, one), one, one)
    assert not found.passed and found.outside == 1 / 48


@pytest.mark.parametrize("image, spread, error", [
    (torch.zeros(4, 4, 3), torch.zeros(5, 4, 3), MapsError), (torch.zeros(4, 4, 3), torch.zeros(7, 4, 4, 3), MapsError),
    (torch.ones(4, 4, 3), torch.zeros(16, 4, 4, 3), MapsError)])
def test_pictures_that_do_not_belong_together(image, spread, error):
    with pytest.raises(error):
        z_test(image, spread, torch.zeros(4, 4, 3))


@pytest.mark.parametrize("bad", [-1e-9, math.nan, math.inf])
def test_variances_that_are_none(bad):
    one = torch.ones(4, 4, 3)
    spoilt = torch.where(torch.arange(48).reshape(4, 4, 3) == 7, bad, one)
    for given in ({"variance_or_passes": spoilt}, {"reference_variance": bad}, {"reference_variance": spoilt}):
        with pytest.raises(MapsError, match="finite and not below 0"):
            z_test(one, reference=one, **{"variance_or_passes": one} | given)


@pytest.mark.parametrize("share", [-0.1, 1.0, math.nan])
def test_shares_of_outliers_that_are_none(share):
    one = torch.ones(4, 4, 3)
    with pytest.raises(ConfigError, match="outliers"):
        z_test(one, one, one, outliers=share)


def test_a_failed_z_test_says_what_and_where(report):
    passes, truth = noisy(0, bias=1.02)
    with pytest.raises(AssertionError, match=r"mean of channel 0, standard(.|\n)*mean of the image 1\.0") as told:
        assert_z_test(passes.mean(dim=0), passes, truth)
    (path,) = report.glob("*.html")
    assert f"page: {path}" in str(told.value) and path.read_text().count("data:image/png") == 5
    passes, truth = noisy(0)
    assert_z_test(passes.mean(dim=0), passes, truth)


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    """Passes of a path-traced preview: a material as we export it, under any light; passes x R x R x 3."""
    from mitsvbrdf.render.llvm import mitsuba_module

    mi = mitsuba_module()

    def trace(maps, light, passes, spp, first_seed=0):
        folder = tmp_path_factory.mktemp("scene")
        write_scene(folder, maps, nine_view_grid())
        resolution, at = maps.resolution, mi.ScalarTransform4f()
        film = {"type": "hdrfilm", "width": resolution, "height": resolution, "pixel_format": "rgb",
                "component_format": "float32", "rfilter": {"type": "box"}}
        scene = mi.load_dict({
            "type": "scene", "integrator": {"type": "path", "max_depth": 3},
            "sensor": {"type": "perspective", "fov": 28.0, "to_world": at.look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
                       "film": film, "sampler": {"type": "independent"}},
            "light": light(mi, at), "patch": {"type": "rectangle", "to_world": at.scale(0.5),
                                              "bsdf": mi.load_file(str(folder / "scene.xml")).shapes()[0].bsdf()}})
        return torch.stack([torch.from_numpy(np.array(mi.render(scene, spp=spp, seed=first_seed + k))) for k in range(passes)])

    return trace


def white_sky(mi, at):
    return {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}


def lamp(mi, at):
    place = at.look_at([0.4, 0.3, 1.0], [0, 0, 0], [0, 1, 0]) @ at.scale(0.25)
    return {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5.0}}}


def test_a_diffuse_patch_under_a_white_sky_has_the_radiance_of_its_albedo(traced):
    passes = traced(flat(16, diffuse=0.6, specular=0.0), white_sky, passes=16, spp=4)
    albedo = torch.full((16, 16, 3), 0.6)
    assert z_test(passes.mean(dim=0), passes, albedo).passed
    assert not z_test(1.02 * passes.mean(dim=0), 1.02 * passes, albedo).passed


def test_a_patch_under_an_area_light_is_what_many_samples_make_of_it(traced):
    # Measured over 200 seeds: 1 % of the previews fail as they are, and all when 2 % brighter.
    leather = make_material("leather", 24)
    passes, many = traced(leather, lamp, passes=16, spp=4), traced(leather, lamp, passes=16, spp=512, first_seed=100)
    reference, variance = many.mean(dim=0), many.var(dim=0) / 16
    assert z_test(passes.mean(dim=0), passes, reference, reference_variance=variance).passed
    assert not z_test(1.02 * passes.mean(dim=0), 1.02 * passes, reference, reference_variance=variance).passed
