"""Write a material as a Mitsuba scene, made from ``scenes/patch.xml``; read scenes as dictionaries."""

import math
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch

from ..io import files, images
from ..io.entry import entry
from ..material.maps import SVBRDF, Bsdf
from ..render.bsdf import plugin, slot_values
from ..render.needs import Needs
from ..views import Views, strips
from .textures import DEFAULTS, LINEAR, NORMALS, NOTES, Export, ExportSettings, Texture

# ``scenes/`` is beside the package in a checkout, and inside it if installed from a wheel.
SCENES = next((p for p in (Path(__file__).parents[1] / "scenes", Path(__file__).parents[2] / "scenes")
               if p.is_dir()), Path("scenes"))

LIGHT_NOTE = "the light of scene.xml falls off with 1 / d^2, even if the fit assumed no falloff"


@entry()
def write_scene(out: str | Path, svbrdf: SVBRDF, views: Views, repeats: bool = False) -> Path:
    """Write ``out/scene.xml`` and float textures ``out/scene/*.exr`` for plain Mitsuba, any RGB variant.

    The scene shows the first view, in units of the patch side, one unjittered sample a pixel. A
    ``roughconductor`` material gets its real Fresnel curve, so that it may be lit from anywhere. The light
    falls off with 1 / d^2.

    Args:
        out: the folder; made if it is missing.
        views: at least one view.
        repeats: whether the textures repeat beyond their edges.
    """
    out, svbrdf = Path(out), svbrdf.detach().to(torch.float32)
    parameters = view_parameters(views, svbrdf.resolution)

    def write(slot: str, some: torch.Tensor) -> None:
        texture = some.new_empty(svbrdf.resolution, *some.shape[1:])
        for rows in strips(svbrdf.resolution):
            texture[rows] = _slots(svbrdf, rows)[slot]
        images.write_exr(out / "scene" / f"{slot}.exr", texture)

    images.write_all([partial(write, *each) for each in _slots(svbrdf, slice(0, 1)).items()])

    comments = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
    tree = ET.parse(SCENES / "patch.xml", comments)
    root = tree.getroot()
    for default in root.iter("default"):
        default.set("value", parameters[default.attrib["name"]])
    material = next(root.iterfind("bsdf[@id='material']"))
    material.attrib.clear()
    material.attrib.update(type="normalmap", id="material")
    _fill(material, _material(svbrdf.bsdf, repeats))
    ET.indent(tree, space="    ")
    path = out / "scene.xml"
    files.write_bytes(path, ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
    return path


def write_mitsuba(folder: Path, svbrdf: SVBRDF, settings: ExportSettings = DEFAULTS, *,
                  views: Views) -> Export:
    """The scene for Mitsuba 3; see :func:`write_scene`."""
    write_scene(folder, svbrdf, views, settings.repeats)
    slots = _slots(svbrdf, slice(0, 1))
    normals, holds = {"normal": NORMALS["gl"]}, NOTES["mitsuba"]
    textures = tuple(Texture(f"scene/{slot}.exr", holds.get(slot, slot), LINEAR, 32, normals.get(slot))
                     for slot in slots)
    return Export(("scene.xml",), textures, (LIGHT_NOTE,))


def _slots(svbrdf: SVBRDF, rows: slice) -> dict[str, torch.Tensor]:
    """A dict: slot to some rows of its texture, valid for lights and cameras at any place."""
    maps = {name: value[rows] for name, value in svbrdf.maps.items()}
    return slot_values(svbrdf.bsdf, maps, Needs(), stock=True)


def _material(bsdf: Bsdf, repeats: bool) -> dict:
    def texture(slot: str) -> dict:
        return {"type": "bitmap", "filename": f"scene/{slot}.exr", "raw": True, "filter_type": "nearest",
                "wrap_mode": "repeat" if repeats else "clamp"}

    return plugin(bsdf, Needs(), texture, stock=True)


def view_parameters(views: Views, resolution: int) -> dict[str, str]:
    """A dict: parameters of ``scenes/patch.xml`` to values that show the first view in R x R pixels."""
    view = next(iter(views.in_patch_sides().pick([0])))
    (x, y, z), light = view.camera, view.light
    values = {"camera_x": x, "camera_y": y, "camera_z": z,
              "field_of_view": math.degrees(2 * math.atan(0.5 / z)),
              "shift_x": -x, "shift_y": y, "light_x": light[0], "light_y": light[1], "light_z": light[2]}
    return {k: repr(v) for k, v in values.items()} | {
        "resolution": str(resolution), "intensity": ", ".join(map(repr, view.intensity))}


def _fill(element: ET.Element, description: dict) -> None:
    """Mitsuba's plugin dictionary as XML children of an element."""
    kinds = {bool: "boolean", int: "integer", float: "float", str: "string"}
    for name, value in description.items():
        if name == "type":
            element.set("type", value)
        elif isinstance(value, dict):
            tag = {"bitmap": "texture", "uniform": "spectrum"}.get(value["type"], "bsdf")
            if tag == "spectrum":
                ET.SubElement(element, tag, name=name, type="uniform").append(
                    ET.Element("float", name="value", value=repr(value["value"])))
            else:
                child = ET.SubElement(element, tag, name=name)
                _fill(child, value)
                if tag == "texture":  # image row 0 is the top, while the rectangle's v grows upward from 0
                    flip = ET.SubElement(child, "transform", name="to_uv")
                    ET.SubElement(flip, "scale", x="1", y="-1")
                    ET.SubElement(flip, "translate", x="0", y="1")
        else:
            text = str(value).lower() if isinstance(value, bool) else str(value)
            ET.SubElement(element, kinds[type(value)], name=name, value=text)


def read_scene(mi: ModuleType, name: str, **values: str) -> dict[str, Any]:
    """A file of ``scenes/`` as the dictionary that ``mitsuba.load_dict`` takes, to be filled in.

    Keys are ids; without an id, kinds (``sensor``, ``film``). References are kept, so that their targets can
    be replaced.
    """
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_file(config, str(SCENES / name), **values)
    return _described(mi, state, 0)


def _described(mi: ModuleType, state: Any, index: int) -> dict[str, Any]:
    props = state.nodes[index].props
    described: dict[str, Any] = {"type": props.plugin_name()}
    for key, value in props.items():
        if isinstance(value, mi.Properties.ResolvedReference):
            child = state.nodes[value.index()]
            name = (child.props.id() or child.type.name.lower()) if key.startswith("_arg_") else key
            described[name] = _described(mi, state, value.index())
        elif isinstance(value, mi.Properties.Reference):
            described["bsdf" if key.startswith("_arg_") else key] = {"type": "ref", "id": value.id()}
        elif "Color" in type(value).__name__:
            described[key] = {"type": "rgb", "value": list(value)}
        elif "Transform" in type(value).__name__:  # parsed in double precision
            described[key] = mi.ScalarTransform4f(np.array(value.matrix, dtype=np.float32))
        elif key == "filename":
            described[key] = str(SCENES / value)
        else:
            described[key] = value
    return described
