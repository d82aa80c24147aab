"""The page of a fit: its numbers are those of the records and of independent computations, its pictures those of the files."""

import base64
import io
import json
import math
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import torch
from browser import opened

from mitsvbrdf import cli
from mitsvbrdf.capture import read_capture, write_capture
from mitsvbrdf.errors import OutputError
from mitsvbrdf.fit import DirectConfig, fit_svbrdf
from mitsvbrdf.fit.record import read_fit, read_whole_fit
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps, save_maps
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.measure.gradients import fixed_cotangent
from mitsvbrdf.pages.curves import curves
from mitsvbrdf.pages.page import figure
from mitsvbrdf.pages.pictures import picture_uri
from mitsvbrdf.render import make_renderer
from mitsvbrdf.report import fit_page
from mitsvbrdf.report.checks import fit_report
from mitsvbrdf.report.fit_page import write_report
from mitsvbrdf.report.folder import write_fit
from mitsvbrdf.synth.photograph import photograph
from mitsvbrdf.system import images, result_folder
from mitsvbrdf.views import Views, nine_view_grid

ANALYTIC = make_renderer("analytic")
SIDE = 32
FAST = ["--method", "direct", "--renderer", "analytic", "--iterations", "12", "--resolution", str(SIDE)]
HOSTILE = "a&b <img src=x onerror=alert(1)>"


