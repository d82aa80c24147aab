"""MaterialX read back by its own library."""

import numpy as np
import pytest
from helpers.exported import decoded, stated

from mitsvbrdf.export import export_material
from mitsvbrdf.testing import random_material


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
