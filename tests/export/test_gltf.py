"""GLB read back by other programs or by hand, never by the code that wrote it."""

import io
import json
import shutil
import struct
import subprocess

import numpy as np
import pytest
from helpers.exported import srgb_to_linear
from PIL import Image

from mitsvbrdf.export import ExportSettings
from mitsvbrdf.export.gltf import write_gltf
from mitsvbrdf.material.conversion import as_principled
from mitsvbrdf.material.maps import flat
from mitsvbrdf.material.relief import heights, occlusion


def parsed(path):
    """JSON and binary chunk of a GLB, by section 4.4 of the specification."""
    data = path.read_bytes()
    magic, version, length, size, kind = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON") and size % 4 == 0
    rest = data[20 + size:]
    size_of_rest, kind = struct.unpack("<I4s", rest[:8])
    assert kind == b"BIN\0" and len(rest) == 8 + size_of_rest and size_of_rest % 4 == 0
    return json.loads(data[20:20 + size]), rest[8:]


def view(document, binary, number):
    place = document["bufferViews"][number]
    return binary[place["byteOffset"]:place["byteOffset"] + place["byteLength"]]


def picture(document, binary, texture):
    source = document["textures"][texture["index"]]["source"]
    return np.array(Image.open(io.BytesIO(view(document, binary,
                                               document["images"][source]["bufferView"])))) / 255


def numbers(document, binary, number):
    accessor = document["accessors"][number]
    width = {"VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    return np.frombuffer(view(document, binary, accessor["bufferView"]), "<f4").reshape(-1, width)


def test_glb_holds_the_maps_to_half_a_step_of_8_bits(material, tmp_path):
    write_gltf(tmp_path, material)
    document, binary = parsed(tmp_path / "material.glb")
    found = document["materials"][0]
    pbr = found["pbrMetallicRoughness"]
    packed = picture(document, binary, pbr["metallicRoughnessTexture"])
    metal = as_principled(material)
    half = 0.5 / 255 + 1e-6
    assert found["occlusionTexture"] == pbr["metallicRoughnessTexture"]
    assert np.abs(packed[..., 0] - occlusion(heights(material["normal"])).numpy()).max() <= half
    assert np.abs(packed[..., 1:2] - material["roughness"].numpy()).max() <= half
    assert np.abs(packed[..., 2:] - metal["metallic"].numpy()).max() <= half
    assert np.abs(picture(document, binary,
                          found["normalTexture"]) * 2 - 1 - material["normal"].numpy()).max() <= 2 * half
    base = srgb_to_linear(picture(document, binary, pbr["baseColorTexture"]))
    metallic = packed[..., 2:]
    wanted = material.as_roughconductor()
    if material.bsdf == "principled":
        assert "extensionsUsed" not in document
        diffuse, f0 = base * (1 - metallic), base * metallic + 0.04 * (1 - metallic)
    else:
        # KHR_materials_specular: F0 of the dielectric part = min(0.04 * factor * texture, 1), and diffuse
        # gets 1 - max(F0).
        specular = found["extensions"]["KHR_materials_specular"]
        colour = (specular["specularColorFactor"]
                  * srgb_to_linear(picture(document, binary, specular["specularColorTexture"])))
        f0 = np.minimum(0.04 * colour, 1)
        diffuse = base * (1 - metallic) * (1 - f0.max(axis=-1, keepdims=True))
        f0 = base * metallic + (1 - metallic) * f0
    # Linear; half a step of 8 bits in sRGB is 0.0045 at 1. Measured 0.003 and 0.004.
    assert np.abs(f0 - wanted["specular"].numpy()).max() < 0.005
    plain = (metallic[..., 0] == 0 if material.bsdf == "roughconductor"
             else np.ones_like(metallic[..., 0], bool))
    assert np.abs(diffuse - wanted["diffuse"].numpy())[plain].max() < 0.008
    assert material.bsdf == "principled" or 0.05 < plain.mean() < 0.95  # both kinds were looked at


def test_the_top_of_the_patch_is_the_top_of_the_glb(tmp_path):
    """glTF 3.8: v = 0 is the image's first row, y is up, the normal faces us, the bitangent is +y."""
    maps = flat(4, diffuse=0.0, specular=0.0)  # with no F0 the base colour is the diffuse colour
    corners = {(-1, 1): (0, 0, 0.2), (1, 1): (0, 3, 0.4), (-1, -1): (3, 0, 0.6), (1, -1): (3, 3, 0.8)}
    for row, column, value in corners.values():
        maps["diffuse"][row, column] = value
    write_gltf(tmp_path, maps)
    document, binary = parsed(tmp_path / "material.glb")
    (primitive,) = document["meshes"][0]["primitives"]
    at = {name: numbers(document, binary, number) for name, number in primitive["attributes"].items()}
    image = srgb_to_linear(picture(document, binary,
                                   document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]))
    for position, (u, v) in zip(at["POSITION"], at["TEXCOORD_0"]):
        *_, value = corners[tuple(np.sign(position[:2]))]
        assert image[min(int(v * 4), 3), min(int(u * 4), 3)] == pytest.approx([value] * 3, abs=0.005)
    triangles = np.frombuffer(view(document, binary,
                                   document["accessors"][primitive["indices"]]["bufferView"]), "<u2")
    for a, b, c in at["POSITION"][triangles].reshape(2, 3, 3):
        assert np.cross(b - a, c - a)[2] > 0  # counter-clockwise seen from +z
    bitangent = np.cross(at["NORMAL"], at["TANGENT"][:, :3]) * at["TANGENT"][:, 3:]
    assert (bitangent == [0, 1, 0]).all()


