"""The material as a MaterialX document: ``standard_surface`` with image textures.

Source: MaterialX specification 1.38; Autodesk Standard Surface (Georgiev et al. 2019), whose roughness is the square root
of the GGX alpha, as ours.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import torch

from ..material.maps import SVBRDF
from ..render.bsdf import F0_RANGE, index_from_f0
from ..system import files, images
from .textures import LINEAR, SRGB, Bits, Export, Texture, stored, write_texture

FILE = "material.mtlx"
SPECULAR_NOTE = ("diffuse and F0 are exact, without metalness: the strongest channel of F0 is the specular_IOR, whose Fresnel "
                 "curve is ours, and F0 over it the specular_color; F0 above 0.999 is cut")
LAYER_NOTE = "standard_surface lays the specular lobe over the diffuse one, which gets what is left of the light; ours is a sum"


def write_materialx(folder: Path, svbrdf: SVBRDF, bits: Bits = 16) -> Export:
    """Write ``folder/material.mtlx`` and ``folder/textures/*``.

    Args:
        folder: made when missing.
        svbrdf: the material.
        bits: of the PNG textures; the refractive index of a ``roughconductor`` material is a float32 EXR.
    """
    inputs = {"roughness": "specular_roughness", "normal": "normal"}
    if svbrdf.bsdf == "principled":
        inputs = {"base_color": "base_color", "metallic": "metalness"} | inputs
    else:
        inputs = {"diffuse": "base_color"} | inputs
    written = {inputs[name]: write_texture(folder, f"textures/{name}.png", name, svbrdf[name], bits) for name in inputs}
    if svbrdf.bsdf == "roughconductor":
        f0 = svbrdf["specular"]
        level = f0.amax(dim=-1, keepdim=True).clamp(*F0_RANGE)
        written["specular_color"] = _write_colour(folder, f0 / level, bits)
        images.write_exr(folder / "textures/specular_ior.exr", index_from_f0(level))
        written["specular_IOR"] = Texture("textures/specular_ior.exr", "refractive index", LINEAR, 32)
    files.write_bytes(folder / FILE, _document(written))
    notes = (LAYER_NOTE,) if svbrdf.bsdf == "principled" else (SPECULAR_NOTE, LAYER_NOTE)
    return Export((FILE,), tuple(written.values()), notes)


def _write_colour(folder: Path, value: torch.Tensor, bits: Bits) -> Texture:
    images.write_png(folder / "textures/specular_color.png", stored("specular", value), bits)
    return Texture("textures/specular_color.png", "F0 over its strongest channel", SRGB, bits)


def _document(textures: dict[str, Texture]) -> bytes:
    """MaterialX 1.38, which 1.39 reads too; ``textures`` by the input of standard_surface that each feeds."""
    root = ET.Element("materialx", version="1.38", colorspace="lin_rec709")
    graph = ET.SubElement(root, "nodegraph", name="maps")
    shader = ET.SubElement(root, "standard_surface", name="shader", type="surfaceshader")
    _input(shader, "base", "float", value="1")
    if "metalness" in textures:
        _input(shader, "specular_IOR", "float", value="1.5")  # F0 = 0.04
    for target, texture in textures.items():
        kind = "vector3" if texture.normal else "color3" if texture.colour_space == SRGB else "float"
        image = ET.SubElement(graph, "image", name=f"{target}_image", type=kind)
        space = {"colorspace": "srgb_texture"} if texture.colour_space == SRGB else {}
        _input(image, "file", "filename", value=texture.file, **space)
        for axis in "uv":
            _input(image, f"{axis}addressmode", "string", value="clamp")
        source = f"{target}_image"
        if texture.normal:
            source = f"{target}_map"
            _input(ET.SubElement(graph, "normalmap", name=source, type="vector3"), "in", "vector3", nodename=f"{target}_image")
        ET.SubElement(graph, "output", name=f"{target}_out", type=kind, nodename=source)
        _input(shader, target, kind, nodegraph="maps", output=f"{target}_out")
    material = ET.SubElement(root, "surfacematerial", name="material", type="material")
    _input(material, "surfaceshader", "surfaceshader", nodename="shader")
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _input(parent: ET.Element, name: str, kind: str, **attributes: str) -> None:
    ET.SubElement(parent, "input", {"name": name, "type": kind, **attributes})
