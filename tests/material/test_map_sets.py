"""Sets of maps as libraries, programs and our own export name them: which file is read as what."""

import json
import warnings

import numpy as np
import pytest
import torch
from PIL import Image

from mitsvbrdf import cli
from mitsvbrdf.errors import AssumedWarning, ConfigError, MapsError
from mitsvbrdf.export import ExportSettings, export_material
from mitsvbrdf.fit.fixed_maps import fixed_maps
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps, save_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.material.naming import FILE_NAMES, sources

# File lists of downloads; the value is the file (and channel) of each map.
SETS = {
    "Poly Haven": ("rusty_metal_02_ao_1k.png rusty_metal_02_arm_1k.png rusty_metal_02_diff_1k.png "
                   "rusty_metal_02_disp_1k.png rusty_metal_02_metal_1k.png rusty_metal_02_nor_dx_1k.png "
                   "rusty_metal_02_nor_gl_1k.png rusty_metal_02_rough_1k.png",
                   "diffuse=rusty_metal_02_diff_1k.png metallic=rusty_metal_02_metal_1k.png "
                   "normal=rusty_metal_02_nor_gl_1k.png roughness=rusty_metal_02_rough_1k.png"),
    "Poly Haven of glTF": ("brick_arm_2k.jpg brick_diff_2k.jpg brick_nor_gl_2k.jpg",
                           "diffuse=brick_diff_2k.jpg normal=brick_nor_gl_2k.jpg "
                           "roughness=brick_arm_2k.jpg:1 metallic=brick_arm_2k.jpg:2"),
    "ambientCG": ("Metal046B.png Metal046B_1K-JPG_Color.jpg Metal046B_1K-JPG_Displacement.jpg "
                  "Metal046B_1K-JPG_Metalness.jpg Metal046B_1K-JPG_NormalDX.jpg "
                  "Metal046B_1K-JPG_NormalGL.jpg "
                  "Metal046B_1K-JPG_Roughness.jpg",
                  "base_color=Metal046B_1K-JPG_Color.jpg metallic=Metal046B_1K-JPG_Metalness.jpg "
                  "normal=Metal046B_1K-JPG_NormalGL.jpg roughness=Metal046B_1K-JPG_Roughness.jpg"),
    "Substance": ("Wood_BaseColor.png Wood_Height.png Wood_Metallic.png Wood_Normal_DirectX.png "
                  "Wood_Roughness.png", "base_color=Wood_BaseColor.png metallic=Wood_Metallic.png "
                  "normal=Wood_Normal_DirectX.png roughness=Wood_Roughness.png"),
    "Substance for Unreal": ("T_Wood_BaseColor.png T_Wood_Normal.png T_Wood_OcclusionRoughnessMetallic.png",
                             "base_color=T_Wood_BaseColor.png normal=T_Wood_Normal.png roughness="
                             "T_Wood_OcclusionRoughnessMetallic.png:1 metallic="
                             "T_Wood_OcclusionRoughnessMetallic.png:2"),
    "glTF's samples": ("Default_albedo.jpg Default_AO.jpg Default_emissive.jpg Default_metalRoughness.jpg "
                       "Default_normal.jpg", "base_color=Default_albedo.jpg normal=Default_normal.jpg "
                       "roughness=Default_metalRoughness.jpg:1 metallic=Default_metalRoughness.jpg:2"),
    "roughness first": ("x_col.png x_rma.png x_nrm.png", "base_color=x_col.png normal=x_nrm.png "
                        "roughness=x_rma.png:0 metallic=x_rma.png:1"),
    "gloss": ("Tiles_COLOR.jpg Tiles_GLOSS.jpg Tiles_NORM.jpg Tiles_SPEC.jpg",
              "base_color=Tiles_COLOR.jpg roughness=Tiles_GLOSS.jpg normal=Tiles_NORM.jpg "
              "specular=Tiles_SPEC.jpg"),
}


