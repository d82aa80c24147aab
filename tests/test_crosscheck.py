"""The cross-check: it passes what is right, names what is broken, and predicts what float32 can do."""

import importlib
import json
import math
import re
from pathlib import Path

import pytest
import torch

from mitsvbrdf import cli
from mitsvbrdf.material.corner_cases import as_bsdf, builtin_materials, corner_materials
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.measure.gradients import fixed_cotangent, render_and_gradients
from mitsvbrdf.measure.metrics import image_error
from mitsvbrdf.measure.tolerances import TOLERANCES, UNIT_ROUNDOFF
from mitsvbrdf.render import make_renderer
from mitsvbrdf.system import files
from mitsvbrdf.system.timing import in_turns
from mitsvbrdf.testing import random_material
from mitsvbrdf.verify.crosscheck import crosscheck, violations
from mitsvbrdf.verify.crosscheck_page import write_crosscheck_page
from mitsvbrdf.verify.float32_limits import diffuse_radiance, float32_limit, turned_normals, why, worst_texels
from mitsvbrdf.views import Views, nine_view_grid

command = importlib.import_module("mitsvbrdf.cli.crosscheck")  # the package has the function under this name
TWIN = make_renderer("analytic64")
GRID = nine_view_grid()
THREE = GRID.pick([0, 3, 8])
BOTH = ["roughconductor", "principled"]


class Broken:
    """The analytic renderer in float32 with something wrong."""

    name, variant = "broken", None

    def __init__(self, spoil):
        self.inner, self.spoil = make_renderer("analytic"), spoil

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


def wrong_gradient_of_one_view(inner, svbrdf, views):
    return wrong_roughness_gradient(inner, svbrdf, views) if len(views) == 1 and views.camera[0, 0] == GRID.camera[3, 0] \
        else inner.render(svbrdf, views)


def not_a_number(inner, svbrdf, views):
    image = inner.render(svbrdf, views)
    return image + torch.where(torch.arange(image.numel()).reshape(image.shape) == 5, torch.nan, 0.0)


def gradient_where_none_is(inner, svbrdf, views):
    return inner.render(svbrdf, views) + 1e-9 * svbrdf["roughness"]


def check(spoil, svbrdf=None, bsdfs=("roughconductor",)):
    svbrdf = make_material("leather", 16) if svbrdf is None else svbrdf
    return crosscheck({"leather": svbrdf}, THREE, bsdfs, [Broken(spoil)], repeats=1)


@pytest.fixture(scope="module")
def real():
    """Record and error maps of the three renderers on two materials, both BSDFs; one material has texels below 0.1."""
    renderers = [make_renderer(name) for name in command.RENDERERS]
    materials = {"leather": make_material("leather", 24), "polished": corner_materials(24)["polished"]}
    maps: dict = {}
    return crosscheck(materials, THREE, BOTH, renderers, repeats=2, error_maps=maps), maps


def test_the_real_renderers_hold(real):
    record, maps = real
    assert record["violations"] == [] == violations(record)
    assert len(record["configurations"]) == 2 * 2 * 3 == len(maps)
    for c in record["configurations"]:
        assert (c["rough"] is None) == (c["material"] == "polished")  # so the tolerances were put to the test by leather


@pytest.mark.parametrize("spoil, named", [
    (brighter, {"mean relative image error", "p99.9 relative image error", "gradient of diffuse: relative L2",
                "gradient of specular: relative L2", "gradient of roughness: relative L2", "gradient of normal: relative L2"}),
    (wrong_roughness_gradient, {"gradient of roughness: relative L2"}),
    (wrong_gradient_of_one_view, set()),
    (not_a_number, {"values that are not finite in the image"})])
def test_a_broken_renderer_is_named(spoil, named):
    record = check(spoil)
    json.dumps(record, allow_nan=False)
    found = [v for v in record["violations"] if "alone" not in v["what"]]
    assert {v["what"] for v in found} == named
    for v in found:
        assert v["renderer"] == "broken" and v["value"] > v["tolerance"]
    alone = {v["what"] for v in record["violations"]} - named
    if spoil is wrong_gradient_of_one_view:
        assert alone == {"gradient of roughness, view 01 alone: relative L2"}
    elif spoil is not not_a_number:
        assert len(alone) == len(named & {v["what"] for v in found if "gradient" in v["what"]})


def test_signed_bias_tells_too_bright_from_noise():
    (configuration,) = check(brighter)["configurations"]
    assert configuration["rough"]["image"]["bias"] == pytest.approx(1e-5, rel=0.1)
    assert all(g["bias"] == pytest.approx(1e-5, rel=0.1) for g in configuration["rough"]["gradients"].values())