class Page(HTMLParser):
    """Text, pictures by their alt text, and tables row by row; every tag is closed, no id stands twice."""

    VOID = ("img", "meta", "link", "br", "input")

    def __init__(self, path):
        super().__init__()
        self.source = path.read_text(encoding="utf-8")
        self.pictures, self.rows, self.addresses, self.open, self.texts, self.ids = {}, [], [], [], [], []
        self.feed(self.source)
        assert not self.open, self.open
        assert len(set(self.ids)) == len(self.ids), sorted(self.ids)
        self.text = re.sub(r"\s+", " ", " ".join(self.texts))

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.ids += [attributes["id"]] if "id" in attributes else []
        self.addresses += [attributes[name] for name in ("src", "href", "srcset", "data", "action") if name in attributes]
        if tag == "img" and "src" in attributes:
            self.pictures[attributes["alt"]] = attributes["src"]
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.texts.append(data)
        if self.rows and {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data

    def pixels(self, alt):
        head, data = self.pictures[alt].split(",", 1)
        assert head in ("data:image/png;base64", "data:image/jpeg;base64")
        return np.asarray(PIL.Image.open(io.BytesIO(base64.b64decode(data, validate=True))).convert("RGB"))

    def row(self, name):
        return next(row[1:] for row in self.rows if row and row[0].strip() == name)


def shown(path):
    return np.asarray(PIL.Image.open(path).convert("RGB"))


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Five photos of the inlay in a folder with a hostile name; the flash stands beside the camera."""
    folder, views = tmp_path_factory.mktemp("capture") / HOSTILE, nine_view_grid().pick([0, 1, 3, 5, 7])
    beside = replace(views, light=views.light + torch.tensor([0.05, 0.02, 0.0], dtype=torch.float64))
    write_capture(photograph(make_material("inlay", SIDE), beside, ANALYTIC), folder)
    return folder


@pytest.fixture(scope="module")
def fitted(photos, tmp_path_factory):
    """A fit to photos 0, 1 and 3."""
    out = tmp_path_factory.mktemp("fit") / "out"
    assert cli.main(["fit", str(photos), "-o", str(out), *FAST, "--views", "0,1,3"]) == 0
    return out


@pytest.fixture
def copy(fitted, tmp_path):
    return shutil.copytree(fitted, tmp_path / "out")


@pytest.fixture(scope="module")
def measured(fitted, tmp_path_factory):
    """The same fit after `mitsvbrdf report`: its folder, the two records, and the page."""
    out = shutil.copytree(fitted, tmp_path_factory.mktemp("report") / "out")
    assert cli.main(["report", str(out)]) == 0
    return out, *(json.loads((out / name).read_text()) for name in ("fit.json", "report.json")), Page(out / "report.html")


def test_fit_writes_the_page_with_photos_left_out_as_evaluate_finds_them(fitted, photos, tmp_path):
    record, page = json.loads((fitted / "report.json").read_text()), Page(fitted / "report.html")
    assert [(photo["name"], photo["left_out"]) for photo in record["photos"]] == [
        ("00", False), ("01", False), ("03", False), ("02", True), ("04", True)]
    found = tmp_path / "e.json"
    assert cli.main(["evaluate", str(fitted), "--capture", str(photos), "--views", "2,4", "--renderer", "analytic", "--json",
                     str(found)]) == 0
    found = json.loads(found.read_text())
    for photo in record["photos"][3:]:
        assert photo["rmse"] == pytest.approx(found["per_photo"][photo["name"]], rel=1e-6)
        assert f"Photo {photo['name']} · RMSE {photo['rmse']:.4f} · left out of the fit" in page.text
    assert record["left_out_rmse"] == pytest.approx(found["rerender_rmse"], rel=1e-6)
    assert f"RMSE of 2 photos left out {record['left_out_rmse']:.4f}" in page.text
    assert record["quick"] and record["saved"] is None and "checks and times all renderers" in page.text


def test_the_quick_check_is_the_error_of_the_fits_renderer(fitted):
    record, svbrdf = json.loads((fitted / "report.json").read_text()), load_maps(fitted)
    check = record["crosscheck"]
    views = read_fit(fitted).views.pick([0, 1])
    exact, found = ({}, {})
    for into, name, dtype in ((exact, "analytic64", torch.float64), (found, "analytic", torch.float32)):
        maps = {n: t.to(dtype).clone().requires_grad_() for n, t in svbrdf.maps.items()}
        into["image"] = make_renderer(name).render(SVBRDF(svbrdf.bsdf, maps), views)
        into["image"].backward(fixed_cotangent(into["image"].shape).to(dtype))
        into |= {n: t.grad.double() for n, t in maps.items()}
    image, truth = (part["image"].detach().double() for part in (found, exact))
    errors = (image - truth).abs() / truth.clamp_min(1e-3 * truth.mean())
    (row,) = check["rows"]
    assert check["views"] == ["00", "01"] and check["resolution"] == SIDE and row["renderer"] == "analytic"
    # The same images; of the gradients the row of a renderer without gradients for the image may differ by a rounding.
    assert row["image"]["mean"] == pytest.approx(float(errors.mean()), rel=0.02)
    for name, figures in row["gradients"].items():
        relative = float((found[name] - exact[name]).norm() / exact[name].norm())
        assert figures["relative_l2"] == pytest.approx(relative, rel=0.02)
    assert check["violations"] == []


def test_every_number_of_the_records_is_on_the_page(measured):
    _, fit, record, page = measured
    assert f"re-rendering RMSE {fit['rerender_rmse']:.4f}" in page.text
    for name, error in fit["per_photo"].items():
        assert f"Photo {name} · RMSE {error:.4f}" in page.text
    for sure in fit["confidence"].values():
        assert f"{100 * sure['determined_share']:.0f} % determined, ±{sure['median_sd']:.3f}" in page.text
    for name, values in record["maps"].items():
        if name != "normal":
            assert f"{figure(values['low'])} to {figure(values['high'])}, mean {figure(values['mean'])}" in page.text
    for item in fit["left_out"]:
        assert page.row(item["what"]) == [item["why"]]
    for warning in fit["warnings"]:
        assert warning in page.text
    for name in ("photometric", "smooth", "flat"):
        first, *_, last = (figure(row[name]) for row in fit["trace"] if name in row)
        assert re.search(f'aria-label="Losses against seconds: [^"]*{name} from {first} to {last}', page.source)
    for name, share in fit["burn_in"].items():
        assert re.search(rf"{name} {share:.3f}", page.text)
    for name in ("config", "command", "versions", "machine"):
        for key, value in fit[name].items():
            text = {None: "–", True: "yes", False: "no"}.get(value) if value is None or isinstance(value, bool) else str(value)
            text = "–" if value == [] else text
            assert f"{key} {text}" in page.text, key
    for name, camera, light in zip(fit["per_photo"], fit["views"]["camera"], fit["views"]["light"]):
        assert page.row(name)[:6] == [figure(x) for x in camera + light]
    for entry in fit["trace"]:
        start = [figure(entry["seconds"]), figure(entry["iteration"])]
        assert any(row[:2] == start and all(figure(value) in row for value in entry.values()) for row in page.rows)
    numbers = record["condition"]
    median, worst = ("infinite" if numbers[name] is None else figure(numbers[name]) for name in ("median", "worst"))
    assert f"median {median} worst {worst}" in page.text
    assert f"{numbers['rank']} of {numbers['unknowns']}" in page.text


def test_all_renderers_are_checked_and_what_was_saved_is_timed(measured):
    _, fit, record, page = measured
    assert not record["quick"] and record["crosscheck"]["views"] == list(fit["per_photo"])
    assert {row["renderer"] for row in record["crosscheck"]["rows"]} == {"analytic", "mitsuba", "mitsuba-scene"}
    for row in record["crosscheck"]["rows"]:
        errors = [row["image"][name] for name in ("mean", "p99.9", "worst")]
        cells = page.row(row["renderer"])
        assert cells[:7] == [figure(e) for e in (*errors, *(g["relative_l2"] for g in row["gradients"].values()))]
        assert len(cells) == 9 and all(re.fullmatch(r"[\d.e-]+ m?s", cell) for cell in cells[7:])
    assert record["crosscheck"]["violations"] == [] and "All stated tolerances hold." in page.text
    rows = record["saved"]["rows"]
    assert [row["renderer"] for row in rows] == ["analytic", "analytic"] and rows[-1]["ratio"] == 1
    assert rows[0]["ratio"] == pytest.approx(rows[0]["seconds"]["median"] / rows[1]["seconds"]["median"], rel=1e-12)
    assert rows[0]["difference"] < 5e-6  # what is left out changes nothing but roundings; the two are float32
    assert page.row("everything")[-2:] == [f"{rows[0]['ratio']:.2f}", figure(rows[0]["difference"])]


def test_of_many_photos_some_views_are_checked(monkeypatch):
    # Memory grows with texels and views; nothing is measured worse with 25 of them.
    monkeypatch.setattr("mitsvbrdf.report.checks._available", lambda *_: [])
    names = [f"{k:02d}" for k in range(60)]
    for count, quick, chosen in ((60, False, names[::3]), (25, False, names[:25]), (60, True, names[:2])):
        record = fit_report(make_material("tiles", 8), nine_view_grid().pick([k % 9 for k in range(count)]), ANALYTIC,
                            names=names[:count], transfer="gamma2.2", quick=quick)
        assert record["crosscheck"]["views"] == chosen and (quick or record["saved"]["views"] == len(chosen))


@pytest.mark.slow
def test_the_traced_scene_with_everything_stands_beside_a_mitsuba_fit(photos, tmp_path):
    out = tmp_path / "out"
    options = ["--iterations", "2", "--resolution", "16", "--views", "0,3", "--method", "direct"]
    assert cli.main(["fit", str(photos), "-o", str(out), *options, "--fix", "normal=flat", "--grey-specular"]) == 0
    assert cli.main(["report", str(out)]) == 0
    record, page = json.loads((out / "report.json").read_text()), Page(out / "report.html")
    rows = record["saved"]["rows"]
    assert [row["renderer"] for row in rows] == ["mitsuba-scene", "mitsuba", "mitsuba"]
    assert all(row["difference"] < 1e-4 for row in rows[:2])  # steepest texels of the traced scene in float32: 3e-5 measured
    assert "held fixed" in page.text and "gradient of normal" in page.text


def test_pictures_are_those_of_the_files(fitted):
    page, record = Page(fitted / "report.html"), json.loads((fitted / "report.json").read_text())
    for photo in record["photos"]:
        taken, again = shown(fitted / photo["photo"]), shown(fitted / photo["rerendered"])
        how = "predicted" if photo["left_out"] else "re-rendered"
        assert photo["rerendered"].startswith("predicted/" if photo["left_out"] else "rerendered/")
        assert np.array_equal(page.pixels(f"photo {photo['name']}"), taken)
        assert np.array_equal(page.pixels(f"photo {photo['name']}, {how}"), again)
        difference = np.clip(4 * np.abs(taken.astype(int) - again), 0, 255)
        assert np.abs(page.pixels(f"photo {photo['name']}, difference times 4").astype(int) - difference).max() <= 1
    for name in ("diffuse", "specular", "roughness", "normal"):  # our PNG files hold what is shown, in 16 bits
        stored = images.read_image(fitted / "maps" / f"{name}.png", ValueError).expand(SIDE, SIDE, 3).numpy()
        assert np.abs(page.pixels(name.capitalize()) - 255 * stored).max() < 0.51
        spread = images.read_image(fitted / "uncertainty" / f"{name}.exr", ValueError)[..., 0].numpy()
        # Magma is dark at 0 and brighter all the way: the order of the texels' brightness is that of their deviation.
        brightness = page.pixels(f"{name.capitalize()}: standard deviation").astype(float) @ (0.2126, 0.7152, 0.0722)
        assert np.corrcoef(np.argsort(np.argsort(spread.ravel())), np.argsort(np.argsort(brightness.ravel())))[0, 1] > 0.98
    assert page.pixels("Guessed diffuse").shape == (SIDE, SIDE, 3)


def test_the_page_asks_nothing_of_the_network_and_escapes_names(measured):
    _, fit, _, page = measured
    assert page.addresses and all(address.startswith(("data:", "#")) for address in page.addresses)
    assert {address[1:] for address in page.addresses if address[0] == "#"} <= set(page.ids)
    styles = "".join(re.findall(r"<style.*?>(.*?)</style>", page.source, re.S))
    assert "url(" not in styles and "@import" not in styles
    assert "<img src=x" not in page.source and HOSTILE in page.text


def test_a_cost_that_may_rise_is_explained_where_there_is_one(measured, photos, tmp_path):
    assert "All axes are logarithmic" in measured[3].text and "the cost may rise" not in measured[3].text
    assert measured[1]["method"] != "hierarchical"
    assert cli.main(["fit", str(photos), "-o", str(tmp_path / "h"), "--iterations", "2", "--resolution", "16"]) == 0
    assert "the cost may rise" in Page(tmp_path / "h/report.html").text


def test_a_fit_is_not_lost_with_its_page(photos, tmp_path, monkeypatch, capsys):
    def breaks(*_, **__):
        raise RuntimeError("no page today")

    arguments = ["fit", str(photos), "-o", str(tmp_path / "out"), *FAST]
    with monkeypatch.context() as patch:
        patch.setattr("mitsvbrdf.report.folder.write_report", breaks)
        assert cli.main(arguments) == 0
    assert "no page today" in capsys.readouterr().out and not (tmp_path / "out/report.html").exists()
    assert load_maps(tmp_path / "out").resolution == SIDE
    assert cli.main(["report", str(tmp_path / "out"), "--quick"]) == 0 and (tmp_path / "out/report.html").is_file()


def test_the_page_is_made_again_from_the_folder_alone(copy):
    before = json.loads((copy / "report.json").read_text())
    page = Page(copy / "report.html")
    assert cli.main(["report", str(copy), "--quick"]) == 0
    again = json.loads((copy / "report.json").read_text())
    machine = again.pop("machine"), before.pop("machine")  # libLLVM only counts where it was loaded
    assert again == before and machine[0]["cores"] == machine[1]["cores"]
    assert Page(copy / "report.html").pictures == page.pictures


def test_without_photos_the_renderings_are_shown_and_the_capture_brings_them_back(copy, fitted, photos):
    before = json.loads((copy / "report.json").read_text())
    for name in ("photos", "predicted"):
        shutil.rmtree(copy / name)
    for name in ("report.html", "report.json"):
        (copy / name).unlink()
    (copy / "photos").mkdir()
    (copy / "photos/00.png").write_text("mine")  # a file of somebody else, and no photo
    (copy / result_folder.MANIFEST).write_text(json.dumps([n for n in json.loads((copy / result_folder.MANIFEST).read_text())
                                                   if n != "photos/00.png"]))
    (copy / "photos/00.png").rename(copy / "photos/mine")
    assert cli.main(["report", str(copy), "--quick"]) == 0
    page = Page(copy / "report.html")
    assert "were not kept here" in page.text and "photo 00" not in page.pictures
    assert page.pixels("photo 00, re-rendered").shape == (SIDE, SIDE, 3) and "left out of the fit" not in page.text
    (copy / "photos/mine").rename(copy / "photos/00.png")
    assert cli.main(["report", str(copy), "--quick", "--capture", str(photos)]) == 0
    assert json.loads((copy / "report.json").read_text())["photos"] == before["photos"]
    assert Page(copy / "report.html").pictures == Page(fitted / "report.html").pictures
    assert (copy / "photos/00.png.old").read_text() == "mine"
    written = set(json.loads((copy / result_folder.MANIFEST).read_text()))
    assert {"report.html", "report.json", "photos/00.png", "photos/04.png", "predicted/04.png"} <= written


def test_the_next_fit_takes_the_pages_files_away(copy, photos):
    assert cli.main(["report", str(copy), "--quick", "--capture", str(photos)]) == 0
    assert cli.main(["fit", str(photos), "-o", str(copy), *FAST, "--overwrite"]) == 0
    assert not (copy / "predicted").exists() and not list(copy.rglob("*.old"))
    assert "left out of the fit" not in Page(copy / "report.html").text


def test_a_fit_predicts_nine_photos_and_report_all(tmp_path):
    views = nine_view_grid()
    twelve = Views(*(torch.cat((t, t[:3])) for t in (views.camera, views.light, views.intensity)))
    write_capture(photograph(make_material("tiles", 8), twelve, ANALYTIC), tmp_path / "photos")
    options = ["--method", "direct", "--renderer", "analytic", "--iterations", "2", "--resolution", "8", "--views", "11"]
    out = tmp_path / "out"
    assert cli.main(["fit", str(tmp_path / "photos"), "-o", str(out), *options]) == 0
    assert len(list((out / "predicted").glob("*.png"))) == 9
    assert "one photo:" in Page(out / "report.html").text  # a warning
    assert cli.main(["report", str(out), "--quick", "--capture", str(tmp_path / "photos")]) == 0
    record = json.loads((out / "report.json").read_text())
    assert [photo["name"] for photo in record["photos"]] == ["11", *(f"{i:02d}" for i in range(11))]
    assert math.sqrt(np.mean([p["rmse"]**2 for p in record["photos"][1:]])) == pytest.approx(record["left_out_rmse"], rel=1e-9)


@pytest.mark.parametrize("options, words", [
    (["--bsdf", "principled"], ["Base colour", "Metallic", "as principled"]),
    (["--fix", "normal=flat", "--fix", "roughness=0.5"], ["held fixed", "gradient of roughness"]),
    (["--method", "direct", "--budget", "0.001"], ["ended budget"]),
    (["--method", "hybrid", "--width", "8"], ["adversarial"])])
def test_kinds_of_fits(options, words, photos, tmp_path):
    out = tmp_path / "out"
    limit = [] if "--budget" in options else ["--iterations", "2"]
    assert cli.main(["fit", str(photos), "-o", str(out), "--renderer", "analytic", "--resolution", "16", "--views", "3,0",
                     *(() if "--method" in options else ("--method", "direct")), *limit, *options]) == 0
    page, fit = Page(out / "report.html"), json.loads((out / "fit.json").read_text())
    for word in words:
        assert word in page.text, word
    assert list(fit["per_photo"]) == ["03", "00"] and f"Photo 03 · RMSE {fit['per_photo']['03']:.4f}" in page.text
    assert np.array_equal(page.pixels("photo 03"), shown(out / "photos/03.png"))


def test_a_renderer_of_ones_own_is_not_checked(copy):
    record = json.loads((copy / "fit.json").read_text()) | {"renderer": "mine"}
    (copy / "fit.json").write_text(json.dumps(record))
    assert cli.main(["report", str(copy)]) == 0
    found = json.loads((copy / "report.json").read_text())
    assert found["saved"] is None and {row["renderer"] for row in found["crosscheck"]["rows"]} == {
        "mitsuba", "mitsuba-scene", "analytic"}
    assert cli.main(["report", str(copy), "--quick"]) == 0
    assert "was not checked" in Page(copy / "report.html").text


def test_trouble_is_told(copy):
    record = json.loads((copy / "fit.json").read_text())
    record |= {"warnings": ["<b>doubt</b> & more"], "stopped": "interrupted", "undone_steps": 1, "restarts": [
        {"iteration": 70, "reason": "loss above 1.5 times its lowest"}], "undone": [
        {"iteration": 7, "reason": "loss not finite"}], "trace": record["trace"][:1]}
    (copy / "fit.json").write_text(json.dumps(record))
    write_report(copy, quick=True)
    page = Page(copy / "report.html")
    assert "<b>doubt</b> & more" in page.text and "the best maps until then" in page.text
    assert page.row("step undone") == ["7", "loss not finite"]
    assert page.row("back to the lowest loss") == ["70", "loss above 1.5 times its lowest"]
    assert "Nothing was measured after the start." in page.text


def spoil_json(out):
    (out / "fit.json").write_text("{")


def spoil_version(out):
    (out / "fit.json").write_text(json.dumps(json.loads((out / "fit.json").read_text()) | {"schema_version": 2}))


def spoil_kind(out):
    (out / "fit.json").write_text(json.dumps(json.loads((out / "fit.json").read_text()) | {"confidence": {"diffuse": {}}}))


def spoil_names(out):
    (out / "fit.json").write_text(json.dumps(json.loads((out / "fit.json").read_text()) | {"per_photo": {"../../etc": 0.1}}))


def spoil_trace(out):
    (out / "fit.json").write_text(json.dumps(json.loads((out / "fit.json").read_text()) | {"trace": [{"seconds": 1}]}))


def spoil_map(out):
    (out / "maps/normal.exr").unlink()
    (out / "maps/normal.png").unlink()


def spoil_rendering(out):
    (out / "rerendered/01.png").write_text("no picture")


def spoil_photo(out):
    images.write_png(out / "photos/01.png", torch.zeros(8, 8, 3))


@pytest.mark.parametrize("spoil, words", [
    (lambda out: (out / "fit.json").unlink(), ("mitsvbrdf fit", "no fit.json")), (spoil_json, ("fit.json",)),
    (spoil_version, ("schema version 1", "schema_version")), (spoil_kind, ("confidence.diffuse.median_sd",)),
    (spoil_names, ("per_photo",)), (spoil_trace, ("trace",)), (spoil_map, ("normal.exr",)), (spoil_rendering, ("01.png",)),
    (spoil_photo, ("photos/01.png", "--capture"))])
def test_folders_that_are_no_fit_are_refused(spoil, words, copy, capsys):
    spoil(copy)
    before = (copy / "report.html").read_text()
    assert cli.main(["report", str(copy), "--quick"]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and "Traceback" not in message and all(word in message for word in words), message
    assert (copy / "report.html").read_text() == before


def test_photos_of_another_capture_are_refused(copy, photos, tmp_path, capsys):
    shots = read_capture(photos)
    write_capture(replace(shots, photos=shots.photos.flip(2)), tmp_path / "other")
    write_capture(shots.pick([0, 1]), tmp_path / "few")
    write_capture(shots.averaged(16), tmp_path / "small")
    before = sorted(copy.rglob("*"))
    for name, words in (("other", ("photo 00 is another", "give the capture")), ("few", ("photo numbers",)),
                        ("small", ("16 px",)), ("nowhere", ("a folder of photos",))):
        assert cli.main(["report", str(copy), "--quick", "--capture", str(tmp_path / name)]) == 2
        message = capsys.readouterr().err
        assert message.count("error:") == 1 and all(word in message for word in words), message
    assert sorted(copy.rglob("*")) == before
    assert cli.main(["report", str(tmp_path / "nowhere")]) == 2 and "which has no fit.json" in capsys.readouterr().err


def test_photos_are_never_written_over_those_of_the_capture(copy, photos, tmp_path, capsys):
    # A capture in OUT/photos, plain or calibrated, named by its folder or its JSON file.
    project = tmp_path / "project"
    shutil.copytree(photos, project / "photos")
    for k in (0, 1):
        shutil.copy(photos / f"target/{k:02d}.png", project / "photos")
    before = {path: path.read_bytes() for path in project.rglob("*.png")}
    for capture in (project / "photos", project / "photos/capture.json"):
        assert cli.main(["fit", str(capture), "-o", str(project), *FAST, "--overwrite"]) == 2
        assert "holds the photos" in capsys.readouterr().err
    shots = read_capture(project / "photos")
    found = fit_svbrdf(shots, ANALYTIC, DirectConfig(iterations=1))
    for out in (project, project / "photos"):
        with pytest.raises(OutputError, match="own photos would be replaced"):
            write_fit(found, shots, out)
    assert {path: path.read_bytes() for path in project.rglob("*.png")} == before
    # What an earlier page kept is no capture: its views are gone.
    assert cli.main(["report", str(copy), "--quick", "--capture", str(copy / "photos")]) == 2
    assert "holds the photos" in capsys.readouterr().err
    write_capture(replace(shots, calibration="none"), tmp_path / "plain")
    assert cli.main(["report", str(copy), "--quick", "--capture", str(tmp_path / "plain")]) == 2
    assert "with calibration" in capsys.readouterr().err


def test_a_second_fit_in_the_same_folder_shows_nothing_of_the_first(tmp_path):
    shots = photograph(make_material("tiles", 8), nine_view_grid(), ANALYTIC)
    for fix, others in (((), shots.pick([5])), (("roughness=0.5",), None)):
        write_fit(fit_svbrdf(shots.pick([0, 1]), ANALYTIC, DirectConfig(iterations=1, fix=fix)), shots.pick([0, 1]), tmp_path,
                  left_out=others)
        page = Page(tmp_path / "report.html")
        assert ("left out of the fit" in page.text) == ("Roughness: standard deviation" in page.pictures) == (not fix)
    assert json.loads((tmp_path / "report.json").read_text())["left_out_rmse"] is None


def test_a_page_is_not_written_beside_another_fit(copy, monkeypatch):
    def slow(*arguments, **options):
        (copy / "fit.json").write_text(json.dumps(json.loads((copy / "fit.json").read_text()) | {"seed": 7}))
        return fit_report(*arguments, **options)

    monkeypatch.setattr(fit_page, "fit_report", slow)
    before = (copy / "report.html").read_bytes()
    with pytest.raises(OutputError, match="another one"):
        write_report(copy, quick=True)
    assert (copy / "report.html").read_bytes() == before


def test_a_capture_whose_name_is_not_utf8_loses_no_fit(photos, tmp_path):
    shots = replace(read_capture(photos), source=Path("caf\udce9 $\\x_$"))  # as Python names such a folder; and no formula
    write_fit(fit_svbrdf(shots, ANALYTIC, DirectConfig(iterations=1)), shots, tmp_path)
    assert "caf? $\\x_$: recovered material" in Page(tmp_path / "report.html").text and (tmp_path / "sheet.png").is_file()


def test_what_the_page_says_is_true_of_plain_photos_smooth_maps_and_held_ones(photos, tmp_path, monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)  # another test may have loaded it
    shots, smooth = replace(read_capture(photos), calibration="none"), ("roughness=0.05", "diffuse=0.3")
    write_fit(fit_svbrdf(shots.pick([0, 1]), ANALYTIC, DirectConfig(iterations=1, fix=smooth)), shots.pick([0, 1]), tmp_path,
              left_out=shots.pick([2]))
    page = Page(tmp_path / "report.html")
    assert "predicted from the assumed view, as" in page.text and "calibration and" not in page.text
    assert "All stated tolerances hold." not in page.text and "rougher texels than there are here" in page.text
    assert "Guessed diffuse" not in page.pictures and "no libLLVM in use" in page.text


def test_the_stage_of_a_fit_is_no_loss_and_long_tables_are_thinned(copy):
    record = json.loads((copy / "fit.json").read_text())
    record["trace"] = [{"seconds": float(k), "iteration": k, "stage": 2.0, "rerender_rmse": 0.1} for k in range(399)]
    record["left_out"] = []
    (copy / "fit.json").write_text(json.dumps(record))
    write_report(copy, quick=True)
    page = Page(copy / "report.html")
    assert "Nothing: this fit needed all of it." in page.text
    assert "The measurements, some of 399" in page.text and 'aria-label="Losses' not in page.source
    assert len([row for row in page.rows if len(row) == 4 and row[2] == "2"]) == 200


def test_a_report_json_of_somebody_else_is_not_trusted(copy):
    record = json.loads((copy / "report.json").read_text())
    for photo in record["photos"][3:]:
        photo |= {"photo": "../secret.png", "rerendered": "../secret.png"}
    images.write_png(copy.parent / "secret.png", torch.zeros(SIDE, SIDE, 3))
    (copy / "report.json").write_text(json.dumps(record))
    assert [photo["left_out"] for photo in write_report(copy, quick=True)["photos"]] == [False] * 3
    (copy / "report.json").write_text("[1]")
    assert write_report(copy, quick=True)["left_out_rmse"] is None


def test_a_page_of_noise_at_512_px_is_below_ten_megabytes(copy):
    # Nothing compresses less than noise. Nine photos, and maps of 512 px.
    random = torch.Generator().manual_seed(1)
    noise = {name: torch.rand(512, 512, channels, generator=random) for name, channels in (
        ("diffuse", 3), ("specular", 3), ("roughness", 1), ("normal", 3))}
    noise["normal"] = torch.nn.functional.normalize(noise["normal"] - torch.tensor([0.5, 0.5, 0.0]), dim=-1)
    noise["normal"][..., 2] = noise["normal"][..., 2].clamp_min(0.1)
    noise["normal"] = torch.nn.functional.normalize(noise["normal"], dim=-1)
    noise["roughness"] = noise["roughness"].clamp_min(0.05)
    shutil.rmtree(copy / "maps")
    save_maps(SVBRDF("roughconductor", noise), copy / "maps")
    views, names = nine_view_grid(), [f"{i:02d}" for i in range(9)]
    for name in names:
        for folder in ("photos", "rerendered"):
            images.write_png(copy / folder / f"{name}.png", torch.rand(512, 512, 3, generator=random))
    record = json.loads((copy / "fit.json").read_text())
    record["per_photo"], record["capture"]["photos"] = dict.fromkeys(names, 0.4), list(range(9))
    record["views"] |= {k: getattr(views, k).tolist() for k in ("camera", "light", "intensity")}
    (copy / "fit.json").write_text(json.dumps(record))
    (copy / "report.json").unlink()
    write_report(copy, quick=True)
    assert (copy / "report.html").stat().st_size < 10e6
    page = Page(copy / "report.html")
    assert page.pixels("photo 08").shape == (256, 256, 3) and page.pixels("Diffuse").shape == (512, 512, 3)


def test_formats_page_names_every_field(measured):
    page = (Path(__file__).parents[1] / "docs/formats.md").read_text()
    for field in measured[2]:
        assert f"`{field}`" in page, field


def test_read_fit_gives_what_the_files_say(fitted):
    found = read_whole_fit(fitted)
    assert found.names == ["00", "01", "03"] and found.svbrdf.resolution == SIDE and found.renderer().name == "analytic"


def test_pictures_that_would_be_large_become_jpegs():
    noise = torch.rand(256, 256, 3, generator=torch.Generator().manual_seed(0))
    smooth = torch.linspace(0, 1, 256)[:, None, None].expand(256, 256, 1)

    def decoded(uri):
        return np.asarray(PIL.Image.open(io.BytesIO(base64.b64decode(uri.split(",", 1)[1]))).convert("RGB"))

    assert picture_uri(noise).startswith("data:image/jpeg") and picture_uri(smooth).startswith("data:image/png")
    assert np.array_equal(decoded(picture_uri(smooth))[:, 0, 0], np.arange(256))
    # Even noise is kept to 15 of 255, root mean square, in every channel; with the colours at half the size it is 74.
    errors = decoded(picture_uri(noise)).astype(float) - 255 * noise.numpy()
    assert np.sqrt(np.mean(errors**2, axis=(0, 1))).max() < 20


def test_curves_are_logarithmic():
    trace = [{"seconds": 0.0, "a": 5.0}, {"seconds": 0.1, "a": 100.0, "b": 0.0}, {"seconds": 1.0, "a": 10.0},
             {"seconds": 10.0, "a": 1.0, "b": math.nan}]
    drawn = curves(trace, ["a", "b"])
    (line,) = drawn["lines"]
    x, y = ([point[k] for point in line["points"]] for k in (0, 1))
    assert line["name"] == "a" and len(x) == 3 and x[0] < x[1] < x[2] and y[0] < y[1] < y[2]  # down the page is less
    assert x[1] - x[0] == pytest.approx(x[2] - x[1], abs=0.2) and y[1] - y[0] == pytest.approx(y[2] - y[1], abs=0.2)
    assert [label for _, label in drawn["x"]] == ["0.1", "1", "10"]
    assert [place for place, _ in drawn["x"]] == x and [place for place, _ in drawn["y"]] == y[::-1]
    left, top, right, bottom = drawn["frame"]
    assert all(left <= place <= right for place in x) and all(top <= place <= bottom for place in y)
    assert curves(trace[:1], ["a"]) is None and curves([], ["a"]) is None
    flat = curves([{"seconds": 2.0, "a": 3.0}], ["a"])  # one point is an axis too
    assert len(flat["x"]) > 2 and flat["lines"][0]["points"][0][2:] == (2.0, 3.0)
    narrow = curves([{"seconds": 1.0, "a": 0.0202}, {"seconds": 9.0, "a": 0.0313}], ["a"])
    assert [label for _, label in narrow["y"]] == ["0.02", "0.022", "0.024", "0.026", "0.028", "0.03", "0.032"]
    long = [{"seconds": k + 1.0, "a": 1.0 / (k + 1)} for k in range(20_000)]
    points = curves(long, ["a"])["lines"][0]["points"]
    assert len(points) <= 1001 and points[-1][2] == 20_000


@pytest.fixture(scope="module")
def larger(tmp_path_factory):
    """A fit at 64 px with two photos left out, as `fit` leaves it."""
    folder = tmp_path_factory.mktemp("larger")
    write_capture(photograph(make_material("inlay", 64), nine_view_grid(), ANALYTIC), folder / "inlay")
    options = ["--resolution", "64", "--views", "0,1,2,3,5,6,8"]
    assert cli.main(["fit", str(folder / "inlay"), "-o", str(folder / "out"), *options]) == 0
    return folder / "out" / "report.html"


def cut(page, number=0):
    return page.locator(".wipe").nth(number).evaluate("e => parseFloat(getComputedStyle(e).getPropertyValue('--cut'))")


def pixels(locator):
    return np.asarray(PIL.Image.open(io.BytesIO(locator.screenshot())).convert("RGB")).astype(int)


@pytest.mark.slow
@pytest.mark.parametrize("width, phone", [(1280, False), (390, True)])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_fits_and_reads_in_a_browser(width, phone, scheme, larger, tmp_path):
    with opened(larger, width=width, height=844, scheme=scheme, phone=phone) as page:
        page.wait_for_timeout(500)  # the live view draws; errors would be said by now
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.locator(".photo").count() == 9 and page.locator(".photo.left").count() == 2
        # WCAG's contrast of text and ground, 4.5 for small text.
        contrast = page.evaluate("""() => {
          const light = text => { const [r, g, b] = text.match(/[\\d.]+/g).map(v => v / 255)
            .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
          const ground = light(getComputedStyle(document.body).backgroundColor);
          return ["p", "td", "figcaption", "nav a", ".curves text", ".settings dt", ".legend span", "caption"].map(name => {
            const style = getComputedStyle(document.querySelector(name));
            const ink = light(name.endsWith("text") ? style.fill : style.color);
            return (Math.max(ink, ground) + 0.05) / (Math.min(ink, ground) + 0.05); }); }""")
        assert min(contrast) > 4.5, contrast
        page.screenshot(path=tmp_path / "page.png", full_page=True)


@pytest.mark.slow
def test_the_slider_wipes_by_keyboard_and_pointer(larger, tmp_path):
    out = shutil.copytree(larger.parent, tmp_path / "out")
    images.write_png(out / "photos/00.png", torch.tensor([1.0, 0.0, 0.0]).expand(64, 64, 3))
    write_report(out, quick=True)
    with opened(out / "report.html") as page:
        wipe, slider = page.locator(".wipe").first, page.locator(".wipe input").first

        def red():  # per cent of a line of the picture that shows the photo
            line = pixels(wipe)[40]
            return 100 * np.mean((line[:, 0] > 240) & (line[:, 1:].max(axis=1) < 20))

        assert cut(page) == 50 and red() == pytest.approx(50, abs=3)  # the line between the two is 2 px of 270, with its shadow
        slider.focus()
        page.keyboard.press("Home")
        assert cut(page) == 0 and red() < 2
        page.keyboard.press("End")
        assert cut(page) == 100 and red() > 95 and cut(page, 1) == 50
        page.keyboard.press("ArrowLeft")
        assert cut(page) == 99
        box = wipe.bounding_box()
        page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 30)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 40, steps=4)
        page.mouse.up()
        assert cut(page) == pytest.approx(25, abs=1) and red() == pytest.approx(25, abs=3)
        page.locator("#all").fill("70")
        assert [cut(page, k) for k in range(9)] == [70] * 9 and red() == pytest.approx(70, abs=3)


@pytest.mark.slow
def test_switches_and_the_large_picture_work_by_keyboard(larger):
    with opened(larger) as page:
        spreads, plain = page.locator(".maps .spread"), page.locator(".maps .plain")
        assert not spreads.first.is_visible() and plain.first.is_visible()
        page.locator("#spreads").focus()
        page.keyboard.press("Space")
        assert all(spreads.nth(k).is_visible() for k in range(4)) and page.locator(".scale").is_visible()
        assert [plain.nth(k).is_visible() for k in range(5)] == [False] * 4 + [True]  # the guess has no deviation
        page.locator("#differences").focus()
        page.keyboard.press("Space")
        assert not page.locator(".difference").first.is_visible()
        page.keyboard.press("Space")
        assert page.locator(".difference").first.is_visible()
        dialog = page.locator("#large")
        assert not dialog.is_visible()
        page.locator(".maps .enlarge").nth(3).focus()
        page.keyboard.press("Enter")
        assert dialog.is_visible() and dialog.locator("img").get_attribute("alt") == "Normal: standard deviation"
        page.keyboard.press("ArrowRight")
        assert dialog.locator("span").inner_text() == "Guessed diffuse"
        page.keyboard.press("Escape")
        assert not dialog.is_visible() and page.evaluate("document.activeElement.dataset.title") == "Normal"
        page.locator(".difference").first.click()
        assert dialog.locator("span").inner_text() == "Photo 00: difference × 4"
        dialog.locator("button", has_text="Close").click()
        assert not dialog.is_visible()


@pytest.mark.slow
def test_a_phone_wipes_by_touch(larger):
    with opened(larger, width=390, height=844, phone=True) as page:
        wipe = page.locator(".wipe").nth(2)
        wipe.scroll_into_view_if_needed()
        box = wipe.bounding_box()
        page.touchscreen.tap(box["x"] + 0.8 * box["width"], box["y"] + 40)
        assert cut(page, 2) == pytest.approx(80, abs=2)


@pytest.mark.slow
def test_without_javascript_all_pictures_are_there(larger):
    with opened(larger) as page:
        context = page.context.browser.new_context(java_script_enabled=False, viewport={"width": 390, "height": 844})
        plain = context.new_page()
        plain.goto(larger.resolve().as_uri())
        first = plain.locator(".wipe").first
        boxes = [first.locator("img").nth(k).bounding_box() for k in (0, 1)]
        assert abs(boxes[0]["x"] - boxes[1]["x"]) >= boxes[0]["width"] - 1  # photo and re-rendering side by side
        assert not plain.locator(".wipe input").first.is_visible() and not plain.locator("#all").is_visible()
        plain.locator("#spreads").check()
        assert plain.locator(".maps .spread").first.is_visible()
