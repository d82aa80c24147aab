"""MaterialX read back by its own library."""

from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.exported import decoded, gilt_plates, stated

from mitsvbrdf.export import ExportSettings, export_material


@pytest.mark.parametrize("file, node", [("material.mtlx", "standard_surface"),
                                        ("openpbr.mtlx", "open_pbr_surface")])
def test_materialx_validates_and_names_every_texture(material, file, node, tmp_path):
    mx = pytest.importorskip("MaterialX", reason="needs MaterialX, of the test extra")
    export_material(material, tmp_path, ["materialx"])
    library, document = mx.createDocument(), mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    mx.readFromXmlFile(document, str(tmp_path / "materialx" / file))
    document.setDataLibrary(library)
    assert document.validate() == (True, "")
    (shader,) = mx.getShaderNodes(document.getMaterialNodes()[0])
    assert shader.getCategory() == node
    for entry in shader.getInputs():  # an input of another name would be legal, and do nothing
        assert shader.getNodeDef().getActiveInput(entry.getName()).getType() == entry.getType()
    said = {texture["file"]: texture for texture in stated(tmp_path / "materialx")["textures"]}
    used = {}
    for image in document.getNodeGraph("maps").getNodes("image"):
        entry = image.getInput("file")
        used[entry.getValueString()] = {"srgb_texture": "sRGB", "": "linear"}[entry.getColorSpace()]
    assert used == {file: texture["colour_space"] for file, texture in said.items()}
    assert all((tmp_path / "materialx" / file).is_file() for file in used)


def test_materialx_has_f0_in_one_index_and_a_colour(tmp_path):
    maps = gilt_plates(32)
    export_material(maps, tmp_path, ["materialx"])
    folder = tmp_path / "materialx"
    root = ElementTree.parse(folder / "material.mtlx").getroot()
    index = float(root.find("standard_surface/input[@name='specular_IOR']").get("value"))
    largest = float(root.find("nodegraph/multiply/input[@name='in2']").get("value"))
    level = ((index - 1) / (index + 1)) ** 2
    f0 = level * largest * decoded(folder / "textures/specular_color.png", "sRGB")
    metallic = decoded(folder / "textures/metallic.png", "linear")
    base = decoded(folder / "textures/base_color.png", "sRGB")
    wanted = maps["specular"].numpy()
    # half a step of 16 bits in sRGB is 1.8e-5 at 1
    assert np.abs(np.where(metallic > 0, base, f0) - wanted).max() < 3e-5
    diffuse = (base * (1 - level))[metallic[..., 0] == 0]
    assert np.abs(diffuse - maps["diffuse"].numpy()[metallic[..., 0] == 0]).max() < 3e-5
    assert not list(folder.rglob("*.exr"))  # which viewers on the web do not read


def test_addresses_repeat_where_edges_meet(tmp_path):
    for repeats, mode in ((False, "clamp"), (True, "periodic")):
        export_material(gilt_plates(16), tmp_path / mode, ["materialx"],
                        settings=ExportSettings(repeats=repeats))
        root = ElementTree.parse(tmp_path / mode / "materialx/openpbr.mtlx").getroot()
        assert {entry.get("value") for entry in root.iter("input")
                if "addressmode" in entry.get("name")} == {mode}