def test_a_gradient_where_there_is_none_is_named():
    # Without a specular lobe, roughness changes nothing.
    record = check(gradient_where_none_is, flat(16, specular=0.0))
    (everything,) = [v for v in record["violations"] if "alone" not in v["what"]]
    assert everything["what"] == "gradient of roughness: length, 0 in the reference" and everything["tolerance"] == 0
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


# --- the record ---------------------------------------------------------------------------------------------------------

NUMBER = (int, float)
IMAGE = {"mean": NUMBER, "p99.9": NUMBER, "worst": NUMBER, "bias": NUMBER, "not_finite": int}
GRADIENT = {"relative_l2": NUMBER, "cosine": NUMBER, "worst": NUMBER, "bias": NUMBER, "reference": NUMBER,
            "difference": NUMBER, "not_finite": int}
SPREAD = {"median": NUMBER, "low": NUMBER, "high": NUMBER, "repeats": int}
LOOK = {"mean": NUMBER, "worst": NUMBER}
TEXEL = {"view": str, "row": int, "column": int, "channel": str, "value": NUMBER, "reference": NUMBER,
         "relative_error": NUMBER, "share_of_mean": NUMBER, "roughness": NUMBER, "half_vector_angle": NUMBER,
         "incidence_angle": NUMBER, "camera_angle": NUMBER, "specular_share": NUMBER, "limit": NUMBER, "why": str}


def assert_shaped(value, wanted, where=""):
    """Exactly the keys of ``wanted``, with values of its types."""
    if isinstance(wanted, dict):
        assert set(value) == set(wanted), where
        for name, each in wanted.items():
            assert_shaped(value[name], each, f"{where}.{name}")
    else:
        assert isinstance(value, wanted) and not isinstance(value, bool), (where, value)


def test_schema_of_the_record(real, tmp_path):
    files.write_json(tmp_path / "r.json", real[0])
    record = json.loads((tmp_path / "r.json").read_text())
    assert set(record) == {"schema_version", "reference", "tolerances", "rough_from", "transfer", "command", "views",
                           "materials", "configurations", "machine", "versions", "summary", "violations"}
    assert record["schema_version"] == 1 and record["reference"] == "analytic64" and record["tolerances"] == TOLERANCES
    page = (Path(__file__).parents[1] / "docs/evaluation.md").read_text()
    assert all(f"`{field}`" in page for field in (*record, *record["configurations"][0]) if field not in
               ("material", "bsdf", "renderer"))
    assert record["versions"]["torch"] and record["machine"]["cores"]
    assert record["materials"]["leather"]["converted"].keys() == {"principled"}
    for c in record["configurations"]:
        maps = {"roughconductor": ("diffuse", "specular"), "principled": ("base_color", "metallic")}[c["bsdf"]]
        maps = (*maps, "roughness", "normal")
        limit = {"image": dict.fromkeys(("mean", "p99.9", "worst"), NUMBER), "gradients": dict.fromkeys(maps, NUMBER)}
        texels = {"texels": int, "image": IMAGE, "gradients": dict.fromkeys(maps, GRADIENT), "limit": limit}
        classes = {"rough": texels if c["rough"] else type(None), "smooth": texels if c["smooth"] else type(None)}
        assert_shaped(c, {"material": str, "bsdf": str, "renderer": str, "left_out": list, "per_view": list, "worst_view": str,
                          "worst_texels": list, "display": LOOK, "flip": LOOK,
                          "seconds": {"forward": SPREAD, "backward": SPREAD}, **classes})
        assert [view["view"] for view in c["per_view"]] == ["00", "01", "02"]
        for view in c["per_view"]:
            assert_shaped(view, {"view": str, "flip": LOOK, **classes})
        for texel in c["worst_texels"]:
            assert_shaped(texel, TEXEL)
        assert ("ray tracing" in {each["what"] for each in c["left_out"]}) == (c["renderer"] != "mitsuba-scene")
    assert sum((c[k] or {"texels": 0})["texels"] for c in record["configurations"][:1] for k in ("rough", "smooth")) == 24 * 24


