"""The maps of a glTF 2.0 file: .glb, or .gltf with the files beside it.

Source: glTF 2.0 specification (Khronos), sections 3.9 and 4.4; KHR_materials_specular and KHR_materials_ior.
"""

import base64
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ..errors import MapsError
from ..io import files
from ..io.json import error_text, parsed
from .map_set import LEAST_ROUGHNESS, MapSet
from .maps import DIELECTRIC_F0
from .naming import Source

BLACK = [0, 0, 0]
LARGEST = 2**30  # bytes in a file, at most


def gltf_set(path: Path, spare: Path) -> MapSet:
    """The one material of a file; textures inside it are written to the folder ``spare``.

    MapsError: no glTF file, none or several materials, or a feature that the reader does not know.
    """
    try:
        document, binary = _parts(path)
        materials = document.get("materials", [])
        if len(materials) != 1:
            names = ", ".join(str(m.get("name", k)) for k, m in enumerate(materials[:9])) or "none"
            raise MapsError("a glTF file of one material", f"{path} with {len(materials)} ({names})",
                            "export the material that is meant alone")
        return _found(path, document, materials[0], binary, spare)
    except (OSError, ValueError, LookupError, ArithmeticError, TypeError, AttributeError,
            struct.error) as reason:
        raise MapsError("a whole glTF 2.0 file", f"{path}: {type(reason).__name__} {error_text(reason)}",
                        "export it again") from None


def _parts(path: Path) -> tuple[dict, bytes]:
    """The JSON of a file, and the binary chunk of a .glb."""
    content = files.read_regular(path, LARGEST)
    if content[:4] != b"glTF":
        return parsed(content), b""
    chunks, at = dict[bytes, bytes](), 12
    while at + 8 <= len(content):
        size, kind = struct.unpack_from("<I4s", content, at)
        chunks.setdefault(kind, content[at + 8:at + 8 + size])
        at += 8 + size
    return parsed(chunks[b"JSON"].rstrip(b" \0")), chunks.get(b"BIN\0", b"")


def _found(path: Path, document: dict, material: dict, binary: bytes, spare: Path) -> MapSet:
    def texture(info: dict | None, name: str) -> Path | None:
        if info is None:
            return None
        if info.get("scale", 1) != 1:
            raise MapsError("normals at scale 1", f"{path} with {info['scale']}", "bake the scale")
        found = document["textures"][info["index"]]
        if "source" not in (found := found.get("extensions", {}).get("EXT_texture_webp", found)):
            raise MapsError("textures in PNG, JPEG or WebP", f"{name} in {path} as "
                            f"{', '.join(found.get('extensions', {}))}", "export it without KTX2")
        about = document["images"][found["source"]]
        moved = info.get("extensions", {}).get("KHR_texture_transform", {})
        moved = {key: value for key, value in ({"texCoord": info.get("texCoord", 0)} | moved).items()
                 if value not in (0, [0, 0]) and (key, value) != ("scale", [1, 1])}
        placed[name] = ", ".join(f"{key} {value}" for key, value in moved.items())
        if "bufferView" not in about and not about["uri"].startswith("data:"):
            return beside(path, unquote(about["uri"]))
        file = spare / name
        file.write_bytes(_view(document, about["bufferView"], path, binary) if "bufferView" in about else
                         base64.b64decode(about["uri"].partition(",")[2], validate=True))
        return file

    placed: dict[str, str] = {}
    surface, more = material.get("pbrMetallicRoughness", {}), material.get("extensions", {})
    if "KHR_materials_pbrSpecularGlossiness" in more:
        raise MapsError("a metal/rough material", f"{path} with specular/gloss", "export it as metal/rough")
    packed = texture(surface.get("metallicRoughnessTexture"), "metallic_roughness")
    found = {
        "base_color": Source(texture(surface.get("baseColorTexture"), "base_color"),
                             factor=_numbers(surface.get("baseColorFactor", (1, 1, 1)))),
        "metallic": Source(packed, 2 if packed else None,
                           factor=_numbers([surface.get("metallicFactor", 1)])),
        "roughness": Source(packed, 1 if packed else None, factor=(
            max(*_numbers([surface.get("roughnessFactor", 1)]), LEAST_ROUGHNESS),)),
        "normal": Source(texture(material["normalTexture"], "normal")) if "normalTexture" in material else
                  Source(None, factor=(0.0, 0.0, 1.0))}
    if "KHR_materials_specular" in more or "KHR_materials_ior" in more:
        specular = more.get("KHR_materials_specular", {})
        index = more.get("KHR_materials_ior", {}).get("ior", 1.5)
        if "specularTexture" in specular:
            raise MapsError("a specular colour", f"{path} with specularTexture", "bake it into the colour")
        level = ((index - 1) / (index + 1)) ** 2 if index != 1.5 else DIELECTRIC_F0
        level *= specular.get("specularFactor", 1)
        found["f0"] = Source(texture(specular.get("specularColorTexture"), "specular_color"), factor=tuple(
            level * x for x in _numbers(specular.get("specularColorFactor", (1, 1, 1)))))
    lacking = [*(set(more) - {"KHR_materials_specular", "KHR_materials_ior"}),
               *(key for key in ("emissiveTexture", "emissiveFactor") if material.get(key, BLACK) != BLACK),
               *({"BLEND", "MASK"} & {material.get("alphaMode")})]
    meshes = [each for mesh in document.get("meshes", []) for each in mesh["primitives"]]
    lacking += ["colours of vertices"] * any("COLOR_0" in each["attributes"] for each in meshes)
    return MapSet(path, found, {"normal": "gl", "f0": "srgb"}, way="--encoding {}", remarks=(
        *(f"passed over {name}" for name in sorted(lacking)), *placed_alike(path, placed)))


def placed_alike(path: Path, placed: Mapping[str, str]) -> list[str]:
    """Remarks on placements (``placed``, by texture): our maps have none. MapsError: they differ."""
    ways = set(placed.values())
    if len(ways) > 1:
        said = ", ".join(f"{name} ({way or 'as it is'})" for name, way in placed.items())
        raise MapsError("textures that are placed alike", f"{path} with {said}", "bake the placement")
    return [f"passed over {way} of the textures" for way in ways if way]


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(float(x) for x in values[:3])


def beside(path: Path, name: str) -> Path:
    """The path of a texture named in a document; MapsError: not in the document's folder or below."""
    file = files.inside(path.parent, name)
    if file is None:
        raise MapsError("textures beside the file", f"{name!r} in {path}", "copy them there")
    return file


def _view(document: dict, number: int, path: Path, binary: bytes) -> bytes:
    view = document["bufferViews"][number]
    uri = document["buffers"][view["buffer"]].get("uri")
    if uri is not None:
        binary = (base64.b64decode(uri.partition(",")[2], validate=True) if uri.startswith("data:") else
                  files.read_regular(beside(path, unquote(uri)), LARGEST))
    begin = view.get("byteOffset", 0)
    return binary[begin:begin + view["byteLength"]]
