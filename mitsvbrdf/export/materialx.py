"""The material as MaterialX documents: ``standard_surface``, and OpenPBR for readers of 1.39.

Source: MaterialX specification 1.38 and 1.39; Autodesk Standard Surface (Georgiev et al. 2019) and OpenPBR
Surface 1.1, whose roughness is the square root of the GGX alpha, as ours.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import torch

from ..io import files, images
from ..material.conversion import as_shown, layered, relative_f0, usual_f0
from ..material.maps import DIELECTRIC_F0, SVBRDF
from ..render.bsdf import index_from_f0
from .residual import residual
from .textures import DEFAULTS, SRGB, Export, ExportSettings, Texture, stored, write_texture


class Surface(NamedTuple):
    """A surface shader: its version of MaterialX, its node, and what our maps are called there."""

    version: str
    node: str
    inputs: Mapping[str, str]
    refractive_index: str


SURFACES = {
    "material.mtlx": Surface("1.38", "standard_surface", {
        "base_color": "base_color", "metallic": "metalness", "specular_color": "specular_color",
        "roughness": "specular_roughness", "normal": "normal"}, "specular_IOR"),
    "openpbr.mtlx": Surface("1.39", "open_pbr_surface", {
        "base_color": "base_color", "metallic": "base_metalness", "specular_color": "specular_color",
        "roughness": "specular_roughness", "normal": "geometry_normal"}, "specular_ior")}
SPECULAR_NOTE = ("one refractive index for all that is no metal, for viewers cannot read a map of it; "
                 "specular_color is F0 over the index's: F0 is exact, and grazing light scaled alike")
LAYER_NOTE = ("the specular lobe lies over the diffuse one, which gets what is left of the light; ours is a "
              "sum")


def write_materialx(folder: Path, svbrdf: SVBRDF, settings: ExportSettings = DEFAULTS) -> Export:
    """Write ``folder/material.mtlx``, ``folder/openpbr.mtlx`` and ``folder/textures/*``."""
    material, level, largest, lost = svbrdf, DIELECTRIC_F0, 1.0, {}
    if svbrdf.bsdf == "roughconductor":
        level = usual_f0(svbrdf)
        material, relative = layered(svbrdf, torch.tensor(level)), relative_f0(svbrdf, level)
        lost = {"materialx": residual(svbrdf, as_shown(material, relative * level, torch.tensor(level)))}
        largest = max(float(relative.max()), 1.0)  # a texture ends at 1, the factor beside it does not
    written = {name: write_texture(folder, f"textures/{name}.png", name, value, settings.bits)
               for name, value in material.maps.items()}
    if svbrdf.bsdf == "roughconductor":
        file = "textures/specular_color.png"
        images.write_png(folder / file, stored("specular", relative / largest), settings.bits)
        written["specular_color"] = Texture(file, f"F0 over {level:.6g}, divided by {largest:.6g}", SRGB,
                                            settings.bits)
    index = float(index_from_f0(torch.tensor(level)))
    for file, surface in SURFACES.items():
        files.write_bytes(folder / file, _document(surface, written, index, largest, settings.repeats))
    notes = (LAYER_NOTE,) if svbrdf.bsdf == "principled" else (SPECULAR_NOTE, LAYER_NOTE)
    return Export(tuple(SURFACES), tuple(written.values()), notes, lost)


def _document(surface: Surface, textures: Mapping[str, Texture], index: float, largest: float,
              repeats: bool) -> bytes:
    """The document of a surface; ``largest`` multiplies the texture of ``specular_color``."""
    root = ET.Element("materialx", version=surface.version, colorspace="lin_rec709")
    graph = ET.SubElement(root, "nodegraph", name="maps")
    shader = ET.SubElement(root, surface.node, name="shader", type="surfaceshader")
    if surface.node == "standard_surface":
        _input(shader, "base", "float", value="1")
    _input(shader, surface.refractive_index, "float", value=f"{index:.7g}")
    for name, texture in textures.items():
        kind = "vector3" if texture.normal else "color3" if texture.colour_space == SRGB else "float"
        image = ET.SubElement(graph, "image", name=f"{name}_image", type=kind)
        space = {"colorspace": "srgb_texture"} if texture.colour_space == SRGB else {}
        _input(image, "file", "filename", value=texture.file, **space)
        for axis in "uv":
            _input(image, f"{axis}addressmode", "string", value="periodic" if repeats else "clamp")
        source = f"{name}_image"
        if texture.normal:
            source = f"{name}_map"
            _input(ET.SubElement(graph, "normalmap", name=source, type="vector3"), "in", "vector3",
                   nodename=f"{name}_image")
        if name == "specular_color" and largest > 1:
            source = f"{name}_scaled"
            scaled = ET.SubElement(graph, "multiply", name=source, type="color3")
            _input(scaled, "in1", "color3", nodename=f"{name}_image")
            _input(scaled, "in2", "float", value=f"{largest:.7g}")
        ET.SubElement(graph, "output", name=f"{name}_out", type=kind, nodename=source)
        _input(shader, surface.inputs[name], kind, nodegraph="maps", output=f"{name}_out")
    material = ET.SubElement(root, "surfacematerial", name="material", type="material")
    _input(material, "surfaceshader", "surfaceshader", nodename="shader")
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _input(parent: ET.Element, name: str, kind: str, **attributes: str) -> None:
    ET.SubElement(parent, "input", {"name": name, "type": kind, **attributes})
