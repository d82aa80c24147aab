"""Golden files in somebody else's test suite."""

import math
import re

import numpy as np
import OpenEXR
import pytest
import torch
from helpers import ROOT
from helpers.golden_suite import PLUGIN

from mitsvbrdf.errors import ConfigError, MapsError
from mitsvbrdf.testing import assert_matches_golden, running


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
    assert len(maps) == 10 and (maps["normal.B"].pixels == 1).all() and (
        maps["roughness.Y"].pixels == 0.5).all()


def test_a_changed_result_fails_and_touches_no_golden_file(accepted):
    before = accepted.kept()
    said = accepted.write(grey=0.501, roughness=0.49).run("--mitsvbrdf-report", "pages", failed=2, passed=1)
    assert accepted.kept() == before
    assert "largest difference, in tolerances: 19.6, limit 1" in said  # 0.001 / (1e-6 + 1e-4 / 2)
    assert "60 of 60 values are off, worst at (row, column, channel) (0, 0, 0): 0.501, golden 0.5" in said
    assert "roughness: largest difference, in tolerances: 196" in said and "diffuse: largest" not in said
    pages = sorted((accepted.folder / "pages").glob("*.html"))
    assert len(pages) == 2 and not accepted.report.exists()
    assert [page.read_text().count("data:image/png") for page in pages] == [12, 3]
    (fresh,) = (accepted.folder / "pages").glob("*grey.exr")
    assert (OpenEXR.File(str(fresh)).channels()["RGB"].pixels == np.float32(0.501)).all()


def test_updating_replaces_what_changed_alone(accepted):
    before = accepted.kept()
    said = accepted.write(grey=0.6, roughness=0.5 + 1e-6).run("--mitsvbrdf-update", passed=3)
    assert said.count("mitsvbrdf: wrote") == 1 and f"mitsvbrdf: wrote {accepted.golden / 'grey.exr'}" in said
    after = accepted.kept()
    assert after["grey.exr"] != before["grey.exr"] and after["maps.exr"] == before["maps.exr"]
    accepted.run(passed=3)


@pytest.mark.slow
def test_workers_of_xdist_name_what_they_wrote(suite):
    said = suite.pytester.runpytest_subprocess("-p", "xdist.plugin", "-n", "1", "-p", PLUGIN,
                                               "--mitsvbrdf-update").stdout.str()
    assert sorted(re.findall(r"mitsvbrdf: wrote .*/(.*)", said)) == sorted(suite.kept())


def test_another_shape_is_told(accepted):
    said = accepted.write(shape=(1, 4, 4, 3)).run("-k", "views", failed=1, deselected=2)
    told = "another shape than its golden file: view000 4 x 4 x 3 instead of view000 4 x 4 x 3, view001"
    assert told in said


def test_update_where_nothing_can_be_written_says_so(suite):
    suite.golden.parent.write_text("a file where the folder should be")
    said = suite.run("--mitsvbrdf-update", failed=3)
    assert "OutputError: expected to write" in said and "mitsvbrdf: wrote" not in said
    assert [p.name for p in suite.folder.iterdir() if "golden" in p.name] == ["golden"]


def test_a_spoilt_golden_file_is_an_error_not_a_match(accepted):
    (accepted.golden / "grey.exr").write_bytes(b"half a file")
    assert "expected a golden EXR file" in accepted.run("-k", "picture", failed=1, deselected=2)
    picture = {"RGB": np.full((4, 5, 3), math.nan, np.float32)}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, picture).write(str(accepted.golden / "grey.exr"))
    assert "60 of 60 values are off" in accepted.run("-k", "picture", failed=1, deselected=2)


@pytest.mark.parametrize("channels", [("R", "B"), ("G",), ("normal.R", "normal.G")])
def test_a_golden_file_without_all_channels_is_an_error(accepted, channels):
    part = {name: torch.zeros(4, 4).numpy() for name in channels}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, part).write(str(accepted.golden / "grey.exr"))
    assert "expected a golden EXR file" in accepted.run("-k", "picture", failed=1, deselected=2)


def test_the_suite_of_the_docs(suite):
    (block,) = re.findall(r"^## A first suite\n(?:.+\n)+\n((?:(?:    .*)?\n)+)",
                          (ROOT / "docs/testing.md").read_text(), re.M)
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
    (torch.zeros(4, 4), "a", MapsError, "H x W x 3"), (torch.zeros(0, 4, 4, 3), "a", MapsError, "H x W x 3"),
    (torch.full((4, 4, 3), math.nan), "a", AssertionError, "finite"),
    *((torch.zeros(4, 4, 3), name, ConfigError, "100 at most") for name in ("../a", "", "n" * 101))])
def test_results_and_names_that_cannot_be_golden(result, name, error, said, report):
    with pytest.raises(error, match=said):
        assert_matches_golden(result, name)


@pytest.mark.parametrize("rtol, atol, flip", [(math.inf, 0, 1), (0, math.inf, 1), (math.nan, 0, 1),
                                              (-1, 0, 1), (0, -1, 1), (math.inf, 0, math.nan), (0, 0, -1)])
def test_a_comparison_that_cannot_fail_or_cannot_pass_is_refused(rtol, atol, flip, report):
    with pytest.raises(ConfigError, match="everything matches"):
        assert_matches_golden(torch.zeros(4, 4, 3), "a", rtol=rtol, atol=atol, flip=flip)


def test_golden_files_need_a_running_test(monkeypatch):
    monkeypatch.setattr(running, "now", running.Running())
    with pytest.raises(ConfigError, match="pytest plugin"):
        assert_matches_golden(torch.zeros(4, 4, 3), "a")