def test_figures_are_those_of_the_metrics():
    # All texels of leather are rough, so the figures have to be those of the plain comparison.
    svbrdf, renderer = make_material("leather", 16), make_renderer("analytic")
    (c,) = crosscheck({"leather": svbrdf}, THREE, ["roughconductor"], [renderer], repeats=1)["configurations"]
    exact, got = render_and_gradients(TWIN, svbrdf, THREE), render_and_gradients(renderer, svbrdf, THREE)
    assert c["rough"]["image"] == pytest.approx(image_error(got.image, exact.image) | {"not_finite": 0}, rel=1e-9)
    worst = c["worst_texels"][0]
    assert worst["relative_error"] == pytest.approx(c["rough"]["image"]["worst"], rel=1e-9)
    at = (int(worst["view"]), worst["row"], worst["column"], "rgb".index(worst["channel"]))
    assert (worst["value"], worst["reference"]) == (float(got.image[at]), float(exact.image[at]))
    for name, g in c["rough"]["gradients"].items():
        off = (got.gradients[name].double() - exact.gradients[name]).norm() / exact.gradients[name].norm()
        assert g["relative_l2"] == pytest.approx(float(off), rel=1e-9)


# --- what float32 can do ------------------------------------------------------------------------------------------------

def limit_of(svbrdf, views):
    cotangent = fixed_cotangent(torch.Size((len(views), svbrdf.resolution, svbrdf.resolution, 3)))
    exact = render_and_gradients(TWIN, svbrdf, views, cotangent)
    return exact, float32_limit(TWIN, svbrdf, views, exact, cotangent)


@pytest.mark.parametrize("roughness", [0.05, 0.1, 0.2])
def test_limit_at_the_steepest_of_a_ggx_lobe(roughness):
    # One texel straight below camera and light, tilted by atan(alpha): |d log D / d angle| = 2 (1 - alpha^2) / alpha.
    # Masking and cosines add terms of order alpha: measured 1e-6, 2e-5 and 4e-4 of it.
    alpha = roughness**2
    tilted = torch.tensor([alpha, 0.0, 1.0]) / math.hypot(1, alpha)
    svbrdf = SVBRDF("roughconductor", {**flat(1, diffuse=0.0, roughness=roughness).maps, "normal": tilted.expand(1, 1, 3)})
    exact, limit = limit_of(svbrdf, Views.of([[0.0, 0.0, 2.0]]))
    condition = limit.image / exact.image / UNIT_ROUNDOFF
    assert condition.flatten().tolist() == pytest.approx([2 * (1 - alpha**2) / alpha] * 3, rel=2e-3)


def test_limit_is_what_a_turn_of_the_normals_does():
    # Turned by one rounding in random directions, a value changes by |dL/dn| u times a cosine whose square is 1/2 on average.
    svbrdf = make_material("tiles", 24)
    exact, limit = limit_of(svbrdf, THREE)
    first, second = (m["normal"] - svbrdf["normal"].double() for m in turned_normals(svbrdf, 1.0))
    angle = torch.rand(24, 24, 1, generator=torch.Generator().manual_seed(3), dtype=torch.float64) * 2 * torch.pi
    turned = svbrdf["normal"].double() + UNIT_ROUNDOFF * (angle.cos() * first + angle.sin() * second)
    moved = render_and_gradients(TWIN, SVBRDF("roughconductor", {**svbrdf.to(torch.float64).maps, "normal": turned}), THREE)
    shares = {"image": (moved.image - exact.image) / limit.image}
    shares |= {n: (moved.gradients[n] - exact.gradients[n]) / limit.gradients[n] for n in exact.gradients}
    for name, share in shares.items():
        assert float(share.abs().max()) < 1.001, name
        assert float(share.square().mean()) == pytest.approx(0.5, rel=0.1), name


def test_limit_predicts_what_rounded_normals_cost():
    # Normals stored as (n + 1) / 2 in float32, a texture's way: measured 0.25 of the limit on average.
    svbrdf = corner_materials(32)["roughness 0.1"]
    exact, limit = limit_of(svbrdf, GRID)
    stored = ((svbrdf["normal"] + 1) / 2).double() * 2 - 1
    image = TWIN.render(SVBRDF("roughconductor", {**svbrdf.maps, "normal": stored}), GRID)
    measured = image_error(image, exact.image)
    predicted = image_error(exact.image + limit.image, exact.image)
    for name in ("mean", "p99.9"):
        assert 0.1 * predicted[name] < measured[name] < predicted[name]