def test_another_reader_opens_the_glb(material, tmp_path):
    pygltflib = pytest.importorskip("pygltflib", reason="needs pygltflib, of the test extra")
    write_gltf(tmp_path, material)
    found = pygltflib.GLTF2().load(str(tmp_path / "material.glb"))
    assert found.asset.version == "2.0" and len(found.images) == (4 if material.bsdf == "roughconductor"
                                                                  else 3)
    for image in found.images:
        place = found.bufferViews[image.bufferView]
        png = found.binary_blob()[place.byteOffset:place.byteOffset + place.byteLength]
        assert Image.open(io.BytesIO(png)).size == (32, 32)


@pytest.mark.slow
def test_khronos_validator_has_nothing_to_say(material, tmp_path):
    """Needs node and gltf-validator on NODE_PATH; `./run slow` provides it where npm is."""
    node = shutil.which("node")
    if not node or subprocess.run([node, "-e", "require('gltf-validator')"], capture_output=True).returncode:
        pytest.skip("needs node and the npm package gltf-validator on NODE_PATH")
    write_gltf(tmp_path, material)
    code = ("require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync("
            "process.argv[1]))).then(report => console.log(JSON.stringify(report.issues)))")
    done = subprocess.run([node, "-e", code, str(tmp_path / "material.glb")], capture_output=True, text=True,
                          check=True)
    assert json.loads(done.stdout)["messages"] == []


def test_size_licence_and_whether_it_repeats_are_in_the_file(tmp_path):
    write_gltf(tmp_path, flat(4))
    assert parsed(tmp_path / "material.glb")[0]["samplers"][0]["wrapS"] == 33071  # clamp to edge
    write_gltf(tmp_path, flat(4), ExportSettings("Old brick!", side=0.2, licence="CC0-1.0", repeats=True))
    document, binary = parsed(tmp_path / "material.glb")
    assert document["samplers"][0]["wrapS"] == document["samplers"][0]["wrapT"] == 10497  # repeat
    assert document["asset"]["copyright"] == "CC0-1.0" and document["materials"][0]["name"] == "Old brick!"
    (primitive,) = document["meshes"][0]["primitives"]
    assert np.allclose(np.abs(numbers(document, binary, primitive["attributes"]["POSITION"])[:, :2]), 0.1)
