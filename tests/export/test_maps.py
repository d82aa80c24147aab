"""Maps for other programs, read back."""

import json
import re

import cv2
import numpy as np
import pytest
import torch
from helpers.exported import decoded, stated

from mitsvbrdf.export import ExportSettings, export_material
from mitsvbrdf.export.maps import _safe
from mitsvbrdf.material.conversion import as_principled
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.material.naming import FILE_NAMES
from mitsvbrdf.material.relief import heights
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.testing import random_material
from mitsvbrdf.views import Views

DERIVED = ("occlusion", "occlusion in R, roughness in G, metallic in B")


def wanted_maps(material):
    """Both parameter sets; specular level L of Blender, Unreal and Substance is F0 = 0.08 L."""
    both = dict(material.as_roughconductor().maps)
    if material.bsdf == "principled":
        return both | dict(material.maps)
    metallic = as_principled(material)["metallic"]
    level = (both["specular"].mean(dim=-1, keepdim=True) / 0.08).clamp(max=1)
    base = torch.where(metallic > 0, both["specular"], (both["diffuse"] / (1 - 0.08 * level)).clamp(max=1))
    return both | {"metallic": metallic, "base_color": base,
                   "specular_level": torch.where(metallic > 0, 0.5, level)}


@pytest.mark.parametrize("normal", ["gl", "dx"])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("naming", FILE_NAMES)
def test_maps_are_what_export_json_says(material, naming, bits, normal, tmp_path):
    export_material(material, tmp_path, ["maps"], settings=ExportSettings("Old brick!", naming, normal, bits))
    folder, said = tmp_path / "maps", stated(tmp_path / "maps")
    there = {path.name for path in folder.iterdir()}
    assert there - {"material.json"} == {texture["file"] for texture in said["textures"]} | {"export.json"}
    for texture in said["textures"]:
        name, pixels = texture["holds"], cv2.imread(str(folder / texture["file"]), cv2.IMREAD_UNCHANGED)
        assert pixels.dtype == {8: np.uint8, 16: np.uint16}[texture["bits"]]
        # 256 steps of height are stairs
        assert texture["bits"] == (16 if name.startswith("height") else bits)
        assert texture["colour_space"] == ("sRGB" if name in ("diffuse", "specular", "base_color")
                                           else "linear")
        if name in DERIVED or name.startswith("height"):
            continue
        found, wanted = decoded(folder / texture["file"],
                                texture["colour_space"]), wanted_maps(material)[name].numpy()
        if name == "normal":
            assert ("DirectX" if normal == "dx" else "OpenGL") in texture["normal"]
            found, wanted = found * 2 - 1, wanted * ([1, -1, 1] if normal == "dx" else [1, 1, 1])
        # The steepest the decoding gets is 2.3 (sRGB at 1); (n + 1) / 2 doubles a step.
        assert np.abs(found - wanted).max() < 2.3 * 0.5 / (2**bits - 1) + 1e-6


def test_names_are_those_of_the_libraries(tmp_path):
    names = {
        "polyhaven": {"Old_brick_diff", "Old_brick_metal", "Old_brick_rough", "Old_brick_nor_gl",
                      "Old_brick_spec", "Old_brick_disp", "Old_brick_ao", "Old_brick_arm"},
        "ambientcg": {"Old_brick_Color", "Old_brick_Metalness", "Old_brick_Roughness", "Old_brick_NormalGL",
                      "Old_brick_Specular", "Old_brick_Displacement", "Old_brick_AmbientOcclusion"},
        "substance": {"Old_brick_BaseColor", "Old_brick_Metallic", "Old_brick_Roughness",
                      "Old_brick_Normal_OpenGL", "Old_brick_SpecularLevel", "Old_brick_Height",
                      "Old_brick_AmbientOcclusion", "Old_brick_ORM"},
        "materialgan": {"dif", "spe", "rgh", "nom"},
        "own": {"diffuse", "specular", "base_color", "metallic", "roughness", "normal", "specular_level",
                "height", "occlusion", "occlusion_roughness_metallic"}}
    for naming, expected in names.items():
        export_material(flat(4), tmp_path / naming, ["maps"], settings=ExportSettings("Old brick!", naming))
        assert {path.stem for path in (tmp_path / naming / "maps").glob("*.png")} == expected
        assert len(json.loads((tmp_path / naming / "maps/export.json").read_text())["files"]) == len(expected)


# What Blender's Node Wrangler takes a file for, by the words of its name.
BLENDER_WORDS = {"base_color": {"diffuse", "diff", "albedo", "base", "col", "color", "basecolor"},
    "metallic": {"metallic", "metalness", "metal", "mtl"}, "roughness": {"roughness", "rough", "rgh"},
    "normal": {"normal", "nor", "nrm", "nrml", "norm"}, "specular_level": {"specular", "spec", "spc"},
    "height": {"displacement", "displace", "disp", "dsp", "height", "heightmap"}, "occlusion": {"ao",
    "ambient", "occlusion"}}


@pytest.mark.parametrize("naming", ["polyhaven", "ambientcg", "substance"])
def test_blender_knows_the_files_by_their_names(naming, tmp_path):
    export_material(flat(4), tmp_path, ["maps"], settings=ExportSettings("brick", naming))
    for texture in stated(tmp_path / "maps")["textures"]:
        words = {word.lower() for word in re.findall("[A-Z]?[a-z]+|[A-Z]+",
                                                     texture["file"].removesuffix(".png"))}
        meanings = {meaning for meaning, known in BLENDER_WORDS.items() if words & known}
        if texture["file"].endswith(("_arm.png", "_ORM.png")):
            assert not meanings  # several maps in one: for engines, and passed by
            continue
        assert meanings == {texture["holds"].split()[0].rstrip(",")}, texture["file"]


