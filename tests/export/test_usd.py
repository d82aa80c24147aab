"""USD read back by its own library."""

import numpy as np
import pytest
from helpers.exported import decoded, gilt_plates, stated

from mitsvbrdf.export import ExportSettings, export_material
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import flat

Usd = pytest.importorskip("pxr.Usd", reason="needs usd-core, of the test extra")


@pytest.fixture
def folder(material, tmp_path):
    export_material(material, tmp_path, ["usd"])
    return tmp_path / "usd"


def shader_at(stage, path):
    from pxr import UsdShade

    return UsdShade.Shader(stage.GetPrimAtPath(path))


@pytest.mark.parametrize("file, prim", [("material.usda", "/material"), ("patch.usda", "/patch")])
def test_usd_opens_and_names_every_texture(folder, file, prim):
    stage = Usd.Stage.Open(str(folder / file))
    assert str(stage.GetDefaultPrim().GetPath()) == prim
    said = {texture["file"]: texture for texture in stated(folder)["textures"]}
    used = {}
    for each in stage.Traverse():
        shader = shader_at(stage, each.GetPath())
        entry = shader.GetInput("file") if shader else None
        if entry:
            asset = entry.Get()
            assert asset.resolvedPath, asset.path
            space = {"sRGB": "sRGB", "raw": "linear"}[shader.GetInput("sourceColorSpace").Get()]
            used.setdefault(asset.path.removeprefix("./"), set()).add(space)
        for attribute in each.GetAttributes():
            assert all(stage.GetAttributeAtPath(path).IsDefined()
                       for path in attribute.GetConnections()), attribute
    assert used == {file: {texture["colour_space"]} for file, texture in said.items()}


def test_the_square_wears_the_metallic_workflow(folder, material):
    from pxr import UsdGeom, UsdShade

    stage = Usd.Stage.Open(str(folder / "patch.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/patch/square"))
    bound, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    surface, *_ = bound.ComputeSurfaceSource()
    assert surface.GetInput("useSpecularWorkflow").Get() == 0
    fed = {entry.GetBaseName() for entry in surface.GetInputs() if entry.HasConnectedSource()}
    index = {"ior"} if material.bsdf == "roughconductor" else set()
    assert fed == {"diffuseColor", "metallic", "roughness", "normal"} | index
    normal = shader_at(stage, "/patch/material/normal")
    assert normal.GetInput("scale").Get() == (2, 2, 2, 1) and normal.GetInput("bias").Get() == (-1, -1, -1, 0)
    # st grows with x and y, and (0, 0) is the lower left of an image: its first row lies at the top.
    for point, st in zip(mesh.GetPointsAttr().Get(), UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get()):
        assert (st[0] - 0.5, st[1] - 0.5) == (point[0], point[1])


def test_diffuse_and_f0_come_back(tmp_path):
    """By the specification: F0 by the refractive index, diffuse light what F0 leaves."""
    made = gilt_plates(32)
    export_material(made, tmp_path, ["usd"])
    stage = Usd.Stage.Open(str(tmp_path / "usd/material.usda"))
    texture = shader_at(stage, "/material/ior")
    scale, bias = (texture.GetInput(name).Get()[0] for name in ("scale", "bias"))
    index = scale * decoded(tmp_path / "usd/textures/ior.png", "linear") + bias
    f0 = ((index - 1) / (index + 1)) ** 2
    base, metallic = (decoded(tmp_path / f"usd/textures/{name}.png", space)
                      for name, space in (("base_color", "sRGB"), ("metallic", "linear")))
    plain = metallic[..., 0] == 0
    wanted = made["specular"].numpy().mean(axis=-1, keepdims=True)
    assert np.abs(f0 - wanted)[plain].max() < 1e-3  # 16 bits of an index that reaches 2 and more
    assert np.abs(base * (1 - f0) - made["diffuse"].numpy())[plain].max() < 0.005  # 8 bits
    assert np.abs(base - made["specular"].numpy())[~plain].max() < 0.005


def test_a_side_is_told_in_centimetres(tmp_path):
    from pxr import UsdGeom

    export_material(make_material("plates", 8), tmp_path, ["usd"], settings=ExportSettings(side=0.2))
    stage = Usd.Stage.Open(str(tmp_path / "usd/patch.usda"))
    points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/patch/square")).GetPointsAttr().Get())
    assert UsdGeom.GetStageMetersPerUnit(stage) * np.ptp(points[:, 0]) == pytest.approx(0.2)


def test_a_black_material_has_no_number_that_is_none(tmp_path, recwarn):
    export_material(flat(8, diffuse=0.0, specular=0.0), tmp_path, ["usd"])
    assert not recwarn.list
    assert decoded(tmp_path / "usd/textures/ior.png", "linear").max() == 0
