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
from ..io import files, images
from ..material.conversion import as_shown, layered, relative_f0
from ..material.maps import DIELECTRIC_F0, SVBRDF
from ..material.relief import heights, occlusion
from .residual import residual
from .textures import DEFAULTS, LINEAR, SRGB, Export, ExportSettings, Texture, described, stored

FILE = "material.glb"
FLOAT, UNSIGNED_SHORT = 5126, 5123
CLAMP_TO_EDGE, REPEAT, LINEAR_FILTER, MIPMAPS = 33071, 10497, 9729, 9987
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963

# The patch of docs/conventions.md, side 1, seen from +z. glTF's v grows downward: v = 0 is row 0 of the
# image, the top.
CORNERS = ((-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (0.5, 0.5, 0.0), (-0.5, 0.5, 0.0))
UVS = ((0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0))
TRIANGLES = (0, 1, 2, 0, 2, 3)
LAYER_NOTE = ("glTF lets diffuse light through by 1 - max(F), ours by a sum: what is no metal is darker by "
              "F0, 4 %")
NOTES = (
    "glTF lets diffuse light through by 1 - max(F), ours by a sum: the base colour is diffuse / (1 - "
    "max(F0)), the same seen from above, darker at grazing angles",
    "glTF's Fresnel curve is Schlick's, ours that of a real refractive index; F0 is the same",
    "roughness is ours: the GGX alpha is its square in both",
    "textures have 8 bits: GPUs decode sRGB from 8 bits only",
)


def write_gltf(folder: Path, svbrdf: SVBRDF, settings: ExportSettings = DEFAULTS) -> Export:
    """Write ``folder/material.glb``: base colour; occlusion, roughness and metallic packed; normal; and F0.

    Base colour and metallic are those of :func:`mitsvbrdf.material.conversion.layered`: only what clearly is
    a metal is one. ``KHR_materials_specular``, for ``roughconductor`` materials only, carries F0; viewers
    without it show 0.04.
    """
    material, factor, lost = svbrdf, None, {}
    if svbrdf.bsdf == "roughconductor":
        material = layered(svbrdf, svbrdf["specular"].amax(dim=-1, keepdim=True))
        factor = relative_f0(svbrdf, DIELECTRIC_F0)
        for kind, f0 in {"with KHR_materials_specular": factor,
                         "without it": torch.ones_like(factor)}.items():
            f0 = f0 * DIELECTRIC_F0
            lost[kind] = residual(svbrdf, as_shown(material, f0, f0.amax(dim=-1, keepdim=True)))
    else:
        glass = torch.full_like(svbrdf["metallic"], DIELECTRIC_F0)
        lost = {"base colour as it is": residual(svbrdf, as_shown(svbrdf, glass, glass))}
    shaded = occlusion(heights(svbrdf["normal"], settings.repeats), settings.repeats)
    shaded = shaded[..., None].to(material["roughness"])
    packed = torch.cat((shaded, material["roughness"], material["metallic"]), dim=-1)
    images = {"base_color": stored("base_color", material["base_color"]), "metallic_roughness": packed,
              "normal": stored("normal", material["normal"])}
    textures = [described(f"{FILE}: base_color", "base_color", 8),
                Texture(f"{FILE}: metallic_roughness", "occlusion in R, roughness in G, metallic in B",
                        LINEAR, 8),
                described(f"{FILE}: normal", "normal", 8)]
    extension = {}
    if factor is not None:
        largest = max(float(factor.max()), 1.0)  # a texture ends at 1, the factor beside it does not
        images["specular_color"] = color.encode(factor / largest, "srgb")
        textures.append(Texture(f"{FILE}: specular_color",
                                f"factor on the dielectric F0 of 0.04, divided by {largest:.6g}", SRGB, 8))
        extension = {"specularColorFactor": [largest] * 3, "specularColorTexture": {"index": 3}}
    files.write_bytes(folder / FILE, _glb(images, extension, settings))
    return Export((FILE,), tuple(textures), NOTES if extension else (LAYER_NOTE, *NOTES[1:]), lost)


def _glb(textures: dict[str, Tensor], specular: dict, settings: ExportSettings) -> bytes:
    blob, views, wrap = bytearray(), [], REPEAT if settings.repeats else CLAMP_TO_EDGE

    def add(data: bytes, **about: int) -> int:
        blob.extend(b"\0" * (-len(blob) % 4))
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data), **about})
        blob.extend(data)
        return len(views) - 1

    def accessor(rows: tuple, kind: str) -> dict:
        numbers = [x for row in rows for x in row]
        ends = {"min": [min(c) for c in zip(*rows)], "max": [max(c) for c in zip(*rows)]}
        return {"bufferView": add(struct.pack(f"<{len(numbers)}f", *numbers), target=ARRAY_BUFFER),
                "componentType": FLOAT, "count": len(rows), "type": kind, **ends}

    # The tangent is +x and, with w = 1, the bitangent cross(normal, tangent) = +y: the up of our normal maps.
    corners = tuple(tuple((settings.side or 1.0) * x for x in corner) for corner in CORNERS)
    accessors = [accessor(corners, "VEC3"), accessor(((0.0, 0.0, 1.0),) * 4, "VEC3"),
                 accessor(((1.0, 0.0, 0.0, 1.0),) * 4, "VEC4"), accessor(UVS, "VEC2"),
                 {"bufferView": add(struct.pack("<6H", *TRIANGLES), target=ELEMENT_ARRAY_BUFFER),
                  "componentType": UNSIGNED_SHORT, "count": 6, "type": "SCALAR"}]
    pictures = [{"name": name, "mimeType": "image/png", "bufferView": add(images.encode_png(image))}
                for name, image in textures.items()]
    material: dict = {
        "name": settings.name,
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}},
        "normalTexture": {"index": 2}, "occlusionTexture": {"index": 1}}
    copyright = {"copyright": settings.licence} if settings.licence else {}
    document = {
        "asset": {"version": "2.0", "generator": f"mitsvbrdf {__version__}"} | copyright,
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"name": "patch", "mesh": 0}],
        "meshes": [{"name": "patch", "primitives": [{
            "attributes": {"POSITION": 0, "NORMAL": 1, "TANGENT": 2, "TEXCOORD_0": 3}, "indices": 4,
            "material": 0}]}],
        "materials": [material], "accessors": accessors, "bufferViews": views, "images": pictures,
        "samplers": [{"magFilter": LINEAR_FILTER, "minFilter": MIPMAPS, "wrapS": wrap, "wrapT": wrap}],
        "textures": [{"name": name, "sampler": 0, "source": k} for k, name in enumerate(textures)],
        "buffers": [{"byteLength": len(blob)}]}
    if specular:
        material["extensions"] = {"KHR_materials_specular": specular}
        document["extensionsUsed"] = ["KHR_materials_specular"]
    text = json.dumps(document, separators=(",", ":")).encode()
    return _container((b"JSON", text, b" "), (b"BIN\0", bytes(blob), b"\0"))


def _container(*chunks: tuple[bytes, bytes, bytes]) -> bytes:
    """GLB version 2 of chunks (kind, content, filling to four bytes); section 4.4."""
    body = b""
    for kind, content, filling in chunks:
        content += filling * (-len(content) % 4)
        body += struct.pack("<I4s", len(content), kind) + content
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
