"""Materials in other programs' formats, read back by other programs or by hand, never by the code that wrote them."""

import io
import json
import re
import shutil
import struct
import subprocess
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from mitsvbrdf import cli
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.export import export_material
from mitsvbrdf.export.gltf import write_gltf
from mitsvbrdf.export.maps import FILE_NAMES
from mitsvbrdf.material.conversion import as_principled, with_specular_color
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps, save_maps
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.system import images
from mitsvbrdf.testing import random_material
from mitsvbrdf.views import Views, nine_view_grid

BSDFS = ["roughconductor", "principled"]


@pytest.fixture(scope="module", params=BSDFS)
def material(request):
    """32 px, row and column told apart by every map, metal and plain texels."""
    made = make_material("plates", 32)
    return made if request.param == "roughconductor" else as_principled(made)


def srgb_to_linear(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1


def decoded(path, colour_space):
    """A PNG or EXR as linear float64 H x W x C, through OpenCV alone."""
    if path.suffix == ".exr":
        return images.read_image(path, ValueError).double().numpy()
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    values = np.atleast_3d(pixels)[..., ::-1] / np.iinfo(pixels.dtype).max
    return srgb_to_linear(values) if colour_space == "sRGB" else values


def stated(folder):
    return json.loads((folder / "export.json").read_text())


# glTF

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
    return np.array(Image.open(io.BytesIO(view(document, binary, document["images"][source]["bufferView"])))) / 255


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
    assert np.abs(packed[..., 1:2] - material["roughness"].numpy()).max() <= half
    assert np.abs(packed[..., 2:] - metal["metallic"].numpy()).max() <= half
    assert np.abs(picture(document, binary, found["normalTexture"]) * 2 - 1 - material["normal"].numpy()).max() <= 2 * half
    base = srgb_to_linear(picture(document, binary, pbr["baseColorTexture"]))
    metallic = packed[..., 2:]
    diffuse, f0 = base * (1 - metallic), base * metallic + 0.04 * (1 - metallic)
    if material.bsdf == "principled":
        assert "extensionsUsed" not in document
    else:
        # KHR_materials_specular: F0 of the dielectric part = min(0.04 * factor * texture, 1).
        specular = found["extensions"]["KHR_materials_specular"]
        colour = specular["specularColorFactor"] * srgb_to_linear(picture(document, binary, specular["specularColorTexture"]))
        f0 = base * metallic + (1 - metallic) * np.minimum(0.04 * colour, 1)
    wanted = material.as_roughconductor()
    assert np.abs(f0 - wanted["specular"].numpy()).max() < 1 / 255  # linear; measured 0.002
    # What is left of diffuse is what was stated, beside the steps of 8 bits. Measured: 0.01054 beside 0.01049, and 0.0010.
    error = np.sqrt(np.square(diffuse ** (1 / 2.2) - wanted["diffuse"].numpy() ** (1 / 2.2)).mean())
    lost = write_gltf(tmp_path, material).conversion
    assert error < (lost["with KHR_materials_specular"]["diffuse"] if lost else 0) + 1 / 255


def test_the_top_of_the_patch_is_the_top_of_the_glb(tmp_path):
    """Corner by corner: v = 0 is the first row of the image (glTF 3.8), y is up, the normal faces us, the bitangent is +y."""
    maps = flat(4, diffuse=0.0)
    corners = {(-1, 1): (0, 0, 0.2), (1, 1): (0, 3, 0.4), (-1, -1): (3, 0, 0.6), (1, -1): (3, 3, 0.8)}
    for row, column, value in corners.values():
        maps["diffuse"][row, column] = value
    write_gltf(tmp_path, maps)
    document, binary = parsed(tmp_path / "material.glb")
    (primitive,) = document["meshes"][0]["primitives"]
    at = {name: numbers(document, binary, number) for name, number in primitive["attributes"].items()}
    image = srgb_to_linear(picture(document, binary, document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]))
    for position, (u, v) in zip(at["POSITION"], at["TEXCOORD_0"]):
        *_, value = corners[tuple(np.sign(position[:2]))]
        assert image[min(int(v * 4), 3), min(int(u * 4), 3)] == pytest.approx([value] * 3, abs=0.005)
    triangles = np.frombuffer(view(document, binary, document["accessors"][primitive["indices"]]["bufferView"]), "<u2")
    for a, b, c in at["POSITION"][triangles].reshape(2, 3, 3):
        assert np.cross(b - a, c - a)[2] > 0  # counter-clockwise seen from +z
    bitangent = np.cross(at["NORMAL"], at["TANGENT"][:, :3]) * at["TANGENT"][:, 3:]
    assert (bitangent == [0, 1, 0]).all()