@pytest.mark.parametrize("naming, normal", zip(("own", "materialgan", "deschaintre") * 2, ("gl", "dx") * 3))
def test_exported_maps_are_read_again(material, naming, normal, tmp_path):
    material = random_material(material.bsdf, 32)
    export_material(material, tmp_path, ["maps"], settings=ExportSettings(naming=naming, normal=normal))
    found, wanted = load_maps(tmp_path), material if naming == "own" else material.as_roughconductor()
    assert found.bsdf == wanted.bsdf
    for name, value in wanted.maps.items():
        assert (found[name] - value).abs().max() < 3e-5  # steps of 16 bits


def test_directx_normals_are_opengl_normals_with_green_turned_around(tmp_path):
    """A bump lit from above is bright on its upper side; read in the wrong convention it is a dent."""
    step = (torch.arange(32) + 0.5) / 32 - 0.5
    y, x = torch.meshgrid(-step, step, indexing="ij")
    height = 0.1 * torch.exp(-(x**2 + y**2) / 0.02)
    slopes = torch.stack((x, y), dim=-1) * (height / 0.01)[..., None]  # minus the gradient of the height
    normal = torch.nn.functional.normalize(torch.cat((slopes, torch.ones(32, 32, 1)), dim=-1), dim=-1)
    maps = flat(32, diffuse=0.6, specular=0.02, roughness=0.8)
    maps = SVBRDF("roughconductor", dict(maps.maps) | {"normal": normal})
    # far away: all texels see it alike
    lamp = Views.of([[0.0, 0.0, 3.0]], light=[[0.0, 40.0, 40.0]], intensity=1e4)

    def shown(normal):
        decoded_maps = dict(maps.maps) | {
            "normal": torch.nn.functional.normalize(torch.from_numpy(normal), dim=-1)}
        return AnalyticRenderer(torch.float64).render(SVBRDF("roughconductor", decoded_maps),
                                                      lamp)[0].mean(dim=-1)

    found = {}
    for convention, file in (("gl", "normal.png"), ("dx", "normal_dx.png")):
        export_material(maps, tmp_path / convention, ["maps"], settings=ExportSettings(normal=convention))
        found[convention] = decoded(tmp_path / convention / "maps" / file, "linear") * 2 - 1
    above, below = slice(8, 16), slice(16, 24)  # rows on the two sides of the top of the bump
    right, wrong = shown(found["gl"]), shown(found["dx"])
    assert right[above, 8:24].mean() > 1.3 * right[below, 8:24].mean()  # measured 1.47 times
    assert wrong[above, 8:24].mean() < wrong[below, 8:24].mean() / 1.3
    turned = shown(found["dx"] * [1, -1, 1])
    assert (turned - right).abs().max() < 1e-4 * right.max()  # one step of 16 bits


def test_the_height_is_right_at_a_displacements_scale_of_1(tmp_path):
    """On a square of side 1 with the middle at 0.5, as programs have it by default; nothing is stretched."""
    made = make_material("plates", 64)
    export_material(made, tmp_path, ["maps"], settings=ExportSettings(naming="polyhaven", side=0.5))
    (said,) = (texture["holds"] for texture in stated(tmp_path / "maps")["textures"]
               if texture["holds"].startswith("height"))
    assert said == "height over the patch's side, 0.5 metres, plus 0.5"
    found = decoded(tmp_path / "maps/material_disp.png", "linear")[..., 0] - 0.5
    assert np.abs(found - heights(made["normal"]).numpy()).max() < 0.51 / 65535
    export_material(flat(8), tmp_path / "flat", ["maps"], settings=ExportSettings(naming="polyhaven"))
    assert np.ptp(decoded(tmp_path / "flat/maps/material_disp.png", "linear")) == 0


def test_long_names_are_cut(tmp_path):
    export_material(flat(4), tmp_path, ["maps"], settings=ExportSettings("y" * 300, "polyhaven"))
    assert (tmp_path / f"maps/{'y' * 100}_diff.png").is_file()


def test_packed_maps_are_those_of_the_single_files(tmp_path):
    export_material(make_material("plates", 32), tmp_path, ["maps"],
                    settings=ExportSettings(naming="polyhaven"))
    packed, *single = (decoded(tmp_path / f"maps/material_{name}.png", "linear")
                       for name in ("arm", "ao", "rough", "metal"))
    assert np.abs(packed - np.concatenate([each[..., :1] for each in single], axis=-1)).max() == 0


def test_materials_of_any_script_have_file_names_of_their_own():
    names = ["\u6728\u7eb9", "\u77f3\u5934", "\u0434\u0435\u0440\u0435\u0432\u043e", "\u0915\u093f",
             "\u0915\u0940", "\U0001fab5", "\U0001faa8", "\udc80", "Eiche Natur"]
    safe = [_safe(name) for name in names]
    assert len(set(safe)) == len(names) and safe[0] == names[0] and safe[-1] == "Eiche_Natur"
    assert _safe("\u6728" * 200) == "\u6728" * 33 and _safe("") == "material"
    # As before where all letters are Latin: every other sign is one "_", none at the ends.
    assert [_safe(name) for name in (" a _b", "x.y/z", "-a-", "__")] == ["a__b", "x_y_z", "-a-", _safe("__")]
