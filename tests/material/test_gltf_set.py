"""Materials of glTF files, read back from our own export and from files of known values."""

import base64
import json

import numpy as np
import pytest
import torch
from helpers.colour_files import save_in
from PIL import Image

from mitsvbrdf.errors import AssumedWarning, MapsError
from mitsvbrdf.export import export_material
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.material.maps import flat


@pytest.mark.parametrize("made", [make_material("plates", 32), flat(8, "principled", metallic=0.2)],
                         ids=["roughconductor", "principled"])
def test_our_own_file_is_read_back_within_its_bits(made, tmp_path):
    export_material(made, tmp_path, ["gltf"])
    with pytest.warns(AssumedWarning, match="read base_color"):
        found = load_maps(tmp_path / "gltf" / "material.glb")
    assert found.bsdf == made.bsdf
    for name, value in made.maps.items():  # a step of 8 bits in normals and sRGB, whose steepest slope is 2.3
        assert (found[name] - value).abs().max() < 2.5 / 255, name


def written(folder, **material):
    Image.fromarray(np.full((4, 4, 3), (9, 128, 64), np.uint8)).save(folder / "orm map.png")
    Image.fromarray(np.full((8, 8, 3), 188, np.uint8)).save(folder / "c.png")
    inline = "data:image/png;base64," + base64.b64encode((folder / "c.png").read_bytes()).decode()
    document = {"asset": {"version": "2.0"}, "images": [{"uri": "orm%20map.png"}, {"uri": inline}],
                "textures": [{"source": 0}, {"source": 1}], "materials": [material]}
    (folder / "m.gltf").write_text(json.dumps(document))
    return folder / "m.gltf"


def test_factors_files_and_sizes(tmp_path):
    """Section 3.9.2: a factor multiplies its texture, roughness is green and metallic blue."""
    path = written(tmp_path, pbrMetallicRoughness={
        "baseColorTexture": {"index": 1}, "baseColorFactor": [1, 0.5, 0.25, 1], "roughnessFactor": 0.5,
        "metallicRoughnessTexture": {"index": 0}})
    with pytest.warns(AssumedWarning):
        found = load_maps(path)
    linear = ((188 / 255 + 0.055) / 1.055) ** 2.4
    assert found.resolution == 8 and torch.equal(found["normal"][0, 0], torch.tensor([0.0, 0.0, 1.0]))
    assert found["base_color"][3, 3].tolist() == pytest.approx([linear, linear / 2, linear / 4], rel=1e-5)
    assert found["roughness"].mean().item() == pytest.approx(64 / 255)
    assert found["metallic"].mean().item() == pytest.approx(64 / 255)


@pytest.mark.parametrize("damage, word", [
    (lambda d: d["materials"].append({"name": "pawn"}), "with 2 .*pawn"),
    (lambda d: d["images"][0].update(uri="../x.png"), "beside the file"),
    (lambda d: d["textures"].clear(), "glTF 2.0 file"),
    (lambda d: d["images"][0].update(uri="no.png"), "no file"),
    (lambda d: d["materials"][0].update(extensions={"KHR_materials_ior": {"ior": -1}}), "zero")])
def test_what_cannot_be_read_is_one_error(damage, word, tmp_path):
    path = written(tmp_path, pbrMetallicRoughness={"metallicRoughnessTexture": {"index": 0}})
    document = json.loads(path.read_text())
    damage(document)
    path.write_text(json.dumps(document))
    with pytest.raises(MapsError, match=word):
        load_maps(path)


def of_base(transform=None, other=None, **material):
    """A material with a base colour and normals, their textures placed like this."""
    base, normal = ({"index": k} | ({"extensions": {"KHR_texture_transform": each}} if each else {})
                    for k, each in ((1, transform), (2, other)))
    return {"pbrMetallicRoughness": {"baseColorTexture": base}, "normalTexture": normal} | material


@pytest.mark.parametrize("material, said", [
    (of_base({"scale": [2, 2]}, {"scale": [2, 2]}), r"passed over scale \[2, 2\]"),
    (of_base(alphaMode="MASK", extensions={"KHR_materials_clearcoat": {}}, emissiveTexture={"index": 0}),
     "passed over KHR_materials_clearcoat; passed over MASK; passed over emissiveTexture"),
    (of_base(emissiveFactor=[0, 0.5, 0]), "passed over emissiveFactor"),
    (of_base({"offset": [0.0, 0.0], "rotation": 0, "scale": [1, 1]}), None),
    (of_base({"rotation": 1.5}), MapsError), (of_base(None, {"texCoord": 1}), MapsError),
    (of_base(extensions={"KHR_materials_pbrSpecularGlossiness": {}}), MapsError)])
def test_what_a_material_does_not_have_is_said(material, said, tmp_path):
    path = written(tmp_path, **material)
    Image.fromarray(np.full((8, 8, 3), (128, 128, 255), np.uint8)).save(tmp_path / "n.webp", lossless=True)
    document = json.loads(path.read_text())
    document["images"].append({"uri": "n.webp"})
    document["textures"].append({"extensions": {"EXT_texture_webp": {"source": 2}}})
    path.write_text(json.dumps(document))
    if said is MapsError:
        with pytest.raises(MapsError, match="placed alike|metal/rough"):
            load_maps(path)
        return
    with pytest.warns(AssumedWarning, match=said or "normal n.webp; --enc"):
        assert load_maps(path)["normal"][0, 0, 2] > 0.999


def test_profiles_of_textures_do_not_count(tmp_path):
    """glTF 2.0: colour-space information of images must be ignored."""
    path = written(tmp_path, pbrMetallicRoughness={"baseColorTexture": {"index": 0}, "metallicFactor": 0})
    save_in(tmp_path / "orm map.png", np.full((8, 8, 3), 0.5), "ProPhoto")
    stored = np.asarray(Image.open(tmp_path / "orm map.png"))[0, 0] / 255
    with pytest.warns(AssumedWarning):
        found = load_maps(path)["base_color"][0, 0]
    assert found.tolist() == pytest.approx((((stored + 0.055) / 1.055) ** 2.4).tolist(), abs=1e-6)
    assert abs(float(found[0]) - 0.2140) > 0.02  # what the profile says: display value 0.5


def test_ktx2_alone_is_one_error(tmp_path):
    path = written(tmp_path, pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    document = json.loads(path.read_text())
    document["textures"][0] = {"extensions": {"KHR_texture_basisu": {"source": 0}}}
    path.write_text(json.dumps(document))
    with pytest.raises(MapsError, match="base_color.*KHR_texture_basisu; export it without KTX2"):
        load_maps(path)