@pytest.mark.parametrize("bsdf", BOTH)
def test_diffuse_radiance(bsdf):
    views = Views.of(GRID.camera[:2], GRID.camera[:2] + torch.tensor([0.4, 0.0, 0.0]), 10.0)
    svbrdf = as_bsdf(make_material("plates", 16), bsdf).to(torch.float64)
    diffuse = diffuse_radiance(TWIN, svbrdf, views)
    if bsdf == "roughconductor":  # Lambert's closed form, by way of a material that has no other lobe
        wanted = TWIN.render(SVBRDF(bsdf, {**svbrdf.maps, "specular": torch.zeros_like(svbrdf["specular"])}), views)
    else:  # the lobes of dielectric and metal, each alone, are what is left
        def alone(metallic, **maps):
            held = {"metallic": torch.full_like(svbrdf["metallic"], metallic)}
            return TWIN.render(SVBRDF(bsdf, {**svbrdf.maps, **held, **maps}), views)
        metallic = svbrdf["metallic"]
        glass = alone(0.0, base_color=torch.zeros_like(svbrdf["base_color"]))
        wanted = TWIN.render(svbrdf, views) - (1 - metallic) * glass - metallic * alone(1.0)
    assert float((diffuse - wanted).abs().max()) < 1e-5 * float(wanted.max())  # F0 is cut at 1e-6 away from the camera


def test_worst_texels_are_found_and_placed():
    svbrdf, views = make_material("leather", 16), THREE
    from mitsvbrdf.verify.float32_limits import Truth
    exact, limit = limit_of(svbrdf, views)
    truth = Truth(svbrdf, views, ["a", "b", "c"], exact.image, diffuse_radiance(TWIN, svbrdf, views), limit.image / exact.image)
    image = exact.image.clone()
    image[1, 4, 9, 2] *= 1.5
    image[2, 11, 3, 0] *= 0.8
    image[0, 11, 3, 0] *= 1.1  # the same texel in another view: named once, by its worst
    first, second = worst_texels(truth, image, torch.ones(16, 16, dtype=torch.bool), count=2)
    assert (first["view"], first["row"], first["column"], first["channel"]) == ("b", 4, 9, "b")
    assert first["relative_error"] == pytest.approx(0.5, rel=1e-9) and "not explained" in first["why"]
    assert (second["view"], second["row"], second["column"], second["channel"]) == ("c", 11, 3, "r")
    # Angles by hand: camera and light are at one place, so all three are the angle to the normal.
    at = torch.tensor([(9 + 0.5) / 16 - 0.5, 0.5 - (4 + 0.5) / 16, 0.0], dtype=torch.float64)
    to_light = torch.nn.functional.normalize(views.camera[1] - at, dim=0)
    degrees = math.degrees(math.acos(float(to_light @ svbrdf["normal"][4, 9].double())))
    for name in ("half_vector_angle", "incidence_angle", "camera_angle"):
        assert first[name] == pytest.approx(degrees, abs=1e-3)  # normals are float32: 6e-8 rad, and acos near 1


@pytest.mark.parametrize("change, words", [
    ({}, "rounding, 2 times"), ({"value": None}, "not finite"), ({"reference": 0.0}, "faces away"),
    ({"relative_error": 1e-4}, "not explained by float32: 839 times"), ({"incidence_angle": 89.5}, "grazing, 89.50 degrees"),
    ({"camera_angle": 89.5}, "grazing"), ({"share_of_mean": 1e-5}, "dark: value 1.0e-05 of the mean"),
    ({"specular_share": 0.9, "limit": 3e-6, "roughness": 0.12}, "low roughness 0.12, 4 degrees beside the mirror direction: "
                                                                "float32 limit 3.0e-06"),
    ({"specular_share": 0.9, "limit": 3e-6, "roughness": 0.5}, "roughness 0.5,")])
def test_why(change, words):
    texel = {"value": 1.0, "reference": 1.0, "relative_error": 2 * UNIT_ROUNDOFF, "share_of_mean": 1.0, "roughness": 0.5,
             "half_vector_angle": 4.0, "incidence_angle": 4.0, "camera_angle": 4.0, "specular_share": 0.1,
             "limit": 2 * UNIT_ROUNDOFF}
    assert words in why(texel | change)


# --- materials ----------------------------------------------------------------------------------------------------------

def test_builtin_materials_cover_the_corners():
    made = {name: svbrdf.check() for name, svbrdf in builtin_materials(32).items()}
    roughness = torch.cat([m["roughness"].flatten() for m in made.values()])
    assert float(roughness.min()) < 0.0316 and float(roughness.max()) == 1
    assert float(made["roughness 0.1"]["roughness"].min()) == pytest.approx(0.1) and made["black diffuse"]["diffuse"].max() == 0
    assert made["white"]["diffuse"].min() == 1 and float(made["coloured F0"]["specular"].std(dim=-1).min()) > 0.3
    views = THREE.in_patch_sides()
    steep = TWIN.render(made["steep normals"].to(torch.float64), views)
    assert bool((steep == 0).any()) and bool((steep > 0).any())  # some texels face away
    assert {"inlay", "tiles", "leather", "plates", "flat"} <= set(made)


