"""The page of a fit: its numbers are those of the records, its pictures those of the files."""

import json
import re
from dataclasses import replace

import numpy as np
import PIL.Image
import pytest
from helpers import ANALYTIC, ROOT
from helpers.fit_pages import HOSTILE, SIDE, Page
from helpers.tables import words_at_the_right

from mitsvbrdf import cli
from mitsvbrdf.capture import read_capture
from mitsvbrdf.fit import DirectConfig, fit_svbrdf
from mitsvbrdf.io import images
from mitsvbrdf.report.fit_page import write_report
from mitsvbrdf.report.folder import write_fit
from mitsvbrdf.report.page import figure


def shown(path):
    return np.asarray(PIL.Image.open(path).convert("RGB"))


def test_fit_writes_the_page_with_photos_left_out_as_evaluate_finds_them(fitted, photos, tmp_path):
    record, page = json.loads((fitted / "report.json").read_text()), Page(fitted / "report.html")
    assert [(photo["name"], photo["held_out"]) for photo in record["photos"]] == [
        ("00", False), ("01", False), ("03", False), ("02", True), ("04", True)]
    found = tmp_path / "e.json"
    assert cli.main(["evaluate", str(fitted), "--capture", str(photos), "--views", "2,4", "--renderer",
                     "analytic", "--json", str(found)]) == 0
    found = json.loads(found.read_text())
    for photo in record["photos"][3:]:
        assert photo["rmse"] == pytest.approx(found["per_photo"][photo["name"]], rel=1e-6)
        assert f"Photo {photo['name']} · RMSE {photo['rmse']:.4f} · held out" in page.text
    assert record["held_out_rmse"] == pytest.approx(found["rerender_rmse"], rel=1e-6)
    assert f"RMSE of 2 held-out photos {record['held_out_rmse']:.4f}" in page.text
    assert record["quick"] and "checks and times all renderers" in page.text
    assert not words_at_the_right(page.source)


def test_every_number_of_the_records_is_on_the_page(measured):
    _, fit, record, page = measured
    assert f"re-rendering RMSE {fit['rerender_rmse']:.4f}" in page.text
    for name, error in fit["per_photo"].items():
        assert f"Photo {name} · RMSE {error:.4f}" in page.text
    for sure in fit["confidence"].values():
        assert f"{100 * sure['determined_share']:.0f} % determined, ±{sure['median_sd']:.3f}" in page.text
    for name, values in record["maps"].items():
        if name != "normal":
            low, high, mean = (figure(values[what]) for what in ("low", "high", "mean"))
            assert f"{low} to {high}, mean {mean}" in page.text
    for item in fit["omitted"]:
        assert page.row(item["what"]) == [item["why"]]
    for name in ("photometric", "smooth", "flat"):
        first, *_, last = (figure(row[name]) for row in fit["trace"] if name in row)
        assert re.search(f'aria-label="Losses against seconds: [^"]*{name} from {first} to {last}',
                         page.source)
    for name, share in fit["burn_in"].items():
        assert re.search(rf"{name} {share:.3f}", page.text)
    for name in ("config", "command", "versions", "machine"):
        for key, value in fit[name].items():
            text = ({None: "–", True: "yes", False: "no"}.get(value)
                    if value is None or isinstance(value, bool) else str(value))
            text = "–" if value == [] else text
            assert f"{key} {text}" in page.text, key
    for name, camera, light in zip(fit["per_photo"], fit["views"]["camera"], fit["views"]["light"]):
        assert page.row(name)[:6] == [figure(x) for x in camera + light]


