"""Which file is which map, by the names that libraries, programs and systems give."""

import numpy as np
import pytest
from helpers.map_files import UP, written
from PIL import Image

from mitsvbrdf.errors import AssumedWarning, MapsError
from mitsvbrdf.fit.fixed_maps import fixed_maps
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.material.naming import sources

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
                  "Metal046B_1K-JPG_NormalGL.jpg Metal046B_1K-JPG_Roughness.jpg",
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
    "Poliigon": ("Rust_COL_2K_METALNESS.jpg Rust_METALNESS_2K_METALNESS.jpg Rust_NRM_2K_METALNESS.jpg "
                 "Rust_DISP16_2K_METALNESS.png Rust_FUZZ_2K_METALNESS.jpg Rust_ROUGHNESS_2K_METALNESS.jpg",
                 "base_color=Rust_COL_2K_METALNESS.jpg metallic=Rust_METALNESS_2K_METALNESS.jpg "
                 "normal=Rust_NRM_2K_METALNESS.jpg roughness=Rust_ROUGHNESS_2K_METALNESS.jpg"),
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


@pytest.mark.parametrize("name, beside, map_name, stored", [
    ("MetallicSmoothness", {"AlbedoTransparency": 188}, "metallic", (64, 64, 64)),
    ("AlbedoSmoothness", {"Metallic": 64}, "base_color", (188, 100, 20)),
    ("SpecularSmoothness", {"AlbedoTransparency": 100}, "specular", (188, 100, 20)),
    ("MaskMap", {"BaseMap": 188}, "metallic", (64, 200, 9))])
def test_smoothness_of_unity_lies_in_the_alpha(name, beside, map_name, stored, tmp_path):
    """Standard, specular and HDRP shaders of Unity: one minus roughness is the alpha of another map."""
    written(tmp_path, **{f"Wood_{key}": value for key, value in (beside | {"Normal": UP}).items()})
    Image.new("RGBA", (8, 8), (*stored, 51)).save(tmp_path / f"Wood_{name}.png")
    with pytest.warns(AssumedWarning):
        found = load_maps(tmp_path)
    assert found["roughness"][0, 0].item() == pytest.approx(0.8, abs=1e-6)
    value = np.array(stored) / 255
    wanted = value[:1] if map_name == "metallic" else np.where(
        value > 0.04045, ((value + 0.055) / 1.055) ** 2.4, value / 12.92)
    assert found[map_name][0, 0].tolist() == pytest.approx(wanted.tolist(), abs=1e-5)
    with pytest.warns(AssumedWarning):
        fixed = fixed_maps([f"roughness={tmp_path / f'Wood_{name}.png'}"], "roughconductor", 8)
    assert fixed["roughness"][0, 0].item() == pytest.approx(0.8, abs=1e-6)
    Image.new("RGB", (8, 8), stored).save(tmp_path / f"Wood_{name}.png")
    with pytest.raises(MapsError, match="without alpha"):
        load_maps(tmp_path)


def test_an_alpha_that_is_not_read_is_named(tmp_path):
    written(tmp_path, w_Roughness=128, w_NormalGL=UP)
    Image.new("RGBA", (8, 8), (90, 90, 90, 0)).save(tmp_path / "w_Color.png")
    with pytest.warns(AssumedWarning, match="passed over the alpha of w_Color.png"):
        load_maps(tmp_path)


@pytest.mark.parametrize("extra", ["rusty_metal_glow", "rusty_metal_2", "._rusty_metal_rough"])
def test_what_is_no_map_does_not_become_one(extra, tmp_path):
    """Words of the material in the name of another picture; hidden files as macOS packs them."""
    written(tmp_path, rusty_metal_diff=188, rusty_metal_rough=128, rusty_metal_nor_gl=UP, **{extra: 250})
    with pytest.warns(AssumedWarning, match="no metallic map, so it is 0"):
        found = load_maps(tmp_path)
    assert not found["metallic"].any() and found.bsdf == "principled"
    assert found["roughness"][0, 0].item() == pytest.approx(128 / 255)


def test_a_grey_map_is_not_taken_for_several(tmp_path):
    """metal_rough may be the roughness of a metal, or both maps in green and blue: a grey one is not both."""
    written(tmp_path, metal_color=188, metal_rough=128, nor_gl=UP)
    levels = np.arange(64, dtype=np.uint8).reshape(8, 8)
    Image.fromarray(levels).save(tmp_path / "metal_rough.png")
    with pytest.raises(MapsError, match="metal_rough.png, grey; name it for its one map"):
        load_maps(tmp_path)
    Image.fromarray(np.dstack((levels * 0, levels, levels * 2))).save(tmp_path / "metal_rough.png")
    with pytest.warns(AssumedWarning):
        found = load_maps(tmp_path)
    assert found["metallic"][7, 7].item() == pytest.approx(126 / 255)
    assert found["roughness"][7, 7].item() == pytest.approx(63 / 255)


def test_two_materials_in_a_folder_are_refused(tmp_path):
    written(tmp_path, brick_diff=128, wood_diff=128, brick_rough=128, brick_nor_gl=UP)
    with pytest.raises(MapsError, match="one diffuse map.*brick_diff.png and wood_diff.png"):
        load_maps(tmp_path)
