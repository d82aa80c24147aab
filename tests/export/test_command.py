"""The command that exports, and its mistakes."""

import json
import zipfile
from xml.etree import ElementTree

import pytest
from helpers.exported import stated

from mitsvbrdf import cli
from mitsvbrdf.cli import export as export_command
from mitsvbrdf.errors import BackendError, ConfigError
from mitsvbrdf.export import ExportSettings, export_material
from mitsvbrdf.export.textures import Export
from mitsvbrdf.io import images, results
from mitsvbrdf.material.conversion import as_principled
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.relight import stage


def test_what_is_lost_is_told_with_the_folder(tmp_path, capsys):
    """Of many materials one after the other the folder tells which one it is."""
    done = {"usd": Export(("oak.usda",), (), conversion={"metallic": {"diffuse": 0.5}})}
    export_command._tell(tmp_path / "oak-1a2b3c4d", done)
    first, *_, last = capsys.readouterr().out.splitlines()
    assert first == f"lost in {tmp_path}/oak-1a2b3c4d/usd, metallic: diffuse 0.5000"
    assert last.startswith("lost: RMSE, from 0 to 1, ") and f"below {1 / 255:.3f} is less than" in last


def test_no_unit_is_told_where_nothing_is_lost(tmp_path, capsys):
    export_command._tell(tmp_path, {"mitsuba": Export(("scene.xml",), ())})
    assert capsys.readouterr().out == f"wrote {tmp_path}/mitsuba/scene.xml\n"


def test_a_principled_material_loses_what_the_highlight_takes(tmp_path):
    maps = as_principled(make_material("plates", 8))
    assert as_principled(maps) is maps
    done = export_material(maps, tmp_path)
    assert not done.pop("mitsuba").conversion
    for kind in done:  # which lay the highlight over the diffuse light: 4 % of it is lost
        (lost,) = done[kind].conversion.values()
        assert lost["specular"] < 1e-6 and 0 < lost["diffuse"] < 0.02
        assert not any("max(F0)" in note or "texture of the refr" in note for note in done[kind].notes)


def test_export_command(tmp_path, capsys):
    save_maps(make_material("plates", 16), tmp_path / "brick/maps")
    assert cli.main(["export", str(tmp_path / "brick"), "--to", "gltf,maps", "--naming", "polyhaven",
                     "--normal", "dx"]) == 0
    said = capsys.readouterr().out
    folder = tmp_path / "brick/export"
    assert (folder / "gltf/material.glb").is_file() and (folder / "maps/brick_nor_dx.png").is_file()
    assert sorted(path.name for path in folder.iterdir()) == [".mitsvbrdf", "gltf", "maps", "preview.png",
                                                              "thumbnail.png"]
    lost = stated(folder / "maps")["conversion_rmse"]["with the specular level"]
    assert f"diffuse {lost['diffuse']:.4f}, specular {lost['specular']:.4f}" in said and lost["specular"] > 0
    assert cli.main(["export", "builtin:tiles", "--no-preview", "-o", str(tmp_path / "all")]) == 0
    assert {path.parent.name for path in (tmp_path / "all").glob("*/export.json")} == {
        "gltf", "materialx", "usd", "mitsuba", "maps"}


def test_the_scene_shows_the_first_photo_of_the_fit(tmp_path):
    save_maps(flat(8), tmp_path / "maps")
    views = {"size": 2.0, "falloff": "none", "camera": [[0.5, 0.25, 4.0]], "light": [[0.5, 0.0, 4.0]],
             "intensity": [[8, 8, 8]]}
    fit = {"flash_offset": None, "views": views, "capture": {"transfer": "srgb", "name": "x", "photos": [2]}}
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    assert cli.main(["export", str(tmp_path), "--to", "mitsuba", "--no-preview"]) == 0
    root = ElementTree.parse(tmp_path / "export/mitsuba/scene.xml").getroot()
    found = {entry.get("name"): entry.get("value") for entry in root.iter("default")}
    in_sides = {"camera_x": 0.25, "camera_y": 0.125, "camera_z": 2.0, "light_x": 0.25, "light_y": 0.0,
                "light_z": 2.0}
    assert {name: float(found[name])
            for name in in_sides} == in_sides and found["intensity"] == "2.0, 2.0, 2.0"


