"""`fit --detail gan` writes plausible detail beside unchanged maps, says so, and other commands take it."""

import json

import pytest
from helpers.fit_pages import Page

from mitsvbrdf import cli
from mitsvbrdf.fit.generator.detail import DetailTraining
from mitsvbrdf.io import images
from mitsvbrdf.material.map_files import load_maps

QUICK = ["--method", "direct", "--renderer", "analytic", "--iterations", "4", "--resolution", "32",
         "--detail-steps", "3"]


@pytest.fixture(scope="module")
def folders(shots, tmp_path_factory):
    out = tmp_path_factory.mktemp("detail")
    assert cli.main(["fit", str(shots), "-o", str(out / "plain"), *QUICK]) == 0
    assert cli.main(["fit", str(shots), "-o", str(out / "finished"), *QUICK, "--detail", "gan"]) == 0
    return out


@pytest.mark.slow
def test_plausible_detail_lies_beside_maps_of_the_same_bytes(folders):
    plain, finished = folders / "plain", folders / "finished"
    names = sorted(path.name for path in (plain / "maps").iterdir())
    assert names == sorted(path.name for path in (finished / "detail").iterdir())
    assert not (plain / "detail").exists()
    for name in names:
        assert (plain / "maps" / name).read_bytes() == (finished / "maps" / name).read_bytes()
    assert (plain / "maps/roughness.exr").read_bytes() != (finished / "detail/roughness.exr").read_bytes()
    record = json.loads((finished / "fit.json").read_text())
    finish = record["detail"]
    assert finish["steps"] == 3 and finish["what"].startswith("detail/ is one plausible draw") and finish[
        "seconds"] > 0
    assert "detail" not in json.loads((plain / "fit.json").read_text())


@pytest.mark.slow
def test_pages_say_which_they_show(folders):
    page, look = Page(folders / "finished/report.html"), Page(folders / "finished/detail.html")
    assert "detail.html" in page.addresses and "Live view of the maps" in page.text
    assert "Maps with plausible detail" in look.text and "one plausible draw" in look.text
    assert "report.html" in look.addresses
    assert not (folders / "plain/detail.html").exists() and "detail.html" not in Page(
        folders / "plain/report.html").addresses


@pytest.mark.slow
def test_commands_take_plausible_detail_as_they_take_maps(folders, shots, tmp_path, capsys):
    look = folders / "finished/detail"
    assert cli.main(["render", str(look), "--views", str(shots), "-o", str(tmp_path / "r"), "--renderer",
                     "analytic"]) == 0
    assert "finished-detail" in capsys.readouterr().out
    figures = tmp_path / "e.json"
    assert cli.main(["evaluate", str(look), "--capture", str(shots), "--renderer", "analytic", "--json",
                     str(figures)]) == 0
    told = json.loads((folders / "finished/fit.json").read_text())["detail"]["rerender_rmse"]
    # 48 px photos against maps of 32 px: near what the fit told of 32 px photos, and not what the maps have
    assert json.loads(figures.read_text())["rerender_rmse"] == pytest.approx(told, rel=0.3)
    assert images.read_image(tmp_path / "r/00.exr", ValueError).shape[2] == 3
    assert load_maps(folders / "finished").maps.keys() == load_maps(look).maps.keys()


@pytest.mark.slow
def test_a_whole_fit_resumes_into_its_detail(folders, shots, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["fit", str(shots), "-o", str(out), *QUICK]) == 0
    before = (out / "maps/diffuse.exr").read_bytes()
    capsys.readouterr()
    assert cli.main(["fit", str(shots), "-o", str(out), *QUICK, "--detail", "gan", "--resume"]) == 0
    assert "nothing was left to do" in capsys.readouterr().out
    assert (out / "maps/diffuse.exr").read_bytes() == before
    assert (out / "detail/roughness.exr").read_bytes() == (
        folders / "finished/detail/roughness.exr").read_bytes()


def test_ctrl_c_during_plausible_detail_keeps_the_maps(shots, tmp_path, monkeypatch, capsys):
    import signal

    step = DetailTraining.step

    def interrupted(self, progress):
        signal.raise_signal(signal.SIGINT)
        return step(self, progress)

    monkeypatch.setattr(DetailTraining, "step", interrupted)
    out = tmp_path / "out"
    assert cli.main(["fit", str(shots), "-o", str(out), *QUICK, "--detail", "gan"]) == 0
    assert "without plausible detail" in capsys.readouterr().out
    assert (out / "maps/diffuse.exr").is_file() and not (out / "detail").exists() and not (
        out / "detail.html").exists()
    assert "detail" not in json.loads((out / "fit.json").read_text())


def test_explain_says_what_was_not_asked_for(shots, tmp_path, capsys):
    for options, told in (([], True), (["--detail", "gan"], False)):
        assert cli.main(["fit", str(shots), "-o", str(tmp_path / "out"), "--explain", *QUICK, *options]) == 0
        assert ("omitted: plausible detail (not asked for)" in capsys.readouterr().out) == told
