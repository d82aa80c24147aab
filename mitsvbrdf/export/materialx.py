"""The material as MaterialX documents: ``standard_surface``, and OpenPBR for readers of 1.39.

Source: MaterialX specification 1.38 and 1.39; Autodesk Standard Surface (Georgiev et al. 2019) and OpenPBR
Surface 1.1, whose roughness is the square root of the GGX alpha, as ours.
"""

from dataclasses import replace
from pathlib import Path

import torch

from ..io import files
from ..material.conversion import layered, relative_f0, usual_f0
from ..material.maps import DIELECTRIC_F0, SVBRDF
from ..material.naming import SURFACES
from ..render.bsdf import index_from_f0
from .residual import shown_residual
from .textures import DEFAULTS, NOTES, SRGB, Export, ExportSettings, rendered, write_pngs

# File -> its version of MaterialX, and its shader.
DOCUMENTS = {"material.mtlx": ("1.38", "standard_surface"), "openpbr.mtlx": ("1.39", "open_pbr_surface")}


def write_materialx(folder: Path, svbrdf: SVBRDF, settings: ExportSettings = DEFAULTS) -> Export:
    """Write ``folder/material.mtlx``, ``folder/openpbr.mtlx`` and ``folder/textures/*``."""
    material, level, largest = svbrdf, DIELECTRIC_F0, 1.0
    if svbrdf.bsdf == "roughconductor":
        level = usual_f0(svbrdf)
        material, relative = layered(svbrdf, torch.tensor(level)), relative_f0(svbrdf, level)
        lost = {"materialx": shown_residual(svbrdf, material, relative * level, torch.tensor(level))}
        largest = max(float(relative.max()), 1.0)  # a texture's values end at 1, the factor's do not
    else:
        lost = {"base colour as it is": shown_residual(svbrdf, svbrdf)}
    maps = {name: (f"textures/{name}.png", value, settings.bits) for name, value in material.maps.items()}
    if svbrdf.bsdf == "roughconductor":
        maps["specular"] = "textures/specular_color.png", relative / largest, settings.bits
    written = write_pngs(folder, maps)
    if "specular" in written:
        written["specular_color"] = replace(written.pop("specular"),
                                            holds=f"F0 over {level:.6g}, divided by {largest:.6g}")
    kinds = {name: "vector3" if texture.normal else "color3" if texture.colour_space == SRGB else "float"
             for name, texture in written.items()}
    for file, (version, node) in DOCUMENTS.items():
        files.write_bytes(folder / file, rendered(
            "material.mtlx", version=version, node=node, inputs=SURFACES[node], textures=written, kinds=kinds,
            index=float(index_from_f0(torch.tensor(level))), largest=largest,
            wrap="periodic" if settings.repeats else "clamp"))
    return Export(tuple(DOCUMENTS), tuple(written.values()), tuple(NOTES["materialx"][svbrdf.bsdf]), lost)
