"""Sets of maps as libraries, programs and our own export name them: which file is read as what."""

import json
import warnings

import numpy as np
import pytest
import torch
from helpers.map_files import UP, written
from PIL import Image

from mitsvbrdf import cli
from mitsvbrdf.errors import AssumedWarning, ConfigError, MapsError
from mitsvbrdf.export import ExportSettings, export_material
from mitsvbrdf.fit.fixed_maps import fixed_maps
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps, save_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.material.naming import FILE_NAMES


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
    with pytest.warns(AssumedWarning, match="base_color brick_diff.png .linear"):
        assert torch.equal(load_maps(folder, encoding="diffuse=linear")["roughness"], found["roughness"])


@pytest.mark.parametrize("colour, ending, code", [
    ("Diffuse", "roughness", 204), ("Diffuse", "gloss", 51), ("COLOR", "GLOSS", 51)])
def test_a_coloured_specular_is_f0_beside_roughness_and_its_opposite(colour, ending, code, tmp_path):
    folder = written(tmp_path, t_Normal=UP, t_Specular=(255, 188, 100),
                     **{f"t_{colour}": 100, f"t_{ending}": code})
    with pytest.warns(AssumedWarning):
        found = load_maps(folder)
    assert found.bsdf == "roughconductor" and found["roughness"][0, 0, 0] == pytest.approx(0.8, abs=1e-6)
    assert found["specular"][0, 0, 1] == pytest.approx(((188 / 255 + 0.055) / 1.055) ** 2.4, abs=1e-6)


def test_both_parameter_sets_with_plain_names_are_those_of_libraries(tmp_path):
    """As in MatSynth: basecolor and metallic beside diffuse and specular; colours sRGB, the rest linear."""
    folder = written(tmp_path, basecolor=188, diffuse=128, specular=60, metallic=20, roughness=117, normal=UP)
    for bsdf, name, level in (("principled", "base_color", 188), ("roughconductor", "diffuse", 128)):
        with pytest.warns(AssumedWarning, match="roughness.png .linear"):
            found = load_maps(folder, bsdf)
        assert found["roughness"][0, 0].item() == pytest.approx(117 / 255)
        assert found[name][0, 0, 0].item() == pytest.approx(((level / 255 + 0.055) / 1.055) ** 2.4, abs=1e-6)
    (folder / "basecolor.png").unlink()  # a metallic map is used beside a diffuse one, too
    with pytest.warns(AssumedWarning):
        assert load_maps(folder, "principled")["metallic"][0, 0].item() == pytest.approx(20 / 255)


def test_the_fields_names_keep_gamma_and_say_so(tmp_path):
    folder = written(tmp_path, diffuse=128, specular=11, roughness=117, normal=UP)
    with pytest.warns(AssumedWarning, match="gamma 2.2.*F0 of 0.00099 is below.*read as linear it is 0.043"):
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


@pytest.mark.parametrize("encoding", ["roughnes=linear", "roughness=lineal", "lineal", "roughness=",
                                      "roughness=linear,rough=srgb"])
def test_misspelt_options_are_refused(encoding, tmp_path):
    with pytest.raises(ConfigError, match="--encoding"):
        load_maps(written(tmp_path, diffuse=128, specular=60, roughness=128, normal=UP), encoding=encoding)


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
    assert said.count("note: ") == 1 and "specular read as gamma 2.2" in said


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
        said = {"NDRS": "linear.*are normal, diffuse", "DNRS": "gamma 2.2.*are diffuse, normal"}[order]
        with pytest.warns(AssumedWarning, match=said):
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


@pytest.mark.parametrize("name", ["brick.png", "rusty_metal.png", "diffuse.png"])  # words of maps, or none
def test_the_only_picture_of_a_folder_is_a_strip_if_it_has_its_shape(name, tmp_path):
    pixels = np.full((8, 32, 3), 128, np.uint8)
    pixels[:, :8] = 128, 128, 255  # flat normals first
    Image.fromarray(pixels).save(tmp_path / name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AssumedWarning)
        assert load_maps(tmp_path)["roughness"].shape == (8, 8, 1)
    Image.fromarray(pixels[:, :16]).save(tmp_path / name)
    with pytest.raises(MapsError, match="material needs|square"):  # no strip, but no map either
        load_maps(tmp_path)
