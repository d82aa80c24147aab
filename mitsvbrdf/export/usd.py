"""The material as USD text: a ``UsdPreviewSurface``.

``material.usda`` has the material alone, for other files to reference; ``patch.usda`` is a square with it.

Source: UsdPreviewSurface specification 2.6 (Pixar), metallic workflow.
"""

from pathlib import Path

import torch

from ..io import files, images
from ..material.conversion import layered, usual_f0
from ..material.maps import COLOURS, DIELECTRIC_F0, SVBRDF
from ..render.bsdf import index_from_f0
from .residual import GLASS, shown_residual
from .textures import DEFAULTS, LINEAR, NOTES, Export, ExportSettings, Texture, rendered, write_pngs

MATERIAL, PATCH = "material.usda", "patch.usda"
HIGHEST_F0 = 0.9  # of non-metals: a refractive index of 38
INPUTS = {"base_color": "color3f diffuseColor rgb", "metallic": "float metallic r", "ior": "float ior r",
          "roughness": "float roughness r", "normal": "normal3f normal rgb"}


def write_usd(folder: Path, svbrdf: SVBRDF, settings: ExportSettings = DEFAULTS) -> Export:
    """Write ``folder/material.usda``, ``folder/patch.usda`` and ``folder/textures/*.png``."""
    material, textures = svbrdf, {}
    decoding = {"normal": {"scale": "2, 2, 2, 1", "bias": "-1, -1, -1, 0"}}
    usual = GLASS
    if svbrdf.bsdf == "roughconductor":
        f0 = svbrdf["specular"].mean(dim=-1, keepdim=True).clamp_max(HIGHEST_F0)
        usual = torch.tensor(usual_f0(svbrdf))
        material = layered(svbrdf, f0)
        lost = {"preview surface": shown_residual(svbrdf, material, f0),
                "preview surface, one refractive index": shown_residual(svbrdf, material, usual)}
        beyond = index_from_f0(torch.where(material["metallic"] > 0, DIELECTRIC_F0, f0)) - 1
        most = max(float(beyond.max()), 1e-6)
        decoding["ior"] = {"scale": ", ".join([f"{most:.7g}"] * 4), "bias": "1, 1, 1, 1"}
        images.write_png(folder / "textures/ior.png", beyond / most, 16)
        textures["ior"] = Texture("textures/ior.png", f"(refractive index - 1) / {most:.6g}", LINEAR, 16)
    else:
        lost = {"base colour as it is": shown_residual(svbrdf, svbrdf)}
    textures |= write_pngs(folder, {
        name: (f"textures/{name}.png", value, 8 if name in COLOURS else settings.bits)
        for name, value in material.maps.items()})
    about = {"index": float(index_from_f0(usual)), "half": 50 * (settings.side or 0.01),
             "wrap": "repeat" if settings.repeats else "clamp", "maps": [
                 dict(zip(("kind", "input", "channels"), INPUTS[name].split()), name=name, file=texture.file,
                      colour_space=texture.colour_space, decoding=decoding.get(name, {}))
                 for name, texture in textures.items()]}
    for file, prim, unit in ((MATERIAL, "material", 1), (PATCH, "patch", 0.01 if settings.side else 1)):
        files.write_bytes(folder / file, rendered("material.usda", prim=prim, unit=unit, **about))
    return Export((MATERIAL, PATCH), tuple(textures.values()), tuple(NOTES["usd"][svbrdf.bsdf]), lost)
