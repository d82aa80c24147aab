"""The cross-check: it passes what is right and names what is broken."""

import json
import re

import pytest
import torch
from helpers import ANALYTIC, GRID, TWIN
from helpers.crosschecks import BOTH, THREE

from mitsvbrdf import cli
from mitsvbrdf.cli import crosscheck as command
from mitsvbrdf.material.corner_cases import builtin_materials
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.render import make_renderer
from mitsvbrdf.testing import random_material
from mitsvbrdf.verify.crosscheck import crosscheck, violations


class Broken:
    """The analytic renderer in float32 with something wrong."""

    name, variant = "broken", None

    def __init__(self, spoil):
        self.inner, self.spoil = ANALYTIC, spoil

    def render(self, svbrdf, views):
        return self.spoil(self.inner, svbrdf, views)


class WrongBackward(torch.autograd.Function):
    """Hands a map on as it is, and its gradient off by a share."""

    @staticmethod
    def forward(ctx, value):
        return value.clone()

    @staticmethod
    def backward(ctx, gradient):
        return gradient * (1 + 1e-5)


def brighter(inner, svbrdf, views):
    return inner.render(svbrdf, views) * (1 + 1e-5)


def wrong_roughness_gradient(inner, svbrdf, views):
    maps = {**svbrdf.maps, "roughness": WrongBackward.apply(svbrdf["roughness"])}
    return inner.render(SVBRDF(svbrdf.bsdf, maps), views)


def not_a_number(inner, svbrdf, views):
    image = inner.render(svbrdf, views)
    return image + torch.where(torch.arange(image.numel()).reshape(image.shape) == 5, torch.nan, 0.0)


def gradient_where_none_is(inner, svbrdf, views):
    return inner.render(svbrdf, views) + 1e-9 * svbrdf["roughness"]


def check(spoil, svbrdf=None, bsdfs=("roughconductor",)):
    svbrdf = make_material("leather", 16) if svbrdf is None else svbrdf
    return crosscheck({"leather": svbrdf}, THREE, bsdfs, [Broken(spoil)], repeats=1)


def test_the_real_renderers_hold(real):
    record, maps = real
    assert record["violations"] == [] == violations(record)
    assert len(record["configurations"]) == 2 * 2 * 3 == len(maps)
    for c in record["configurations"]:
        assert (c["rough"] is None) == (c["material"] == "polished")  # leather put the tolerances to the test


@pytest.mark.parametrize("spoil, named", [
    (brighter, {"mean relative image error", "p99.9 relative image error", "gradient of diffuse: relative L2",
                "gradient of specular: relative L2", "gradient of roughness: relative L2",
                "gradient of normal: relative L2"}),
    (wrong_roughness_gradient, {"gradient of roughness: relative L2"}),
    (not_a_number, {"values that are not finite in the image"})])
def test_a_broken_renderer_is_named(spoil, named):
    record = check(spoil)
    json.dumps(record, allow_nan=False)
    assert {v["what"] for v in record["violations"]} == named
    for v in record["violations"]:
        assert v["renderer"] == "broken" and v["value"] > v["tolerance"]


def test_a_gradient_where_there_is_none_is_named():
    # Without a specular lobe, roughness changes nothing.
    record = check(gradient_where_none_is, flat(16, specular=0.0))
    (everything,) = record["violations"]
    assert everything["what"] == "gradient of roughness: length, 0 in the reference"
    assert everything["tolerance"] == 0
    assert record["configurations"][0]["rough"]["gradients"]["roughness"]["relative_l2"] is None


