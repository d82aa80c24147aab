"""One patch with its material as a binary glTF 2.0 file (GLB) that contains its textures.

Source: glTF 2.0 specification (Khronos), sections 3.9.2 and 4.4; KHR_materials_specular.
"""

import json
import struct
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from .. import __version__
from ..io import files, images
from ..material.conversion import layered, relative_f0
from ..material.maps import DIELECTRIC_F0, SVBRDF
from ..material.relief import heights, occlusion
from .residual import shown_residual
from .textures import DEFAULTS, LINEAR, NOTES, Export, ExportSettings, Texture, described, rendered, stored

FILE = "material.glb"
# The patch of docs/conventions.md, side 1, seen from +z: corners, normals, tangents, texture coordinates.
# The tangent is +x and, with w = 1, the bitangent cross(normal, tangent) = +y: the up of our normal maps.
# glTF's v grows downward: v = 0 is row 0 of the image, the top.
CORNERS = -0.5, -0.5, 0.0, 0.5, -0.5, 0.0, 0.5, 0.5, 0.0, -0.5, 0.5, 0.0
FRAME = (0.0, 0.0, 1.0) * 4, (1.0, 0.0, 0.0, 1.0) * 4, (0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
TRIANGLES = 0, 1, 2, 0, 2, 3
CLAMP_TO_EDGE, REPEAT, VERTICES, INDICES = 33071, 10497, {"target": 34962}, {"target": 34963}


def write_gltf(folder: Path, svbrdf: SVBRDF, settings: ExportSettings = DEFAULTS) -> Export:
    """Write ``folder/material.glb``: base colour; occlusion, roughness and metallic packed; normal; and F0.

    Base colour and metallic are those of :func:`mitsvbrdf.material.conversion.layered`: only a clear metal is
    metallic. F0 of ``roughconductor`` materials is stored by ``KHR_materials_specular``; viewers without this
    extension show 0.04.
    """
    material, factor = svbrdf, None
    if svbrdf.bsdf == "roughconductor":
        material = layered(svbrdf, svbrdf["specular"].amax(dim=-1, keepdim=True))
        factor = relative_f0(svbrdf, DIELECTRIC_F0)
        lost = {"with KHR_materials_specular": shown_residual(svbrdf, material, factor * DIELECTRIC_F0),
                "without it": shown_residual(svbrdf, material)}
    else:
        lost = {"base colour as it is": shown_residual(svbrdf, svbrdf)}
    sky = occlusion(heights(svbrdf["normal"], settings.repeats), settings.repeats)[..., None]
    packed = torch.cat((sky.to(material["roughness"]), material["roughness"], material["metallic"]), dim=-1)
    images = {"base_color": material["base_color"], "metallic_roughness": packed,
              "normal": material["normal"]}
    textures = [described(f"{FILE}: base_color", "base_color", 8),
                Texture(f"{FILE}: metallic_roughness", "occlusion in R, roughness in G, metallic in B",
                        LINEAR, 8),
                described(f"{FILE}: normal", "normal", 8)]
    extension = {}
    if factor is not None:
        largest = max(float(factor.max()), 1.0)  # a texture's values end at 1, the factor's do not
        images["specular_color"] = factor / largest
        textures.append(Texture(f"{FILE}: specular_color",
                                f"factor on the dielectric F0 of 0.04, divided by {largest:.6g}", "sRGB", 8))
        extension = {"specularColorFactor": [largest] * 3, "specularColorTexture": {"index": 3}}
    files.write_bytes(folder / FILE, _glb(images, extension, settings))
    return Export((FILE,), tuple(textures), tuple(NOTES["gltf"][svbrdf.bsdf]), lost)


def _glb(textures: dict[str, Tensor], specular: dict, settings: ExportSettings) -> bytes:
    """The bytes of the file. The template ``material.gltf`` fixes the order of the buffer's parts."""
    side, blob, views = settings.side or 1.0, bytearray(), list[dict]()
    numbers = [tuple(side * x for x in CORNERS), *FRAME]
    parts: list[tuple[bytes, dict]] = [(struct.pack(f"<{len(each)}f", *each), VERTICES) for each in numbers]
    pictures = images.write_all([partial(images.encode_png, each, shown=partial(stored, name.replace(
        "specular_color", "specular"))) for name, each in textures.items()])
    parts += [(struct.pack("<6H", *TRIANGLES), INDICES), *((each, {}) for each in pictures)]
    for data, about in parts:
        blob.extend(b"\0" * (-len(blob) % 4))
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data), **about})
        blob.extend(data)
    document = json.loads(rendered(
        "material.gltf", version=__version__, name=settings.name, licence=settings.licence, half=side * 0.5,
        specular=specular and json.dumps(specular), views=json.dumps(views), textures=list(textures),
        length=len(blob), wrap=REPEAT if settings.repeats else CLAMP_TO_EDGE))
    text = json.dumps(document, separators=(",", ":")).encode()
    return _container((b"JSON", text, b" "), (b"BIN\0", bytes(blob), b"\0"))


def _container(*chunks: tuple[bytes, bytes, bytes]) -> bytes:
    """The bytes of a GLB 2. A chunk is (kind, content, byte to pad it with to four bytes); section 4.4."""
    body = b""
    for kind, content, filling in chunks:
        content += filling * (-len(content) % 4)
        body += struct.pack("<I4s", len(content), kind) + content
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
