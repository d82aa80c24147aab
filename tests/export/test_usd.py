"""USD read back by its own library."""

import pytest
from helpers.exported import stated

from mitsvbrdf.export import export_material


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
