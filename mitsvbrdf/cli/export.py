"""``mitsvbrdf export``: the material for other programs."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..errors import BackendError
from ..export import FORMATS, check_options, export_material
from ..export.textures import Bits, Export, ExportSettings, Naming, NormalConvention
from ..io import images, results
from ..io.progress import say
from ..material.maps import SVBRDF
from ..material.resample import area_averaged
from ..material.tiling import seam, seamless
from ..relight.stage import sphere
from . import options

PREVIEW, THUMBNAIL = 512, 128  # pixels a side


def export(
    maps: Positional[options.Material],
    to: Annotated[str, arg(metavar="FORMAT,...", help=f"Any of {', '.join(FORMATS)}.")] = ",".join(FORMATS),
    encoding: options.MapEncoding = (),
    naming: Annotated[Naming, arg(help="File names of the maps format.")] = "own",
    normal: Annotated[NormalConvention, arg(
        help="Normals of the maps format: gl is +Y up, dx +Y down.")] = "gl",
    bits: Annotated[Bits, arg(
        help="Bits of PNG files. Always 8 in glTF and for colours in USD, always 16 for heights.")] = 16,
    tile: Annotated[bool, arg(help=(
        "Join opposite edges, so that the material can be repeated. The patch becomes smaller; its new side "
        "is printed."))] = False,
    side_cm: Annotated[float | None, arg(help=(
        "Side of the patch in cm, before --tile. Default: from the sheet of the photos, if any."))] = None,
    licence: Annotated[str | None, arg(
        metavar="TEXT", help="Licence of the material, such as CC0-1.0.")] = None,
    preview: Annotated[bool, arg(help="Omit the picture of a sphere.", help_behavior_hint="")] = True,
    zip: Annotated[bool, arg(help="Also write each format's folder as FORMAT.zip.")] = False,
    out: Annotated[Path | None, arg(
        aliases=["-o"], help="Folder to write. Default: export inside MAPS.")] = None,
    overwrite: options.Overwrite = False, strict: options.Strict = False,
) -> int:
    """Write a material for other programs: OUT/FORMAT/, with an export.json that states what each file holds.

    gltf is one GLB with its textures. materialx holds a standard_surface and an OpenPBR surface. usd holds a
    UsdPreviewSurface. mitsuba holds a scene. maps holds PNG files. The command prints what a format loses:
    RMSE of diffuse and specular (linear^(1/2.2)) and of pictures under three lights (display values).
    """
    formats = [part.strip() for part in to.split(",")]
    settings = ExportSettings(options.name_of(maps), naming, normal, bits,
                              None if side_cm is None else side_cm / 100, licence or None, tile)
    check_options(formats, settings)
    out = out or options.folder_inside(maps, "export")
    svbrdf, fit = options.material_of(maps, 256, encoding), options.fit_of_maps(maps)
    side = fit.side_metres if settings.side is None else settings.side
    options.keep_apart_from_maps(maps, out)
    if tile:
        svbrdf, side = _tiled(svbrdf, side)
    with results.output_folder(out, overwrite) as folder:
        done = export_material(svbrdf, folder, formats, settings=replace(settings, side=side),
                               views=fit.known_views)
        if zip:
            for kind in done:
                shutil.make_archive(str(folder / kind), "zip", folder, kind)
        if preview:
            _draw(folder, svbrdf)
    _tell(out, done)
    return 0


def _tiled(svbrdf: SVBRDF, side: float | None) -> tuple[SVBRDF, float | None]:
    svbrdf, part = seamless(svbrdf)
    times = f"the maps differ across them {seam(svbrdf):.1f} times as much as beside them"
    if part == 1:
        say(f"the edges meet already: {times}")
        return svbrdf, side
    left = f"{100 * part * side:.3g} of {100 * side:.3g} cm" if side else "its length is unknown"
    say(f"the edges were joined: {times}; {part:.0%} of the patch's side is left ({left}), at the same "
        "resolution")
    return svbrdf, part * side if side else None


def _draw(folder: Path, svbrdf: SVBRDF) -> None:
    """Write ``preview.png`` and ``thumbnail.png``; no error if Mitsuba cannot run: they are optional."""
    try:
        picture = sphere(svbrdf, PREVIEW)
    except BackendError as error:
        say(f"no preview: {error}")
        return
    images.write_png(folder / "preview.png", picture)
    images.write_png(folder / "thumbnail.png", area_averaged(picture, THUMBNAIL))


def _tell(out: Path, done: dict[str, Export]) -> None:
    for kind, written in done.items():
        for what, errors in (written.conversion or {}).items():
            lost = ", ".join(f"{name} {error:.4f}" for name, error in errors.items())
            say(f"lost in {out / kind}, {what}: {lost}")
        say(f"wrote {', '.join(str(out / kind / file) for file in written.files)}")
    if any(written.conversion for written in done.values()):
        say("lost: RMSE, from 0 to 1, of the maps as linear^(1/2.2) and of pictures under three lights in "
            "display values; below 0.004 is less than one step of 8 bits")
