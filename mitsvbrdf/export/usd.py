"""One patch with its material as a USD text file: ``UsdPreviewSurface`` with ``UsdUVTexture`` nodes.

Source: UsdPreviewSurface specification 2.6 (Pixar). Its specular workflow has our diffuse and F0; alpha is roughness squared.
"""

from __future__ import annotations

from pathlib import Path

from ..material.maps import CHANNELS, COLOURS, SVBRDF
from ..system import files
from .textures import Bits, Export, write_texture

FILE = "material.usda"
SHADER_INPUTS = {"diffuse": "diffuseColor", "specular": "specularColor", "base_color": "diffuseColor", "metallic": "metallic",
                 "roughness": "roughness", "normal": "normal"}
NOTES = (
    "UsdPreviewSurface lets diffuse light through by what the specular lobe leaves, where ours is a sum",
    "its Fresnel curve is Schlick's, ours that of a real refractive index; F0 is the same",
    "colours have 8 bits: GPUs decode sRGB from 8 bits only",
)

# st = (0, 0) is the lower left corner of an image, so row 0 of it is the top of the patch.
STAGE_TEMPLATE = '''#usda 1.0
(
    defaultPrim = "patch"
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "patch"
{{
    def Mesh "square" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        uniform bool doubleSided = 0
        float3[] extent = [(-0.5, -0.5, 0), (0.5, 0.5, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        normal3f[] normals = [(0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, 1)] (
            interpolation = "vertex"
        )
        point3f[] points = [(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (
            interpolation = "vertex"
        )
        uniform token subdivisionScheme = "none"
        rel material:binding = </patch/material>
    }}

    def Material "material"
    {{
        token outputs:surface.connect = </patch/material/surface.outputs:surface>

        def Shader "surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            int inputs:useSpecularWorkflow = {specular_workflow}
{inputs}
            token outputs:surface
        }}

        def Shader "st"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
{textures}    }}
}}
'''
TEXTURE_TEMPLATE = '''
        def Shader "{name}"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./{file}@
            float2 inputs:st.connect = </patch/material/st.outputs:result>
            token inputs:sourceColorSpace = "{space}"
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"
{more}            {kind} outputs:{channels}
        }}
'''
NORMAL_DECODING = '''            float4 inputs:scale = (2, 2, 2, 1)
            float4 inputs:bias = (-1, -1, -1, 0)
'''


def write_usd(folder: Path, svbrdf: SVBRDF, bits: Bits = 16) -> Export:
    """Write ``folder/material.usda`` and ``folder/textures/*.png``.

    A ``roughconductor`` material uses the specular workflow (diffuse, F0), a ``principled`` one the metallic workflow with
    the default ior of 1.5.

    Args:
        folder: made when missing.
        svbrdf: the material.
        bits: of roughness, metallic and normal.
    """
    written, inputs, nodes = [], [], []
    for name, count in CHANNELS[svbrdf.bsdf].items():
        texture = write_texture(folder, f"textures/{name}.png", name, svbrdf[name], 8 if name in COLOURS else bits)
        written.append(texture)
        kind = "normal3f" if name == "normal" else "float" if count == 1 else "color3f"
        channels = "r" if count == 1 else "rgb"
        inputs.append(f"            {kind} inputs:{SHADER_INPUTS[name]}.connect = </patch/material/{name}.outputs:{channels}>")
        nodes.append(TEXTURE_TEMPLATE.format(
            name=name, file=texture.file, space="sRGB" if name in COLOURS else "raw",
            more=NORMAL_DECODING if name == "normal" else "", kind="float" if count == 1 else "float3", channels=channels))
    workflow = int(svbrdf.bsdf == "roughconductor")
    stage = STAGE_TEMPLATE.format(specular_workflow=workflow, inputs="\n".join(inputs), textures="".join(nodes))
    files.write_bytes(folder / FILE, stage.encode())
    return Export((FILE,), tuple(written), NOTES)