def test_a_texture_as_libraries_have_them(tmp_path, capsys):
    """Seamless, with its size and licence, a picture, and a zip of each format."""
    made = make_material("plates", 64).map(lambda value: value[3:51, 7:55].contiguous())
    save_maps(made, tmp_path / "rust/maps")
    command = ["export", str(tmp_path / "rust"), "--to", "usd,maps", "--tile", "--zip", "--side-cm", "12",
               "--licence", "CC0-1.0"]
    assert cli.main(command) == 0
    folder = tmp_path / "rust/export"
    said = stated(folder / "usd")
    assert said["licence"] == "CC0-1.0" and 0.06 <= said["side_metres"] < 0.11  # what the overlap left of it
    assert f"{said['side_metres'] / 0.12:.0%} of the patch's side is left" in capsys.readouterr().out
    inside = set(zipfile.ZipFile(folder / "usd.zip").namelist())
    assert {"usd/patch.usda", "usd/material.usda", "usd/export.json", "usd/textures/normal.png"} <= inside
    assert said["repeats"] and "clamp" not in (folder / "usd/patch.usda").read_text()
    for name, side in (("preview", 512), ("thumbnail", 128)):
        picture = images.read_image(folder / f"{name}.png", ValueError)
        assert picture.shape == (side, side, 3) and 0.02 < float(picture.std()) < 0.4
    assert cli.main([*command[:-1], "CC-BY-4.0", "--overwrite"]) == 0


@pytest.mark.parametrize("told, side", [("sheet", 0.18), ("photos", None), ("given", None)])
def test_a_sheet_in_the_photos_tells_the_side(told, side, tmp_path):
    save_maps(flat(8), tmp_path / "maps")
    views = {"size": 18.0, "falloff": "inverse-square", "camera": [[0, 0, 40]], "light": [[0, 0, 40]],
             "intensity": [[8, 8, 8]]}
    fit = {"flash_offset": None, "views": views, "capture": {"transfer": "srgb", "name": "x", "photos": [2]},
           "calibration": {"from": told}}
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    assert cli.main(["export", str(tmp_path), "--to", "usd", "--no-preview"]) == 0
    assert stated(tmp_path / "export/usd")["side_metres"] == side


def test_exports_go_without_mitsuba(tmp_path, monkeypatch, capsys):
    def missing(*_):
        raise BackendError("libLLVM 19 or newer", "none", "install libllvm19")

    monkeypatch.setattr(stage, "using_mitsuba", missing)
    assert cli.main(["export", "builtin:tiles", "--to", "gltf", "-o", str(tmp_path / "out")]) == 0
    assert "no preview: " in capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [".mitsvbrdf", "gltf"]


@pytest.mark.parametrize("arguments, word", [
    (["--to", "gltf,obj"], "obj"), (["--to", "usd", "--normal", "dx"], "maps"), (["--tile"], "16 texels"),
    (["--to", "gltf", "--naming", "polyhaven"], "maps"), (["-o", "m"], "folder of its own"),
    (["-o", "m/maps"], "folder of its own"), (["--side-cm", "0"], "0.001 to 1e+06 cm"),
    (["--side-cm", "nan"], "--side-cm of"), (["--side-cm", "1e45"], "--side-cm of"), (["--to", ""], "gltf")])
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


@pytest.mark.parametrize("wrong", [*({"settings": ExportSettings(**it)} for it in (
    {"naming": "unity"}, {"normal": "vulkan"}, {"bits": 12})), {"to": ["obj"]}, {"to": []}])
def test_mistakes_in_python(wrong, tmp_path):
    with pytest.raises(ConfigError, match="expected"):
        export_material(flat(4), tmp_path / "out", **wrong)
    assert not (tmp_path / "out").exists()


def test_exports_go_with_the_maps_they_were_made_of(tmp_path):
    for size in (8, 16):
        with results.output_folder(tmp_path / "fit", overwrite=True) as folder:
            save_maps(make_material("tiles", size), folder / "maps")
        assert not (tmp_path / "fit/export").exists()
        assert cli.main(["export", str(tmp_path / "fit"), "--to", "maps,gltf", "--no-preview", "--zip"]) == 0
