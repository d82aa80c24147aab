"""The comparison of methods: figures that `evaluate` finds too, and one page without network."""

import base64
import io
import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import PIL.Image
import pytest
import torch
from helpers import ANALYTIC, GRID, photos_of

from mitsvbrdf import cli
from mitsvbrdf.capture import read_capture, write_capture
from mitsvbrdf.evaluate.photos import Entry, compare
from mitsvbrdf.evaluate.placement import fitted_views, is_of, named_views
from mitsvbrdf.fit.result import Fit
from mitsvbrdf.io import images
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.report.fit_page import keep_photos

SIDE = 32


class Page(HTMLParser):
    """Pictures by their alt text, the cells of the table row by row, and every address in the file."""

    def __init__(self, path):
        super().__init__()
        self.pictures, self.rows, self.addresses, self.open, self.cell = {}, [], [], [], None
        self.text = path.read_text(encoding="utf-8")
        self.feed(self.text)
        assert not self.open, self.open

    def handle_starttag(self, tag, attributes):
        attributes, told = dict(attributes), ("src", "href", "srcset", "data", "action")
        self.addresses += [attributes[name] for name in told if name in attributes]
        if tag == "img":
            self.pictures[attributes["alt"]] = attributes["src"]
        if tag not in ("img", "meta", "link", "br"):
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data

    def pixels(self, alt):
        head, data = self.pictures[alt].split(",", 1)
        assert head == "data:image/png;base64"
        return np.asarray(PIL.Image.open(io.BytesIO(base64.b64decode(data, validate=True))))

    def values(self, name):
        return next([float(cell) for cell in row[1:]] for row in self.rows if row and row[0] == name)


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    """Three photos of the inlay, whose flash stands 0.1 patch sides right of where it is stated."""
    views = GRID.pick([0, 1, 3])
    beside = replace(views, light=views.light + torch.tensor([0.1, 0.0, 0.0], dtype=torch.float64))
    capture = photos_of(make_material("inlay", SIDE), beside)
    folder = tmp_path_factory.mktemp("compare") / "photos"
    write_capture(replace(capture, views=views), folder)
    return read_capture(folder), beside


def made_fit(folder, views, seen=(0, 1), **more):
    """A folder as a fit leaves it: the true maps, and views whose lights are right."""
    save_maps(make_material("inlay", SIDE), folder / "maps")
    views = views.pick(list(range(len(seen))))
    (folder / "fit.json").write_text(json.dumps({
        "method": "hierarchical", "capture": {"name": "photos", "transfer": "gamma2.2", "photos": seen},
        "flash_offset": None, "views": {"size": 1.0, "falloff": "inverse-square", **{
            name: getattr(views, name).tolist() for name in ("camera", "light", "intensity")}}} | more))
    return folder


@pytest.fixture(scope="module")
def compared(shots, tmp_path_factory):
    """One run of the command: a fit that saw photos 00 and 01, and maps with a hostile name."""
    folder = tmp_path_factory.mktemp("page")
    fit = made_fit(folder / "fit", shots[1])
    save_maps(flat(64, diffuse=0.2, roughness=0.6), folder / "a&b <i>")
    page, figures = folder / "page.html", folder / "figures.json"
    arguments = [str(fit), f"flat<script>={folder}/a&b <i>", "--capture", str(shots[0].source), "-o",
                 str(page), "--json", str(figures), "--reference", "builtin:inlay", "--renderer", "analytic",
                 "--refine-views"]
    assert cli.main(["compare", *arguments]) == 0
    return folder, json.loads(figures.read_text()), Page(page), arguments


def test_fitted_views_are_those_of_the_fit_for_the_photos_it_saw(shots):
    capture, true = shots
    stored = replace(true.pick([2, 1]), camera=2 * true.camera[[2, 1]], light=2 * true.light[[2, 1]],
                     intensity=4 * true.intensity[[2, 1]], size=2.0)
    fit = Fit().but(flash_offset=(0.05, -0.02), capture="photos", seen=(2, 1), views=stored)
    views, names = fitted_views(fit, capture)
    assert names == ["01", "02"] and views.size == 1
    assert torch.equal(views.camera, capture.views.camera) and torch.allclose(views.intensity, true.intensity,
                                                                              atol=1e-12)
    assert torch.allclose(views.light[1:], true.light[1:], atol=1e-12)
    assert torch.allclose(views.light[0] - capture.views.light[0],
                          torch.tensor([0.05, -0.02, 0.0], dtype=torch.float64))
    _, there, _ = named_views(str(capture.source), "inverse-square", fit)  # of `render`
    assert torch.allclose((there.light - capture.views.light)[:, :2], torch.tensor([[0.05, -0.02]]).double())
    elsewhere, names = fitted_views(fit.but(capture="others"), capture)
    assert not names and torch.allclose(elsewhere.light[:, 0] - capture.views.light[:, 0],
                                        torch.full((3,), 0.05).double())