@pytest.mark.parametrize("library", SETS)
def test_files_are_known_by_their_names(library, tmp_path):
    files, wanted = SETS[library]
    for file in files.split():
        (tmp_path / file).touch()
    found, passed = sources(tmp_path)
    assert {f"{name}={source.path.name}" + f":{source.channel}" * (source.channel is not None)
            for name, source in found.items()} == set(wanted.split())
    assert found["roughness"].inverted == (library == "gloss")
    assert found["normal"].convention == {"Poly Haven": "gl", "Poly Haven of glTF": "gl", "ambientCG": "gl",
                                          "Substance": "dx"}.get(library, "")
    assert {path.name for path in passed} == set(files.split()) - {s.path.name for s in found.values()}


def written(folder, **images):
    """PNG files of these numbers of 255: a grey level, or a colour."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, value in images.items():
        Image.fromarray(np.full((8, 8, 3), value, np.uint8)).save(folder / f"{name}.png")
    return folder


UP = (128, 128, 255)


@pytest.mark.parametrize("bsdf", ["roughconductor", "principled"])
@pytest.mark.parametrize("normal", ["gl", "dx"])
@pytest.mark.parametrize("naming", FILE_NAMES)
def test_an_export_read_and_exported_again_has_the_same_bytes(naming, normal, bsdf, tmp_path):
    """For roughconductor materials, metal/rough names need the specular level: F0 must be grey, up to .08."""
    made = make_material("plates", 32)
    if bsdf == "principled":
        made = flat(32, "principled", metallic=0.3, roughness=0.4).map(lambda t: t.clone())
        made.maps["normal"][:] = make_material("plates", 32)["normal"]
    settings = ExportSettings("Old brick!", naming, normal)
    export_material(made, tmp_path / "a", ["maps"], settings=settings)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AssumedWarning)
        read = load_maps(tmp_path / "a" / "maps")
    export_material(read, tmp_path / "b", ["maps"], settings=settings)
    for path in (tmp_path / "a" / "maps").glob("*.png"):
        first, again = (np.asarray(Image.open(tmp_path / side / "maps" / path.name)).astype(int)
                        for side in "ab")
        derived = any(word in path.stem.lower()
                      for word in ("height", "disp", "occlusion", "_ao", "specular_level"))
        assert derived or np.abs(first - again).max() <= 1, path.name


def test_a_downloaded_set_has_the_encodings_of_libraries(tmp_path):
    folder = written(tmp_path / "s", brick_diff=188, brick_arm=(10, 128, 0), brick_nor_gl=UP, brick_disp=50)
    with pytest.warns(AssumedWarning, match="base_color brick_diff.png .srgb.*passed over brick_disp.png"):
        found = load_maps(folder)
    assert found.bsdf == "principled" and found["roughness"][0, 0, 0] == pytest.approx(128 / 255)
    assert found["base_color"][0, 0, 0] == pytest.approx(((188 / 255 + 0.055) / 1.055) ** 2.4, abs=1e-6)
    assert found["metallic"].max() == 0
    (folder / "textures").mkdir()
    for path in folder.glob("*.png"):
        path.rename(folder / "textures" / path.name)
    with pytest.warns(AssumedWarning):
        assert torch.equal(load_maps(folder)["roughness"], found["roughness"])


def test_a_missing_metallic_map_is_0_and_said(tmp_path):
    with pytest.warns(AssumedWarning, match="no metallic map, so it is 0"):
        found = load_maps(written(tmp_path, w_Color=100, w_Roughness=90, w_NormalGL=UP))
    assert found.bsdf == "principled" and not found["metallic"].any()


def test_gloss_is_one_minus_roughness_and_a_coloured_specular_is_f0(tmp_path):
    with pytest.warns(AssumedWarning):
        found = load_maps(written(tmp_path, t_COLOR=100, t_GLOSS=51, t_NRM=UP, t_SPEC=(255, 188, 100)))
    assert found.bsdf == "roughconductor" and found["roughness"][0, 0, 0] == pytest.approx(0.8, abs=1e-6)
    assert found["specular"][0, 0, 1] == pytest.approx(((188 / 255 + 0.055) / 1.055) ** 2.4, abs=1e-6)


def test_the_fields_names_keep_gamma_and_say_so(tmp_path):
    folder = written(tmp_path, diffuse=128, specular=11, roughness=117, normal=UP)
    with pytest.warns(AssumedWarning, match="gamma 2.2.*F0 of 0.00099 is below.*as linear it is 0.043"):
        assert load_maps(folder)["roughness"][0, 0, 0] == pytest.approx((117 / 255) ** 2.2)
    assert load_maps(folder, encoding="linear")["roughness"][0, 0, 0] == pytest.approx(117 / 255)
    with pytest.warns(AssumedWarning):
        found = load_maps(folder, encoding="roughness=raw")
    assert found["roughness"][0, 0, 0] == pytest.approx(117 / 255)
    assert found["diffuse"][0, 0, 0] == pytest.approx((128 / 255) ** 2.2)


@pytest.mark.parametrize("stated, roughness", [
    ("sRGB", ((128 / 255 + 0.055) / 1.055) ** 2.4), ("raw", 128 / 255), ("Non-Color", 128 / 255),
    ("gamma2.2", (128 / 255) ** 2.2)])
def test_material_json_has_words_of_other_programs(stated, roughness, tmp_path):
    folder = written(tmp_path, diffuse=128, specular=60, roughness=128, normal=UP)
    (folder / "material.json").write_text(json.dumps({"encoding": {"roughness": stated}}))
    with pytest.warns(AssumedWarning):
        assert load_maps(folder)["roughness"][0, 0, 0] == pytest.approx(roughness, abs=1e-3)


@pytest.mark.parametrize("about, words", [
    ({"encoding": {"roughnes": "linear"}}, ("material.json", "roughnes")),
    ({"encoding": {"roughness": "lineal"}}, ("material.json", "encoding.roughness", "lineal")),
    ({"encodings": {"roughness": "linear"}}, ("material.json", "encodings")),
    ({"encoding": {"normal": "upside down"}}, ("material.json", "encoding.normal"))])
def test_misspellings_are_answered_with_file_and_key(about, words, tmp_path):
    folder = written(tmp_path, diffuse=128, specular=60, roughness=128, normal=UP)
    (folder / "material.json").write_text(json.dumps(about))
    with pytest.raises(MapsError) as found:
        load_maps(folder)
    assert all(word in str(found.value) for word in words)


@pytest.mark.parametrize("encoding", ["roughnes=linear", "roughness=lineal", "lineal", "roughness="])
def test_misspelt_options_are_refused(encoding, tmp_path):
    with pytest.raises(ConfigError, match="--encoding"):
        load_maps(written(tmp_path, diffuse=128, specular=60, roughness=128, normal=UP), encoding=encoding)


def test_two_materials_in_a_folder_are_refused(tmp_path):
    written(tmp_path, brick_diff=128, wood_diff=128, brick_rough=128, brick_nor_gl=UP)
    with pytest.raises(MapsError, match="one diffuse map.*brick_diff.png and wood_diff.png"):
        load_maps(tmp_path)


@pytest.mark.parametrize("files, word", [
    ({"roughness": (10, 128, 250)}, "roughness in grey"), ({"normal": 150}, "grey"),
    ({"normal": (250, 220, 200)}, "length 1")])
def test_other_maps_in_the_place_of_roughness_and_normals_are_refused(files, word, tmp_path):
    images = dict(diffuse=128, specular=60, roughness=128, normal=UP) | files
    with pytest.raises(MapsError, match=word):
        load_maps(written(tmp_path, **images), encoding="linear")


def test_a_fixed_map_has_the_habit_of_its_name(tmp_path):
    folder = written(tmp_path, brick_rough=128, roughness=128)
    for file, wanted in {"brick_rough": 128 / 255, "roughness": (128 / 255) ** 2.2}.items():
        with pytest.warns(AssumedWarning, match="encoding .* in a material.json beside it overrules"):
            fixed = fixed_maps([f"roughness={folder / file}.png"], "roughconductor", 8)
        assert fixed["roughness"][0, 0, 0] == pytest.approx(wanted)


def test_commands_have_the_options_and_print_one_note(tmp_path, capsys):
    folder = written(tmp_path / "m", diffuse=128, specular=60, roughness=128, normal=UP)
    save_maps(flat(8, roughness=128 / 255), tmp_path / "mine")
    figures = tmp_path / "f.json"
    assert cli.main(["evaluate", str(tmp_path / "mine"), "--reference", str(folder), "--encoding",
                     "roughness=linear", "--encoding", "diffuse=srgb", "--json", str(figures)]) == 0
    assert json.loads(figures.read_text())["roughness"] < 1e-6
    said = capsys.readouterr().err
    assert said.count("note: ") == 1 and "specular taken for gamma 2.2" in said


def test_a_downloaded_chess_set(data_folder):
    """Means of the files' decoded values, by Pillow's pixels and the formula of IEC 61966-2-1."""
    with pytest.warns(AssumedWarning):
        found = load_maps(data_folder / "files" / "3")
    assert float(found["roughness"].mean()) == pytest.approx(0.272, abs=1e-3)
    assert found["base_color"].mean((0, 1)).numpy() == pytest.approx([0.05295, 0.05885, 0.05018], abs=2e-4)


@pytest.mark.parametrize("order", ["NDRS", "DNRS"])
@pytest.mark.parametrize("photo", [False, True])
def test_a_strip_is_read_in_the_order_that_its_normals_tell(order, photo, tmp_path):
    """Deschaintre's are linear, MaterialGAN's have gamma 2.2; five squares begin with a photo."""
    stored = {"N": (128, 128, 255), "D": (40, 20, 230), "R": (60, 60, 60), "S": (90, 80, 70)}
    squares = [np.full((8, 8, 3), stored[letter], np.uint8) for letter in "D" * photo + order]
    path = tmp_path / "tex.png"
    Image.fromarray(np.concatenate(squares, axis=1)).save(path)
    power = {"NDRS": 1.0, "DNRS": 2.2}[order]
    for given in (path, tmp_path):
        with pytest.warns(AssumedWarning, match={"NDRS": "linear", "DNRS": "gamma 2.2"}[order]):
            found = load_maps(given)
        assert found["normal"][..., 2].min() > 0.999
        for letter, name in {"D": "diffuse", "R": "roughness", "S": "specular"}.items():
            wanted = (np.array(stored[letter]) / 255) ** power
            assert np.allclose(found[name], wanted[:found[name].shape[-1]], atol=1e-5), name
    srgb = load_maps(path, encoding="srgb")["specular"]
    assert srgb[0, 0, 0] == pytest.approx(0.1022, abs=1e-4)  # IEC 61966


@pytest.mark.parametrize("count", [1, 3, 6, 4.5])
def test_a_strip_of_other_shape_is_refused(count, tmp_path):
    Image.new("RGB", (int(8 * count), 8)).save(tmp_path / "maps.png")
    with pytest.raises(MapsError, match="four or five squares"):
        load_maps(tmp_path / "maps.png")


def test_the_only_picture_of_a_folder_is_a_strip_if_it_has_its_shape(tmp_path):
    pixels = np.full((8, 32, 3), 128, np.uint8)
    pixels[:, :8] = 128, 128, 255  # flat normals first
    Image.fromarray(pixels).save(tmp_path / "brick.png")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AssumedWarning)
        assert load_maps(tmp_path)["roughness"].shape == (8, 8, 1)
    Image.fromarray(pixels[:, :16]).save(tmp_path / "brick.png")
    with pytest.raises(MapsError, match="material needs"):  # no strip, but no map either
        load_maps(tmp_path)