def test_command_exits_with_1_and_names_the_renderer(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(command, "make_renderer", lambda name, variant: Broken(wrong_roughness_gradient))
    options = ["--renderer", "analytic", "--bsdf", "roughconductor", "--resolution", "16", "--repeats", "1"]
    assert cli.main(["crosscheck", "builtin:leather", *options, "--json", str(tmp_path / "f.json")]) == 1
    printed = capsys.readouterr().out
    line = r"exceeded: leather · roughconductor · broken: gradient of roughness: relative L2 (\S+) > 2.0e-06"
    (value,) = re.findall(line, printed)
    assert float(value) == pytest.approx(1e-5, rel=0.05)
    assert "1 - cosine" not in printed.split("exceeded", 1)[1] and "figures exceed" in printed
    assert json.loads((tmp_path / "f.json").read_text())["violations"]


def test_builtin_materials_cover_the_corners():
    made = {name: svbrdf.check() for name, svbrdf in builtin_materials(32).items()}
    roughness = torch.cat([m["roughness"].flatten() for m in made.values()])
    assert float(roughness.min()) < 0.0316 and float(roughness.max()) == 1
    assert float(made["roughness 0.1"]["roughness"].min()) == pytest.approx(0.1)
    assert made["black diffuse"]["diffuse"].max() == 0 and made["white"]["diffuse"].min() == 1
    assert float(made["coloured F0"]["specular"].std(dim=-1).min()) > 0.3
    steep = TWIN.render(made["steep normals"].to(torch.float64), THREE.in_patch_sides())
    assert bool((steep == 0).any()) and bool((steep > 0).any())  # some texels face away
    assert {"inlay", "tiles", "leather", "plates", "flat"} <= set(made)


def test_command_on_a_fit(tmp_path, capsys):
    # Falloff and flash offset are those of the fit; maps are averaged down to the resolution asked for.
    save_maps(make_material("leather", 32), tmp_path / "out/maps")
    (tmp_path / "out/fit.json").write_text(json.dumps({
        "views": {"size": 1.0, "falloff": "none", "camera": [[0.0, 0.0, 1.5]], "light": [[0.05, -0.02, 1.5]],
                  "intensity": [[20.0, 20.0, 20.0]]}, "flash_offset": {"x": 0.05, "y": -0.02},
        "capture": {"transfer": "srgb", "name": "photos", "photos": [0]}}))
    page, figures = tmp_path / "page.html", tmp_path / "figures.json"
    options = ["--renderer", "analytic", "--bsdf", "roughconductor", "--repeats", "1", "--resolution", "16"]
    options += ["--json", str(figures), "--html", str(page)]
    assert cli.main(["crosscheck", str(tmp_path / "out"), *options]) == 0
    record = json.loads(figures.read_text())
    assert record["materials"] == {"out": {"resolution": 16, "bsdf": "roughconductor", "converted": {}}}
    assert record["views"]["falloff"] == "none" and record["transfer"] == "srgb"
    assert len(record["views"]["names"]) == 9
    apart = torch.tensor(record["views"]["light"]) - torch.tensor(record["views"]["camera"])
    assert torch.allclose(apart, torch.tensor([0.05, -0.02, 0.0]))
    printed = capsys.readouterr().out
    assert "9 views of builtin:grid" in printed
    assert "all stated tolerances hold" in printed and page.is_file()
    assert "omitted by analytic: light falloff" in printed


def test_a_black_material_has_figures_too():
    record = crosscheck({"black": flat(8, diffuse=0.0, specular=0.0)}, GRID, BOTH, [ANALYTIC], repeats=1)
    json.dumps(record, allow_nan=False)
    texels = [texel for c in record["configurations"] for texel in c["worst_texels"]
              if not texel["reference"]]
    assert texels and all(texel["relative_error"] == 0 for texel in texels) and not record["violations"]


@pytest.mark.parametrize("options, word", [
    (["--repeats", "0"], "--repeats"), (["--resolution", "4"], "--resolution"),
    (["--html", "."], "file to write"),
    (["--views", "builtin:sphere"], "builtin:grid"), (["nowhere"], "folder of maps")])
def test_bad_input_is_one_error(options, word, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["crosscheck", *options]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and word in message and not list(tmp_path.iterdir())


def test_a_real_material_holds(data_folder, tmp_path):
    options = ["--views", str(data_folder / "captures/cards-blue"), "--bsdf", "roughconductor"]
    options += ["--resolution", "32", "--repeats", "1"]
    assert cli.main(["crosscheck", str(data_folder / "materials/metal-plating"), *options]) == 0


@pytest.mark.slow
def test_a_metal_meets_the_tolerances():
    # Metallic exactly 1, narrow highlights on black: nothing but the specular lobe, down to 1e-3 of the mean.
    metal = random_material("principled", 32)
    metal = SVBRDF("principled", {**metal.maps, "metallic": torch.ones(32, 32, 1)})
    record = crosscheck({"metal": metal}, GRID, ["principled"], [make_renderer("mitsuba")], repeats=1)
    assert record["violations"] == []