def test_folders_of_one_name_with_other_photos_are_other_captures(shots, tmp_path, monkeypatch, capsys):
    keep_photos(made_fit(tmp_path / "fit", shots[1]), shots[0].pick([0, 1]))
    write_capture(photos_of(make_material("leather", SIDE), shots[1]), tmp_path / "photos")
    for folder, ours in ((tmp_path / "photos", False), (shots[0].source, True)):
        monkeypatch.chdir(folder)
        for resolution in (SIDE, 13):
            assert is_of(Fit.of_maps(tmp_path / "fit"), read_capture(".", resolution)) is ours
        assert cli.main(["evaluate", str(tmp_path / "fit"), "--capture", ".", "--views", "2", "--renderer",
                         "analytic", "--resolution", str(SIDE)]) == 0  # no photo that the fit saw
        assert ("(held out)" in capsys.readouterr().out) is ours
    fit, again = Fit.of_maps(tmp_path / "fit"), read_capture(shots[0].source, SIDE)
    assert not is_of(fit, again.but(photos=0.98 * again.photos))  # of a second session
    assert is_of(fit, again.but(photos=again.photos + 0.01 * torch.eye(SIDE**2)[7].view(SIDE, SIDE, 1)))
    seen = (torch.arange(SIDE) > 2)[:, None].expand(3, SIDE, SIDE)  # the rest is filled in from other photos
    filled = again.but(photos=torch.where(seen[..., None], again.photos, 0.5))
    assert is_of(fit, filled.but(measured=seen)) and not is_of(fit, filled)


def test_a_folder_with_another_name_and_equal_photos_is_the_same_capture(shots, tmp_path):
    keep_photos(made_fit(tmp_path / "fit", shots[1]), shots[0].pick([0, 1]))
    fit, renamed = Fit.of_maps(tmp_path / "fit"), shutil.copytree(shots[0].source, tmp_path / "renamed")
    assert is_of(fit, read_capture(renamed, SIDE))
    again = read_capture(renamed, SIDE)  # photographed again: alike, with other noise
    assert not is_of(fit, again.but(photos=(again.photos + 0.01 * torch.randn_like(again.photos)).clip(0, 1)))


def test_true_maps_with_true_views_leave_the_rounding_of_the_photos(compared):
    _, record, _, _ = compared
    fit, other = record["methods"]
    # The photos have 8 bits: a uniform error of one step has a deviation of 1 / (255 sqrt 12) = 0.00113.
    assert all(0.0005 < fit["per_photo"][name] < 0.0013 for name in ("00", "01"))
    assert fit["per_photo"]["02"] > 0.004  # its view has the wrong light
    assert fit["fitted_views"] == ["00", "01"] and fit["held_out"] == ["02"]
    assert fit["calibrated"]["per_photo"]["00"] > 0.004 and other["fitted_views"] == [] == other["held_out"]
    assert fit["refined"]["per_photo"]["02"] < fit["per_photo"]["02"]
    assert other["per_photo"] == other["calibrated"]["per_photo"]
    assert max(fit["map_rmse"].values()) < 1e-6 and other["map_rmse"]["diffuse"] > 0.05  # EXR keeps float32
    squares = np.mean(np.square(list(other["per_photo"].values())))
    assert other["rerender_rmse"] == pytest.approx(np.sqrt(squares), rel=1e-9)


