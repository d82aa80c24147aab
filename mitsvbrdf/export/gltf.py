"""One patch with its material as a binary glTF 2.0 file (GLB), textures inside.

Source: glTF 2.0 specification (Khronos), sections 3.9.2 and 4.4; KHR_materials_specular.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path

import torch
from torch import Tensor

from .. import __version__, color
from ..material.conversion import as_principled, with_specular_color
from ..material.maps import DIELECTRIC_F0, SVBRDF
from ..system import files, images
from .textures import LINEAR, SRGB, Export, Texture, described, residual, stored

FILE = "material.glb"
FLOAT, UNSIGNED_SHORT = 5126, 5123
CLAMP_TO_EDGE, LINEAR_FILTER, MIPMAPS = 33071, 9729, 9987
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963

# The patch of docs/conventions.md, side 1, seen from +z. glTF's v grows downward: v = 0 is row 0 of the image, the top.
CORNERS = ((-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (0.5, 0.5, 0.0), (-0.5, 0.5, 0.0))
UVS = ((0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0))
TRIANGLES = (0, 1, 2, 0, 2, 3)
NOTES = (
    "glTF lets diffuse light through by 1 - max(F), where ours is a sum: diffuse is darker by at most F0 seen from above",
    "glTF's Fresnel curve is Schlick's, ours that of a real refractive index; F0 is the same",
    "roughness is ours: the GGX alpha is its square in both",
    "textures have 8 bits: GPUs decode sRGB from 8 bits only",
)


def write_gltf(folder: Path, svbrdf: SVBRDF) -> Export:
    """Write ``folder/material.glb``: base colour, metallic and roughness packed, normal; F0 by KHR_materials_specular.

    Base colour and metallic are those of :func:`mitsvbrdf.material.conversion.as_principled`. The extension, for
    ``roughconductor`` materials only, carries what metallic cannot say of F0; viewers without it show the conversion alone.

    Args:
        folder: made when missing.
        svbrdf: the material.
    """
    material, factor = as_principled(svbrdf), None
    lost = {}
    if svbrdf.bsdf == "roughconductor":
        material, factor = with_specular_color(svbrdf, material)
        base, metallic = material["base_color"], material["metallic"]
        shown = {"diffuse": base * (1 - metallic), "specular": base * metallic + DIELECTRIC_F0 * (1 - metallic) * factor}
        lost = {"with KHR_materials_specular": residual(svbrdf, SVBRDF("roughconductor", dict(svbrdf.maps) | shown)),
                "without it": residual(svbrdf, material)}
    # R of the packed texture is free for occlusion, which we do not have: 1.
    packed = torch.cat((torch.ones_like(material["roughness"]), material["roughness"], material["metallic"]), dim=-1)
    images = {"base_color": stored("base_color", material["base_color"]), "metallic_roughness": packed,
              "normal": stored("normal", material["normal"])}
    textures = [described(f"{FILE}: base_color", "base_color", 8),
                Texture(f"{FILE}: metallic_roughness", "roughness in G, metallic in B", LINEAR, 8),
                described(f"{FILE}: normal", "normal", 8)]
    extension = {}
    if factor is not None:
        largest = max(float(factor.max()), 1.0)  # a texture ends at 1, the factor beside it does not
        images["specular_color"] = color.encode(factor / largest, "srgb")
        textures.append(Texture(f"{FILE}: specular_color", f"factor on the dielectric F0 of 0.04, divided by {largest:.6g}",
                                SRGB, 8))
        extension = {"specularColorFactor": [largest] * 3, "specularColorTexture": {"index": 3}}
    files.write_bytes(folder / FILE, _glb(images, extension))
    return Export((FILE,), tuple(textures), NOTES, lost)


def _glb(textures: dict[str, Tensor], specular: dict) -> bytes:
    blob, views = bytearray(), []

    def add(data: bytes, **about: int) -> int:
        blob.extend(b"\0" * (-len(blob) % 4))
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data), **about})
        blob.extend(data)
        return len(views) - 1

    def accessor(rows: tuple, kind: str) -> dict:
        numbers = [x for row in rows for x in row]
        ends = {"min": [min(c) for c in zip(*rows)], "max": [max(c) for c in zip(*rows)]}
        return {"bufferView": add(struct.pack(f"<{len(numbers)}f", *numbers), target=ARRAY_BUFFER), "componentType": FLOAT,
                "count": len(rows), "type": kind, **ends}

    # The tangent is +x and, with w = 1, the bitangent cross(normal, tangent) = +y: the up of our normal maps.
    accessors = [accessor(CORNERS, "VEC3"), accessor(((0.0, 0.0, 1.0),) * 4, "VEC3"),
                 accessor(((1.0, 0.0, 0.0, 1.0),) * 4, "VEC4"), accessor(UVS, "VEC2"),
                 {"bufferView": add(struct.pack("<6H", *TRIANGLES), target=ELEMENT_ARRAY_BUFFER),
                  "componentType": UNSIGNED_SHORT, "count": 6, "type": "SCALAR"}]
    pictures = [{"name": name, "mimeType": "image/png", "bufferView": add(images.encode_png(image))}
                for name, image in textures.items()]
    material: dict = {
        "name": "material",
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}},
        "normalTexture": {"index": 2}}
    document = {
        "asset": {"version": "2.0", "generator": f"mitsvbrdf {__version__}"},
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"name": "patch", "mesh": 0}],
        "meshes": [{"name": "patch", "primitives": [{
            "attributes": {"POSITION": 0, "NORMAL": 1, "TANGENT": 2, "TEXCOORD_0": 3}, "indices": 4, "material": 0}]}],
        "materials": [material], "accessors": accessors, "bufferViews": views, "images": pictures,
        "samplers": [{"magFilter": LINEAR_FILTER, "minFilter": MIPMAPS, "wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE}],
        "textures": [{"name": name, "sampler": 0, "source": k} for k, name in enumerate(textures)],
        "buffers": [{"byteLength": len(blob)}]}
    if specular:
        material["extensions"] = {"KHR_materials_specular": specular}
        document["extensionsUsed"] = ["KHR_materials_specular"]
    text = json.dumps(document, separators=(",", ":")).encode()
    return _container((b"JSON", text, b" "), (b"BIN\0", bytes(blob), b"\0"))


def _container(*chunks: tuple[bytes, bytes, bytes]) -> bytes:
    """GLB version 2: each chunk is kind, content and what to fill it up with to a multiple of four bytes (section 4.4)."""
    body = b""
    for kind, content, filling in chunks:
        content += filling * (-len(content) % 4)
        body += struct.pack("<I4s", len(content), kind) + content
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
