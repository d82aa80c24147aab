"""The maps as PNG files, named as the tools or libraries of textures do that they are for."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from ..material.conversion import as_principled
from ..material.map_files import ENCODINGS
from ..material.maps import SVBRDF
from ..system import files
from .textures import NORMALS, Bits, Export, NormalConvention, residual, write_texture

Naming = Literal["own", "polyhaven", "ambientcg", "substance", "materialgan"]

# File name of each map; NAME stands for the material's. "own" has both parameter sets, and load_maps reads it.
FILE_NAMES: dict[str, dict[str, str]] = {
    "own": {"diffuse": "diffuse", "specular": "specular", "base_color": "base_color", "metallic": "metallic",
            "roughness": "roughness", "normal gl": "normal", "normal dx": "normal_dx"},
    "polyhaven": {"base_color": "NAME_diff", "metallic": "NAME_metal", "roughness": "NAME_rough",
                  "normal gl": "NAME_nor_gl", "normal dx": "NAME_nor_dx"},
    "ambientcg": {"base_color": "NAME_Color", "metallic": "NAME_Metalness", "roughness": "NAME_Roughness",
                  "normal gl": "NAME_NormalGL", "normal dx": "NAME_NormalDX"},
    "substance": {"base_color": "NAME_BaseColor", "metallic": "NAME_Metallic", "roughness": "NAME_Roughness",
                  "normal gl": "NAME_Normal_OpenGL", "normal dx": "NAME_Normal_DirectX"},
    "materialgan": {"diffuse": "dif", "specular": "spe", "roughness": "rgh", "normal gl": "nom", "normal dx": "nom_dx"},
}
LOSSY_NOTE = "base colour and metallic are the nearest to diffuse and specular, which say more; conversion_rmse: what is lost"
GAMMA_NOTE = "MaterialGAN's programs take dif, spe and rgh for gamma 2.2: here dif and spe are sRGB and rgh is linear"


def write_maps(folder: Path, svbrdf: SVBRDF, name: str = "material", naming: Naming = "own", normal: NormalConvention = "gl",
               bits: Bits = 16) -> Export:
    """Write the maps of a preset into the folder: colours sRGB, the rest linear, whatever the preset.

    Args:
        folder: made when missing.
        svbrdf: the material.
        name: the material's, for presets that have it in file names.
        naming: of :data:`FILE_NAMES`.
        normal: ``gl`` or ``dx``.
        bits: of all files.
    """
    material = as_principled(svbrdf)
    both = {**svbrdf.as_roughconductor().maps, **material.maps}
    chosen = {key.removesuffix(f" {normal}"): file for key, file in FILE_NAMES[naming].items()}
    chosen = {key: file.replace("NAME", _safe(name)) + ".png" for key, file in chosen.items() if key in both}
    written = [write_texture(folder, file, key, both[key], bits, normal) for key, file in chosen.items()]
    if naming in ("own", "materialgan"):  # names that load_maps knows
        files.write_json(folder / "material.json", {
            "bsdf": "roughconductor" if naming == "materialgan" else svbrdf.bsdf, "size": svbrdf.resolution,
            "encoding": {key: code for key, code in ENCODINGS["srgb"].items() if key in chosen} | {"normal": NORMALS[normal]}})
    converted = svbrdf.bsdf == "roughconductor" and "metallic" in chosen
    notes = ((LOSSY_NOTE,) if converted else ()) + ((GAMMA_NOTE,) if naming == "materialgan" else ())
    lost = {"base colour and metallic": residual(svbrdf, material)} if converted else None
    return Export(tuple(texture.file for texture in written), tuple(written), notes, lost)


def _safe(name: str) -> str:
    """A file name of letters, digits, - and _ only."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_") or "material"