def test_evaluate_finds_the_same_figures(compared, shots):
    folder, record, _, _ = compared
    for path, method in ((folder / "fit", record["methods"][0]), (folder / "a&b <i>", record["methods"][1])):
        found = folder / "evaluate.json"
        assert cli.main(["evaluate", str(path), "--json", str(found), "--overwrite", "--capture",
                         str(shots[0].source), "--renderer", "analytic", "--resolution", str(SIDE)]) == 0
        alone = json.loads(found.read_text())
        for name in ("rerender_rmse", "per_photo"):
            assert method[name] == pytest.approx(alone[name], rel=1e-6)
            assert method["calibrated"][name] == pytest.approx(alone["calibrated"][name], rel=1e-6)


def test_evaluate_says_seen_and_left_out_apart_with_the_views_of_each(compared, shots, capsys):
    folder, record, _, _ = compared
    assert cli.main(["evaluate", str(folder / "fit"), "--capture", str(shots[0].source), "--renderer",
                     "analytic", "--resolution", str(SIDE)]) == 0
    said = capsys.readouterr().out.split("Burn-in")[0]
    fitted, stated = said.split("with calibrated views: ")
    *each, seen, left = (float(word) for word in re.findall(r"\d\.\d{4}", fitted))
    # Printed are 4 digits, so each number is off by 5e-5 at most.
    assert seen == pytest.approx(np.sqrt(np.mean(np.square(each[:2]))),
                                 abs=1e-4) and left == each[2] and "all" not in fitted
    (method, *_) = record["methods"]
    assert [float(word) for word in re.findall(r"\d\.\d{4}", stated)] == pytest.approx(
        [method["calibrated"]["rmse_seen"], method["rmse_held_out"]], abs=5e-5)


def test_the_page_shows_what_was_measured(compared, shots):
    folder, record, page, _ = compared
    capture = shots[0]
    for i, name in enumerate(capture.names):
        stored = np.asarray(PIL.Image.open(capture.source / "target" / f"{i:02d}.png"))
        assert np.array_equal(page.pixels(f"photo {name}"), stored)
        by_fit = page.pixels(f"photo {name} by fit").astype(float)
        error = np.sqrt(np.mean(np.square((by_fit - stored) / 255)))
        # Pictures are rounded to 8 bits, which adds at most half a step, 0.002, to the error.
        assert error == pytest.approx(record["methods"][0]["per_photo"][name], abs=0.002)
    # 0.2 in sRGB is 1.055 * 0.2^(1 / 2.4) - 0.055 = 0.4845 = 124 / 255; 0.6 is 153 / 255; the normal is up.
    for title, value in (("Diffuse", (124, 124, 124)), ("Roughness", (153, 153, 153)),
                         ("Normal", (128, 128, 255))):
        pixels = page.pixels(f"flat<script>: {title}")
        assert pixels.shape == (SIDE, SIDE, 3) and np.abs(pixels.astype(int) - value).max() <= 1
    assert page.pixels("guessed diffuse map").shape == (SIDE, SIDE, 3)
    assert np.array_equal(page.pixels("Known maps: Specular"), page.pixels("fit: Specular"))


def test_the_table_has_every_figure(compared):
    _, record, page, _ = compared
    methods = record["methods"]
    wanted = {"Diffuse": ("map_rmse", "diffuse"), "photo 02": ("per_photo", "02"),
              "all photos, as pictured": ("rerender_rmse",),
              "all, calibration and flash offset": ("calibrated", "rerender_rmse"),
              "all, views refined for every method": ("refined", "rerender_rmse")}
    for row, path in wanted.items():
        values = methods
        for key in path:
            values = [value[key] for value in values]
        assert page.values(row) == [round(value, 4) for value in values]
    # of the fit; the maps beside it saw nothing
    seen, left = methods[0]["rmse_seen"], methods[0]["rmse_held_out"]
    assert seen == pytest.approx(np.sqrt(np.mean([methods[0]["per_photo"][k] ** 2 for k in ("00", "01")])))
    for title, value in (("those that the fit saw, as pictured", seen),
                         ("those that the fit did not see", left)):
        assert re.search(rf"{title}</th><td>{value:.4f}</td><td>–</td>", page.text)
    # Marked is the smallest where views were the same: four maps, their mean, and two rows over all photos.
    rows = [re.findall(r'<td( class="best")?>([0-9.]+)</td>', row) for row in page.text.split("<tr>")]
    marked = [row for row in rows if any(best for best, _ in row)]
    assert len(marked) == 7
    for row in marked:
        assert {value for best, value in row if best} == {min(value for _, value in row)}