def test_another_reader_opens_the_glb(material, tmp_path):
    pygltflib = pytest.importorskip("pygltflib", reason="needs pygltflib, of the test extra")
    write_gltf(tmp_path, material)
    found = pygltflib.GLTF2().load(str(tmp_path / "material.glb"))
    assert found.asset.version == "2.0" and len(found.images) == (4 if material.bsdf == "roughconductor" else 3)
    for image in found.images:
        place = found.bufferViews[image.bufferView]
        png = found.binary_blob()[place.byteOffset:place.byteOffset + place.byteLength]
        assert Image.open(io.BytesIO(png)).size == (32, 32)


@pytest.mark.slow
def test_khronos_validator_has_nothing_to_say(material, tmp_path):
    """Needs node and `npm install gltf-validator` where node looks (NODE_PATH), which `./run slow` does where npm is."""
    node = shutil.which("node")
    if not node or subprocess.run([node, "-e", "require('gltf-validator')"], capture_output=True).returncode:
        pytest.skip("needs node and the npm package gltf-validator on NODE_PATH")
    write_gltf(tmp_path, material)
    code = ("require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[1])))"
            ".then(report => console.log(JSON.stringify(report.issues)))")
    done = subprocess.run([node, "-e", code, str(tmp_path / "material.glb")], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["messages"] == []


# MaterialX, USD, Mitsuba

def test_materialx_validates_and_names_every_texture(material, tmp_path):
    mx = pytest.importorskip("MaterialX", reason="needs MaterialX, of the test extra")
    export_material(material, tmp_path, ["materialx"])
    library, document = mx.createDocument(), mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    mx.readFromXmlFile(document, str(tmp_path / "materialx/material.mtlx"))
    document.setDataLibrary(library)
    assert document.validate() == (True, "")
    (shader,) = mx.getShaderNodes(document.getMaterialNodes()[0])
    assert shader.getCategory() == "standard_surface"
    for entry in shader.getInputs():  # an input of another name would be legal, and do nothing
        assert shader.getNodeDef().getActiveInput(entry.getName()).getType() == entry.getType()
    said = {texture["file"]: texture for texture in stated(tmp_path / "materialx")["textures"]}
    used = {}
    for image in document.getNodeGraph("maps").getNodes("image"):
        entry = image.getInput("file")
        used[entry.getValueString()] = {"srgb_texture": "sRGB", "": "linear"}[entry.getColorSpace()]
    assert used == {file: texture["colour_space"] for file, texture in said.items()}
    assert all((tmp_path / "materialx" / file).is_file() for file in used)


def test_materialx_has_f0_in_index_and_colour(tmp_path):
    maps = random_material("roughconductor", resolution=16)
    export_material(maps, tmp_path, ["materialx"])
    folder = tmp_path / "materialx/textures"
    index, colour = decoded(folder / "specular_ior.exr", "linear"), decoded(folder / "specular_color.png", "sRGB")
    f0 = ((index - 1) / (index + 1)) ** 2 * colour
    wanted = maps["specular"].numpy().clip(max=0.999)  # an index beyond that is cut
    assert np.abs(f0 - wanted).max() < 3e-5  # half a step of 16 bits in sRGB is 1.8e-5 at 1


def test_usd_opens_and_names_every_texture(material, tmp_path):
    Usd = pytest.importorskip("pxr.Usd", reason="needs usd-core, of the test extra")
    from pxr import UsdGeom, UsdShade

    export_material(material, tmp_path, ["usd"])
    stage = Usd.Stage.Open(str(tmp_path / "usd/material.usda"))
    said = {texture["file"]: texture for texture in stated(tmp_path / "usd")["textures"]}
    used = {}
    for prim in stage.Traverse():
        shader = UsdShade.Shader(prim)
        if shader and shader.GetIdAttr().Get() == "UsdUVTexture":
            asset = shader.GetInput("file").Get()
            assert asset.resolvedPath, asset.path
            used[asset.path.removeprefix("./")] = {"sRGB": "sRGB", "raw": "linear"}[shader.GetInput("sourceColorSpace").Get()]
    assert used == {file: texture["colour_space"] for file, texture in said.items()}

    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/patch/square"))
    bound, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    surface, *_ = bound.ComputeSurfaceSource()
    assert surface.GetInput("useSpecularWorkflow").Get() == (material.bsdf == "roughconductor")
    colours = {"diffuseColor", "specularColor"} if material.bsdf == "roughconductor" else {"diffuseColor", "metallic"}
    fed = {entry.GetBaseName() for entry in surface.GetInputs() if entry.HasConnectedSource()}
    assert fed == colours | {"roughness", "normal"}
    for prim in stage.Traverse():
        for attribute in prim.GetAttributes():
            assert all(stage.GetAttributeAtPath(path).IsDefined() for path in attribute.GetConnections()), attribute
    normal = UsdShade.Shader(stage.GetPrimAtPath("/patch/material/normal"))
    assert normal.GetInput("scale").Get() == (2, 2, 2, 1) and normal.GetInput("bias").Get() == (-1, -1, -1, 0)
    # st grows with x and y, and (0, 0) is the lower left of an image: its first row lies at the top.
    for point, st in zip(mesh.GetPointsAttr().Get(), UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get()):
        assert (st[0] - 0.5, st[1] - 0.5) == (point[0], point[1])


def test_mitsuba_renders_scene_and_dictionary_as_the_float64_twin(material, tmp_path):
    from mitsvbrdf.render.llvm import mitsuba_module

    mi, views = mitsuba_module(), nine_view_grid().pick([3])
    export_material(material, tmp_path, ["mitsuba"], views=views)
    folder = tmp_path / "mitsuba"
    scene = mi.load_file(str(folder / "scene.xml"))
    expected = AnalyticRenderer(torch.float64).render(material, views)[0].numpy()
    shown = np.array(mi.render(scene))
    assert np.abs(shown - expected).max() < 1e-3 * expected.max()  # measured 1.7e-6

    mi.file_resolver().append(str(folder))
    plugin = json.loads((folder / "bsdf.json").read_text(),
                        object_hook=lambda d: d | {k: mi.ScalarTransform4f(d[k]) for k in d if k == "to_uv"})
    at = mi.ScalarTransform4f()
    same = mi.load_dict({"type": "scene", "integrator": scene.integrator(), "sensor": scene.sensors()[0],
                         "emitter": scene.emitters()[0],
                         "patch": {"type": "rectangle", "to_world": at.scale(0.5), "bsdf": plugin}})
    assert np.array_equal(np.array(mi.render(same)), shown)


# Maps

@pytest.mark.parametrize("normal", ["gl", "dx"])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("naming", FILE_NAMES)
def test_maps_are_what_export_json_says(material, naming, bits, normal, tmp_path):
    export_material(material, tmp_path, ["maps"], "Old brick!", naming, normal, bits)
    folder, said = tmp_path / "maps", stated(tmp_path / "maps")
    there = {path.name for path in folder.iterdir()}
    assert there - {"material.json"} == {texture["file"] for texture in said["textures"]} | {"export.json"}
    for texture in said["textures"]:
        name, pixels = texture["holds"], cv2.imread(str(folder / texture["file"]), cv2.IMREAD_UNCHANGED)
        assert pixels.dtype == {8: np.uint8, 16: np.uint16}[texture["bits"]] and texture["bits"] == bits
        assert texture["colour_space"] == ("sRGB" if name in ("diffuse", "specular", "base_color") else "linear")
        found, wanted = decoded(folder / texture["file"], texture["colour_space"]), (
            as_principled(material) if name in ("base_color", "metallic") else material.as_roughconductor())[name].numpy()
        if name == "normal":
            assert ("DirectX" if normal == "dx" else "OpenGL") in texture["normal"]
            found, wanted = found * 2 - 1, wanted * ([1, -1, 1] if normal == "dx" else [1, 1, 1])
        # The steepest the decoding gets is 2.3 (sRGB at 1); (n + 1) / 2 doubles a step.
        assert np.abs(found - wanted).max() < 2.3 * 0.5 / (2**bits - 1) + 1e-6


def test_names_are_those_of_the_libraries(tmp_path):
    names = {
        "polyhaven": {"Old_brick_diff", "Old_brick_metal", "Old_brick_rough", "Old_brick_nor_gl"},
        "ambientcg": {"Old_brick_Color", "Old_brick_Metalness", "Old_brick_Roughness", "Old_brick_NormalGL"},
        "substance": {"Old_brick_BaseColor", "Old_brick_Metallic", "Old_brick_Roughness", "Old_brick_Normal_OpenGL"},
        "materialgan": {"dif", "spe", "rgh", "nom"},
        "own": {"diffuse", "specular", "base_color", "metallic", "roughness", "normal"}}
    for naming, expected in names.items():
        export_material(flat(4), tmp_path / naming, ["maps"], "Old brick!", naming)
        assert {path.stem for path in (tmp_path / naming / "maps").glob("*.png")} == expected
        assert len(json.loads((tmp_path / naming / "maps/export.json").read_text())["files"]) == len(expected)


# What Blender's Node Wrangler takes a file for, by the words of its name.
BLENDER_WORDS = {"base_color": {"diffuse", "diff", "albedo", "base", "col", "color", "basecolor"},
                 "metallic": {"metallic", "metalness", "metal", "mtl"}, "roughness": {"roughness", "rough", "rgh"},
                 "normal": {"normal", "nor", "nrm", "nrml", "norm"}}


@pytest.mark.parametrize("naming", ["polyhaven", "ambientcg", "substance"])
def test_blender_knows_the_files_by_their_names(naming, tmp_path):
    export_material(flat(4), tmp_path, ["maps"], "brick", naming)
    for texture in stated(tmp_path / "maps")["textures"]:
        words = {word.lower() for word in re.findall("[A-Z]?[a-z]+|[A-Z]+", texture["file"].removesuffix(".png"))}
        meanings = {meaning for meaning, known in BLENDER_WORDS.items() if words & known}
        assert meanings == {texture["holds"].split()[0]}, texture["file"]


@pytest.mark.parametrize("naming", ["own", "materialgan"])
def test_exported_maps_are_read_again(material, naming, tmp_path):
    export_material(material, tmp_path, ["maps"], naming=naming)
    found = load_maps(tmp_path / "maps")
    wanted = material if naming == "own" else material.as_roughconductor()
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
    lamp = Views.of([[0.0, 0.0, 3.0]], light=[[0.0, 40.0, 40.0]], intensity=1e4)  # far away: all texels see it alike

    def shown(normal):
        decoded_maps = dict(maps.maps) | {"normal": torch.nn.functional.normalize(torch.from_numpy(normal), dim=-1)}
        return AnalyticRenderer(torch.float64).render(SVBRDF("roughconductor", decoded_maps), lamp)[0].mean(dim=-1)

    found = {}
    for convention, file in (("gl", "normal.png"), ("dx", "normal_dx.png")):
        export_material(maps, tmp_path / convention, ["maps"], normal=convention)
        found[convention] = decoded(tmp_path / convention / "maps" / file, "linear") * 2 - 1
    above, below = slice(8, 16), slice(16, 24)  # rows on the two sides of the top of the bump
    right, wrong = shown(found["gl"]), shown(found["dx"])
    assert right[above, 8:24].mean() > 1.3 * right[below, 8:24].mean()  # measured 1.47 times
    assert wrong[above, 8:24].mean() < wrong[below, 8:24].mean() / 1.3
    turned = shown(found["dx"] * [1, -1, 1])
    assert (turned - right).abs().max() < 1e-4 * right.max()  # one step of 16 bits


# Base colour and metallic

def test_khr_specular_restores_f0(material):
    metal, factor = with_specular_color(material, as_principled(material))
    f0 = metal["base_color"] * metal["metallic"] + 0.04 * (1 - metal["metallic"]) * factor
    assert (f0 - material.as_roughconductor()["specular"]).abs().max() < 1e-6  # float32
    assert factor.min() >= 0 and factor.max() <= 25


def test_a_principled_material_loses_nothing(tmp_path):
    maps = as_principled(make_material("plates", 8))
    assert as_principled(maps) is maps
    for written in export_material(maps, tmp_path).values():
        assert not written.conversion


# The command

def test_export_command(tmp_path, capsys):
    save_maps(make_material("plates", 16), tmp_path / "brick/maps")
    assert cli.main(["export", str(tmp_path / "brick"), "--to", "gltf,maps", "--naming", "polyhaven", "--normal", "dx"]) == 0
    said = capsys.readouterr().out
    folder = tmp_path / "brick/export"
    assert (folder / "gltf/material.glb").is_file() and (folder / "maps/brick_nor_dx.png").is_file()
    assert sorted(path.name for path in folder.iterdir()) == [".mitsvbrdf", "gltf", "maps"]
    lost = stated(folder / "maps")["conversion_rmse"]["base colour and metallic"]
    assert f"diffuse {lost['diffuse']:.4f}, specular {lost['specular']:.4f}" in said and lost["specular"] > 0
    assert cli.main(["export", "builtin:tiles", "-o", str(tmp_path / "all")]) == 0
    assert {path.parent.name for path in (tmp_path / "all").glob("*/export.json")} == {
        "gltf", "materialx", "usd", "mitsuba", "maps"}


def test_the_scene_shows_the_first_photo_of_the_fit(tmp_path):
    save_maps(flat(8), tmp_path / "maps")
    views = {"size": 2.0, "falloff": "none", "camera": [[0.5, 0.25, 4.0]], "light": [[0.5, 0.0, 4.0]], "intensity": [[8, 8, 8]]}
    fit = {"flash_offset": None, "views": views, "capture": {"transfer": "srgb", "name": "x", "photos": [2]}}
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    assert cli.main(["export", str(tmp_path), "--to", "mitsuba"]) == 0
    root = ElementTree.parse(tmp_path / "export/mitsuba/scene.xml").getroot()
    found = {entry.get("name"): entry.get("value") for entry in root.iter("default")}
    in_sides = {"camera_x": 0.25, "camera_y": 0.125, "camera_z": 2.0, "light_x": 0.25, "light_y": 0.0, "light_z": 2.0}
    assert {name: float(found[name]) for name in in_sides} == in_sides and found["intensity"] == "2.0, 2.0, 2.0"


def test_export_is_replaced_when_asked_only(tmp_path, capsys):
    save_maps(flat(8), tmp_path / "m")
    command = ["export", str(tmp_path / "m"), "--to", "gltf", "-o", str(tmp_path / "out")]
    assert cli.main(command) == 0
    assert cli.main(command) == 2 and "--overwrite" in capsys.readouterr().err
    assert cli.main([*command, "--overwrite", "--to", "usd"]) == 0
    assert not (tmp_path / "out/gltf").exists() and (tmp_path / "out/usd/material.usda").is_file()


@pytest.mark.parametrize("arguments, word", [
    (["--to", "gltf,obj"], "obj"), (["--to", ""], "gltf"), (["--to", "gltf", "--naming", "polyhaven"], "maps"),
    (["--to", "usd", "--normal", "dx"], "maps"), (["-o", "m"], "folder of its own"), (["-o", "m/maps"], "folder of its own")])
def test_mistakes_of_the_caller(arguments, word, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    save_maps(flat(8), tmp_path / "m/maps")
    before = sorted(tmp_path.rglob("*"))
    assert cli.main(["export", "m", "--overwrite", *arguments]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and word in message
    assert sorted(tmp_path.rglob("*")) == before


def test_maps_that_cannot_be_read(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    for maps, word in (("nowhere", "no folder"), ("empty", "none in")):
        assert cli.main(["export", str(tmp_path / maps)]) == 2 and word in capsys.readouterr().err
    assert cli.main(["export", "builtin:tiles"]) == 2 and "-o" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [tmp_path / "empty"] and not list((tmp_path / "empty").iterdir())


@pytest.mark.parametrize("wrong", [{"naming": "unity"}, {"normal": "vulkan"}, {"bits": 12}, {"to": ["obj"]}, {"to": []}])
def test_mistakes_in_python(wrong, tmp_path):
    with pytest.raises(ConfigError, match="expected"):
        export_material(flat(4), tmp_path / "out", **wrong)
    assert not (tmp_path / "out").exists()