def test_pictures_are_those_of_the_files(fitted):
    page, record = Page(fitted / "report.html"), json.loads((fitted / "report.json").read_text())
    for photo in record["photos"]:
        taken, again = shown(fitted / photo["photo"]), shown(fitted / photo["rerendered"])
        how = "predicted" if photo["held_out"] else "re-rendered"
        assert photo["rerendered"].startswith("predicted/" if photo["held_out"] else "rerendered/")
        assert np.array_equal(page.pixels(f"photo {photo['name']}"), taken)
        assert np.array_equal(page.pixels(f"photo {photo['name']}, {how}"), again)
        difference = np.clip(4 * np.abs(taken.astype(int) - again), 0, 255)
        drawn = page.pixels(f"photo {photo['name']}, difference times 4").astype(int)
        assert np.abs(drawn - difference).max() <= 1
    # our PNG files hold what is shown, in 16 bits
    for name in ("diffuse", "specular", "roughness", "normal"):
        stored = images.read_image(fitted / "maps" / f"{name}.png", ValueError).expand(SIDE, SIDE, 3).numpy()
        assert np.abs(page.pixels(name.capitalize()) - 255 * stored).max() < 0.51
        spread = images.read_image(fitted / "uncertainty" / f"{name}.exr", ValueError)[..., 0].numpy()
        # Magma becomes brighter all the way: texels have the same order by brightness as by deviation.
        brightness = (page.pixels(f"{name.capitalize()}: standard deviation").astype(float)
                      @ (0.2126, 0.7152, 0.0722))
        ranks = [np.searchsorted(np.sort(x.ravel()), x.ravel()) for x in (spread.astype(float), brightness)]
        assert np.corrcoef(ranks)[0, 1] > 0.98
    assert page.pixels("Guessed diffuse").shape == (SIDE, SIDE, 3)


def test_the_page_asks_nothing_of_the_network_and_escapes_names(measured):
    _, fit, _, page = measured
    assert page.addresses and all(address.startswith(("data:", "#")) for address in page.addresses)
    assert {address[1:] for address in page.addresses if address[0] == "#"} <= set(page.ids)
    styles = "".join(re.findall(r"<style.*?>(.*?)</style>", page.source, re.S))
    assert "url(" not in styles and "@import" not in styles
    assert "<img src=x" not in page.source and HOSTILE in page.text


@pytest.mark.parametrize("options, words", [
    (["--bsdf", "principled"], ["Base colour", "Metallic", "as principled"]),
    pytest.param(["--fix", "normal=flat", "--fix", "roughness=0.5"], ["held fixed", "gradient of roughness"],
                 marks=pytest.mark.slow),
    pytest.param(["--method", "direct", "--budget", "0.001"], ["ended budget"], marks=pytest.mark.slow),
    pytest.param(["--method", "hybrid", "--width", "8"], ["adversarial"], marks=pytest.mark.slow)])
def test_kinds_of_fits(options, words, photos, tmp_path):
    out = tmp_path / "out"
    limit = [] if "--budget" in options else ["--iterations", "2"]
    assert cli.main(["fit", str(photos), "-o", str(out), "--renderer", "analytic", "--resolution", "16",
                     "--views", "3,0",
                     *(() if "--method" in options else ("--method", "direct")), *limit, *options]) == 0
    page, fit = Page(out / "report.html"), json.loads((out / "fit.json").read_text())
    for word in words:
        assert word in page.text, word
    assert list(fit["per_photo"]) == ["03", "00"]
    assert np.array_equal(page.pixels("photo 03"), shown(out / "photos/03.png"))


def test_what_the_page_says_is_true_of_plain_photos_smooth_maps_and_held_ones(photos, tmp_path, monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)  # another test may have loaded it
    shots, smooth = replace(read_capture(photos), calibration="none"), ("roughness=0.05", "diffuse=0.3")
    write_fit(fit_svbrdf(shots.pick([0, 1]), ANALYTIC, DirectConfig(iterations=1, fix=smooth)),
              shots.pick([0, 1]), tmp_path, held_out=shots.pick([2]))
    page = Page(tmp_path / "report.html")
    assert "predicted from the assumed view" in page.text
    assert "All stated tolerances hold." not in page.text
    assert "rougher texels than there are here" in page.text
    assert "Guessed diffuse" not in page.pictures and "no libLLVM in use" in page.text


def test_the_stage_of_a_fit_is_no_loss(copy):
    record = json.loads((copy / "fit.json").read_text())
    record["trace"] = [{"seconds": float(k), "iteration": k, "stage": 2.0, "rerender_rmse": 0.1}
                       for k in range(399)]
    record["omitted"] = []
    (copy / "fit.json").write_text(json.dumps(record))
    write_report(copy, quick=True)
    page = Page(copy / "report.html")
    assert "Nothing: this fit needed every part." in page.text
    assert 'aria-label="Losses' not in page.source


def test_formats_page_names_every_field(measured):
    page = (ROOT / "docs/formats.md").read_text()
    for field in [*measured[1], *measured[2]]:
        assert f"`{field}`" in page, field