def test_the_page_needs_no_network_and_escapes_names(compared):
    _, _, page, _ = compared
    assert page.addresses and all(address.startswith("data:") for address in page.addresses)
    styles = "".join(re.findall(r"<style>(.*?)</style>", page.text, re.S))
    assert "url(" not in styles and "@import" not in styles
    assert "<script" not in page.text and "<i>" not in page.text and "flat&lt;script&gt;" in page.text


def test_results_are_only_replaced_when_asked(compared, capsys):
    folder, _, _, arguments = compared
    before = (folder / "page.html").read_bytes()
    assert cli.main(["compare", *arguments]) == 2
    assert "--overwrite" in capsys.readouterr().err and (folder / "page.html").read_bytes() == before
    assert cli.main(["compare", *arguments, "--overwrite"]) == 0


def test_names(shots, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_maps(flat(16), tmp_path / "x=y")
    for name in ("a", "b"):
        save_maps(flat(16, diffuse=0.3), tmp_path / name / "maps")
    made_fit(tmp_path / "one", shots[1])
    made_fit(tmp_path / "two", shots[1], seen=(0, 1, 2))
    stated = json.loads((tmp_path / "two/fit.json").read_text())
    stated["views"]["falloff"], stated["capture"]["transfer"] = "none", "srgb"
    stated["calibration"] = {"power_told": 1.2}  # for which its maps are darker
    (tmp_path / "two/fit.json").write_text(json.dumps(stated))
    assert cli.main(["compare", "x=y", "a/maps", "b", "mine=b", "one", "two", "-o", "p.html", "--json", "e",
                     "--views", "1", "--renderer", "analytic", "--capture", str(shots[0].source)]) == 0
    record = json.loads((tmp_path / "e").read_text())
    assert [m["name"] for m in record["methods"]] == ["x=y", "a", "b", "mine", "one", "two"]
    assert record["resolution"] == 16 and record["photos"] == ["01"] and record["reference"] is None
    assert [m["resolution"] for m in record["methods"]] == [16] * 4 + [32] * 2 and record["same_views"]
    one, two = record["methods"][4:]
    assert one["falloff"] == "inverse-square" and (two["falloff"], two["transfer"]) == ("none", "srgb")
    page = Page(tmp_path / "p.html")
    assert "Map RMSE" not in page.text and page.pixels("photo 01 by mine").shape == (16, 16, 3)


def test_principled_maps_are_shown_as_diffuse_and_specular(shots):
    entry = Entry("metal", "metal", flat(SIDE, "principled", base_color=0.5, metallic=1.0))
    record, (pictures,) = compare([entry], shots[0], ANALYTIC)
    assert record["methods"][0]["bsdf"] == "principled" and pictures.shape == shots[0].photos.shape


@pytest.mark.parametrize("arguments, words", [(["nowhere"], ("a folder of maps", "nowhere")),
    (["maps", "--capture", "nowhere"], ("a folder of photos", "nowhere")),
    (["maps", "--reference", "nowhere"], ("a folder of maps", "nowhere")),
    (["maps", "--resolution", "4"], ("--resolution", "4")), (["maps", "--views", "7"], ("photos among", "7")),
    (["m=maps", "m=maps"], ("a name of their own",)), (["broken"], ("a fit.json of this package", "broken")),
    (["uneven"], ("square maps of one size", "uneven")), (["maps", "-o", "maps"], ("a file to", "folder"))])
def test_mistakes_are_one_error(arguments, words, shots, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("maps", "broken", "uneven"):
        save_maps(flat(8), tmp_path / name)
    (tmp_path / "broken/fit.json").write_text("{}")
    images.write_exr(tmp_path / "uneven/normal.exr", torch.tensor([0.5, 0.5, 1.0]).expand(4, 4, 3))
    before = sorted(tmp_path.rglob("*"))
    usual = {"--capture": str(shots[0].source), "-o": "page.html"}
    more = [word for option, value in usual.items() if option not in arguments for word in (option, value)]
    assert cli.main(["compare", *arguments, *more, "--renderer", "analytic"]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and all(word in message for word in words), message
    assert sorted(tmp_path.rglob("*")) == before
