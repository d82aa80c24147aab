"""``mitsvbrdf export``: the material for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..errors import ConfigError
from ..export import FORMATS, check_options, export_material
from ..export.maps import Naming
from ..export.textures import Bits, NormalConvention
from ..system import result_folder
from ..system.progress import say
from .options import Material, Overwrite, fit_of_maps, keep_apart_from_maps, material_of, name_of


def export(maps: Positional[Material],
           to: Annotated[str, arg(metavar="FORMAT,...", help=f"Any of {', '.join(FORMATS)}.")] = ",".join(FORMATS),
           naming: Annotated[Naming, arg(help="File names of the maps format.")] = "own",
           normal: Annotated[NormalConvention, arg(help="Normals of the maps format: gl is +Y up, dx +Y down.")] = "gl",
           bits: Annotated[Bits, arg(help="Of PNG files; glTF and colours in USD always have 8.")] = 16,
           out: Annotated[Path | None, arg(aliases=["-o"], help="Folder to write; left out: export inside MAPS.")] = None,
           overwrite: Overwrite = False) -> int:
    """Write a material for other programs: OUT/FORMAT/, with an export.json that states what each file holds.

    gltf is one GLB with the textures inside; materialx a standard_surface; usd a UsdPreviewSurface; mitsuba a scene and its
    material as JSON; maps PNG files. Where diffuse and specular have to become base colour and metallic (gltf, maps), what
    that loses is printed: RMSE of both maps as linear^(1/2.2).
    """
    formats = [part.strip() for part in to.split(",")]
    check_options(formats, naming, normal, bits)
    builtin = maps.startswith("builtin:")
    if builtin and out is None:
        raise ConfigError("an output folder, beside a builtin material", "none", "add -o FOLDER")
    out = out or Path(maps) / "export"
    svbrdf, fit = material_of(maps), fit_of_maps(maps)
    name = name_of(maps)
    if not builtin:
        keep_apart_from_maps(Path(maps), out)
    with result_folder.output_folder(out, overwrite) as folder:
        done = export_material(svbrdf, folder, formats, name, naming, normal, bits, fit.views)
    for kind, written in done.items():
        for what, errors in (written.conversion or {}).items():
            say(f"lost in {kind}, {what}: " + ", ".join(f"{name} {error:.4f}" for name, error in errors.items()))
        say(f"wrote {', '.join(str(out / kind / file) for file in written.files)}")
    return 0