def test_jobs_take_turns():
    order = []
    jobs = {name: lambda name=name: order.append(name) or len(order) for name in "ab"}
    assert in_turns(jobs, repeats=2) == {"a": [3, 5], "b": [4, 6]} and order == list("ababab")
    assert in_turns(jobs, repeats=1, unmeasured=0) == {"a": [7], "b": [8]}


# --- the command and its page -------------------------------------------------------------------------------------------

def test_page_shows_every_configuration_and_needs_no_network(real, tmp_path):
    record, maps = real
    record = record | {"violations": [{"material": "leather", "bsdf": "principled", "renderer": "mitsuba", "what": "made <up>",
                                       "value": 1.25e-3, "tolerance": 1e-6, "limit": None}]}
    write_crosscheck_page(tmp_path / "page.html", record, maps)
    page = (tmp_path / "page.html").read_text()
    references = re.findall(r"""(?:src|href)=["']?([^"'\s>]+)""", page) + re.findall(r"url\(([^)]+)\)", page)
    assert references and all(target.startswith(("data:", "#")) for target in references)
    assert "<script" not in page and "@import" not in page
    for c in record["configurations"]:
        assert f'alt="error map of {c["material"]}, {c["renderer"]} · {c["bsdf"]}"' in page
        assert all(texel["why"].replace("<", "&lt;") in page for texel in c["worst_texels"])
    assert "made &lt;up&gt;" in page and "0.00125" in page
    assert "made <up>" not in page


def test_command_on_a_fit(tmp_path, capsys):
    # Falloff and flash offset are those of the fit; maps are averaged down to the resolution asked for.
    save_maps(make_material("leather", 32), tmp_path / "out/maps")
    (tmp_path / "out/fit.json").write_text(json.dumps({
        "views": {"size": 1.0, "falloff": "none", "camera": [[0.0, 0.0, 1.5]], "light": [[0.05, -0.02, 1.5]],
                  "intensity": [[20.0, 20.0, 20.0]]}, "flash_offset": {"x": 0.05, "y": -0.02},
        "capture": {"transfer": "srgb", "name": "photos", "photos": [0]}}))
    page, figures = tmp_path / "page.html", tmp_path / "figures.json"
    options = ["--renderer", "analytic", "--bsdf", "roughconductor", "--repeats", "1", "--resolution", "16"]
    assert cli.main(["crosscheck", str(tmp_path / "out"), *options, "--json", str(figures), "--html", str(page)]) == 0
    record = json.loads(figures.read_text())
    assert record["materials"] == {"out": {"resolution": 16, "bsdf": "roughconductor", "converted": {}}}
    assert record["views"]["falloff"] == "none" and record["transfer"] == "srgb" and len(record["views"]["names"]) == 9
    apart = torch.tensor(record["views"]["light"]) - torch.tensor(record["views"]["camera"])
    assert torch.allclose(apart, torch.tensor([0.05, -0.02, 0.0]))
    printed = capsys.readouterr().out
    assert "all stated tolerances hold" in printed and "left out by analytic: light falloff" in printed and page.is_file()


def test_a_black_material_has_figures_too():
    record = crosscheck({"black": flat(8, diffuse=0.0, specular=0.0)}, GRID, BOTH,
                        [make_renderer("analytic")], repeats=1)
    json.dumps(record, allow_nan=False)
    texels = [texel for c in record["configurations"] for texel in c["worst_texels"] if not texel["reference"]]
    assert texels and all(texel["relative_error"] == 0 for texel in texels) and not record["violations"]


@pytest.mark.parametrize("options, word", [
    (["--repeats", "0"], "--repeats"), (["--resolution", "4"], "--resolution"), (["--html", "."], "file to write"),
    (["--views", "builtin:sphere"], "builtin:grid"), (["nowhere"], "folder of maps")])
def test_bad_input_is_one_error(options, word, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["crosscheck", *options]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and word in message and not list(tmp_path.iterdir())


def test_a_real_material_holds(data_folder, tmp_path):
    views = ["--views", str(data_folder / "captures/cards-blue")]
    assert cli.main(["crosscheck", str(data_folder / "materials/metal-plating"), *views, "--bsdf", "roughconductor",
                     "--resolution", "32", "--repeats", "1"]) == 0


def test_a_metal_meets_the_tolerances():
    # Metallic exactly 1, narrow highlights on black: nothing but the specular lobe, down to 1e-3 of the mean.
    metal = random_material("principled", 32)
    metal = SVBRDF("principled", {**metal.maps, "metallic": torch.ones(32, 32, 1)})
    record = crosscheck({"metal": metal}, GRID, ["principled"], [make_renderer("mitsuba")], repeats=1)
    assert record["violations"] == []
