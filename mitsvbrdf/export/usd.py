"""The material as USD text: a ``UsdPreviewSurface``.

``material.usda`` is the material alone, to be referenced and bound; ``patch.usda`` is a square that wears it.

Source: UsdPreviewSurface specification 2.6 (Pixar), metallic workflow.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch

from ..io import files, images
from ..material.conversion import as_shown, layered, usual_f0
from ..material.maps import COLOURS, DIELECTRIC_F0, SVBRDF
from ..render.bsdf import index_from_f0
from .residual import residual
from .textures import DEFAULTS, LINEAR, SRGB, Export, ExportSettings, Texture, write_texture

MATERIAL, PATCH = "material.usda", "patch.usda"
HIGHEST_F0 = 0.9  # of what is no metal: a refractive index of 38
LAYER_NOTE = ("the specular lobe takes its light from the diffuse one, ours is a sum: what is no metal is "
              "darker by F0, 4 %")
NOTES = (
    "metallic workflow: importers (Blender 4.5, three.js) pass the specular one by; F0 of what is no metal "
    "is grey, a texture of the refractive index, beside one index for all where a reader takes no texture",
    "UsdPreviewSurface lets diffuse light through by what the specular lobe leaves, where ours is a sum: "
    "diffuseColor is diffuse / (1 - F0), the same seen from above",
    "its Fresnel curve is Schlick's, ours that of a real refractive index; F0 is the same",
    "colours have 8 bits: GPUs decode sRGB from 8 bits only",
)
INPUTS = {"base_color": "color3f diffuseColor", "metallic": "float metallic", "roughness": "float roughness",
          "normal": "normal3f normal", "ior": "float ior"}

# st = (0, 0) is the lower left corner of an image, so row 0 of it is the top of the patch.
STAGE = '''#usda 1.0
(
    defaultPrim = "{prim}"
    metersPerUnit = {unit}
    upAxis = "Y"
)

{content}'''
SQUARE = '''def Xform "patch"
{{
    def Mesh "square" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        uniform bool doubleSided = 0
        float3[] extent = [(-{h}, -{h}, 0), ({h}, {h}, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        normal3f[] normals = [(0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, 1)] (
            interpolation = "vertex"
        )
        point3f[] points = [(-{h}, -{h}, 0), ({h}, -{h}, 0), ({h}, {h}, 0), (-{h}, {h}, 0)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (
            interpolation = "vertex"
        )
        uniform token subdivisionScheme = "none"
        rel material:binding = </patch/material>
    }}

{material}}}
'''


def write_usd(folder: Path, svbrdf: SVBRDF, settings: ExportSettings = DEFAULTS) -> Export:
    """Write ``folder/material.usda``, ``folder/patch.usda`` and ``folder/textures/*.png``."""
    material, textures, lost = svbrdf, {}, {}
    decoding = {"normal": ((2.0, 2.0, 2.0, 1.0), (-1.0, -1.0, -1.0, 0.0))}
    usual = DIELECTRIC_F0
    if svbrdf.bsdf == "roughconductor":
        f0, usual = svbrdf["specular"].mean(dim=-1, keepdim=True).clamp_max(HIGHEST_F0), usual_f0(svbrdf)
        material = layered(svbrdf, f0)
        for kind, level in {"preview surface": f0,
                            "preview surface, one refractive index": torch.full_like(f0, usual)}.items():
            lost[kind] = residual(svbrdf, as_shown(material, level, level))
        beyond = index_from_f0(torch.where(material["metallic"] > 0, DIELECTRIC_F0, f0)) - 1
        most = max(float(beyond.max()), 1e-6)
        decoding["ior"] = (most,) * 4, (1.0,) * 4
        images.write_png(folder / "textures/ior.png", beyond / most, 16)
        textures["ior"] = Texture("textures/ior.png", f"(refractive index - 1) / {most:.6g}", LINEAR, 16)
    else:
        glass = torch.full_like(svbrdf["metallic"], DIELECTRIC_F0)
        lost = {"base colour as it is": residual(svbrdf, as_shown(svbrdf, glass, glass))}
    for name, value in material.maps.items():
        textures[name] = write_texture(folder, f"textures/{name}.png", name, value, 8 if name in COLOURS
                                       else settings.bits)
    text = _material(textures, float(index_from_f0(torch.tensor(usual))), decoding, settings.repeats)
    alone = STAGE.format(prim="material", unit=1, content=text.format(at="/material"))
    half = (100 * settings.side if settings.side else 1.0) / 2
    worn = SQUARE.format(h=f"{half:.7g}", material=_indented(text.format(at="/patch/material")))
    files.write_bytes(folder / MATERIAL, alone.encode())
    files.write_bytes(folder / PATCH, STAGE.format(prim="patch", unit=0.01 if settings.side else 1,
                                                   content=worn).encode())
    notes = NOTES if svbrdf.bsdf == "roughconductor" else (LAYER_NOTE, *NOTES[2:])
    return Export((MATERIAL, PATCH), tuple(textures.values()), notes, lost)


def _material(textures: Mapping[str, Texture], index: float, decoding: Mapping[str, tuple],
              repeats: bool) -> str:
    """The material prim, its path as ``{at}``; ``index`` serves readers without a texture of it."""
    surface, nodes = [f"float inputs:ior = {index:.7g}"], []
    for name, texture in textures.items():
        kind, entry = INPUTS[name].split()
        channels = "rgb" if "3" in kind else "r"
        surface.append(f"{kind} inputs:{entry}.connect = <{{at}}/{name}.outputs:{channels}>")
        nodes.append(_uv_texture(name, texture, channels, decoding.get(name), repeats))
    shaders = [_shader("surface", "UsdPreviewSurface", "token outputs:surface",
                       "int inputs:useSpecularWorkflow = 0", *surface),
               _shader("st", "UsdPrimvarReader_float2", "float2 outputs:result",
                       'string inputs:varname = "st"'), *nodes]
    return '''def Material "material"
{{
    token outputs:surface.connect = <{at}/surface.outputs:surface>

''' + "\n".join(map(_indented, shaders)) + "}}\n"


def _uv_texture(name: str, texture: Texture, channels: str, decoding: tuple | None, repeats: bool) -> str:
    numbers = [f"float4 inputs:{key} = ({', '.join(f'{x:.7g}' for x in value)})"
               for key, value in zip(("scale", "bias"), decoding or ())]
    kind = "float3" if channels == "rgb" else "float"
    return _shader(
        name, "UsdUVTexture", f"{kind} outputs:{channels}", f"asset inputs:file = @./{texture.file}@",
        "float2 inputs:st.connect = <{at}/st.outputs:result>",
        f'token inputs:sourceColorSpace = "{"sRGB" if texture.colour_space == SRGB else "raw"}"',
        *(f'token inputs:wrap{axis} = "{"repeat" if repeats else "clamp"}"' for axis in "ST"), *numbers)


def _shader(name: str, identifier: str, output: str, *inputs: str) -> str:
    lines = [f'uniform token info:id = "{identifier}"', *inputs, output]
    return f'def Shader "{name}"\n{{{{\n' + "".join(f"    {line}\n" for line in lines) + "}}\n"


def _indented(text: str) -> str:
    return "".join(f"    {line}\n" if line else "\n" for line in text.splitlines())
