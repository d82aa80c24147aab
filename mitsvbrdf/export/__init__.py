"""A material in the formats of other programs, one folder a format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from ..errors import ConfigError
from ..material.maps import SVBRDF
from ..views import Views, nine_view_grid
from .maps import Naming
from .textures import Bits, Export, NormalConvention

FORMATS = ("gltf", "materialx", "usd", "mitsuba", "maps")


def export_material(svbrdf: SVBRDF, out: str | Path, to: Sequence[str] = FORMATS, name: str = "material",
                    naming: Naming = "own", normal: NormalConvention = "gl", bits: Bits = 16,
                    views: Views | None = None, side: float | None = None, licence: str | None = None,
                    repeats: bool = False) -> dict[str, Export]:
    """Write ``out/FORMAT/`` for each format, with an ``export.json`` that says what every file holds, and how.

    Args:
        svbrdf: the material, checked (:meth:`SVBRDF.check`).
        out: made when missing.
        to: of :data:`FORMATS`.
        name: the material's, in file names of ``maps``.
        naming: file names of ``maps``.
        normal: of ``maps``; all other formats define theirs, which is OpenGL's.
        bits: of PNG files; colours of ``usd`` and all of ``gltf`` have 8.
        views: the first one is shown by the Mitsuba scene; left out: from above, near the centre.
        side: of the patch in metres, for the sizes of meshes and heights; left out: the mesh has side 1.
        licence: what users may do with it, in every ``export.json`` and in the GLB.
        repeats: whether its edges meet (:func:`mitsvbrdf.material.tiling.seamless`): textures then repeat, and heights go on.

    Returns:
        What was written, by format.

    Raises:
        ConfigError: an unknown format, or an option of ``maps`` without it.
    """
    from . import gltf, maps, materialx, mitsuba, usd

    out, svbrdf = Path(out), svbrdf.detach()
    check_options(to, naming, normal, bits)
    writers = {
        "gltf": lambda folder: gltf.write_gltf(folder, svbrdf, side, licence, repeats),
        "materialx": lambda folder: materialx.write_materialx(folder, svbrdf, bits, repeats),
        "usd": lambda folder: usd.write_usd(folder, svbrdf, bits, side, repeats),
        "mitsuba": lambda folder: mitsuba.write_mitsuba(folder, svbrdf, views or nine_view_grid(), repeats),
        "maps": lambda folder: maps.write_maps(folder, svbrdf, name, naming, normal, bits, side, repeats)}
    done = {}
    for kind in dict.fromkeys(to):
        done[kind] = writers[kind](out / kind)
        done[kind].write(out / kind, format=kind, name=name, bsdf=svbrdf.bsdf, size=svbrdf.resolution, side_metres=side,
                         licence=licence, repeats=repeats)
    return done


def check_options(to: Sequence[str], naming: str = "own", normal: str = "gl", bits: int = 16) -> None:
    """Raise ConfigError for what :func:`export_material` does not know, before anything is written."""
    for kind in to or ("",):
        if kind not in FORMATS:
            raise ConfigError(f"formats of {', '.join(FORMATS)}", repr(kind), "choose of these")
    for what, value, literal in (("a naming", naming, Naming), ("a normal convention", normal, NormalConvention),
                                 ("bits", bits, Bits)):
        choices = get_args(literal)
        if value not in choices:
            raise ConfigError(f"{what} of {', '.join(map(str, choices))}", repr(value), "choose one of these")
    if "maps" not in to and (naming, normal) != ("own", "gl"):
        raise ConfigError("maps among the formats, beside a naming or DirectX normals", ", ".join(to),
                          "add maps: the other formats define names and normals themselves")
