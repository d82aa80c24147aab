"""A material in the formats of other programs, one folder a format."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import get_args

from ..errors import ConfigError
from ..io.entry import entry
from ..material.maps import SVBRDF
from ..views import Views, nine_view_grid
from .textures import DEFAULTS, Bits, Export, ExportSettings, Naming, NormalConvention

FORMATS = ("gltf", "materialx", "usd", "mitsuba", "maps")
SMALLEST, LARGEST = 1e-3, 1e6  # side of a patch, centimetres


@entry()
def export_material(svbrdf: SVBRDF, out: str | Path, to: Sequence[str] = FORMATS, *,
                    settings: ExportSettings = DEFAULTS, views: Views | None = None) -> dict[str, Export]:
    """Write ``out/FORMAT/`` for each format, with an ``export.json`` that describes every file.

    Args:
        svbrdf: the material.
        out: the folder; made if it is missing.
        to: names from :data:`FORMATS`.
        settings: names, bits, size and licence.
        views: the Mitsuba scene shows the first; default: from above, near the centre.

    Returns:
        A dict: format to what was written.

    Raises:
        ConfigError: an unknown format, a naming or DirectX normals without ``maps``, or a side out of range.
        MapsError: values out of range (:meth:`SVBRDF.check`).
    """
    from . import gltf, maps, materialx, mitsuba, usd

    out, svbrdf = Path(out), svbrdf.detach().check()
    check_options(to, settings)
    writers: dict[str, Callable[[Path, SVBRDF, ExportSettings], Export]] = {
        "gltf": gltf.write_gltf, "materialx": materialx.write_materialx, "usd": usd.write_usd,
        "mitsuba": partial(mitsuba.write_mitsuba, views=views or nine_view_grid()), "maps": maps.write_maps}
    done = {}
    for kind in dict.fromkeys(to):
        done[kind] = writers[kind](out / kind, svbrdf, settings)
        done[kind].write(out / kind, format=kind, name=settings.name, bsdf=svbrdf.bsdf,
                         size=svbrdf.resolution,
                         side_metres=settings.side, licence=settings.licence, repeats=settings.repeats)
    return done


def check_options(to: Sequence[str], settings: ExportSettings = DEFAULTS) -> None:
    """Raise ConfigError for options that :func:`export_material` does not accept, before it writes a file."""
    for kind in to or ("",):
        if kind not in FORMATS:
            raise ConfigError(f"formats of {', '.join(FORMATS)}", repr(kind), "choose some of these")
    for what, value, literal in (("a naming", settings.naming, Naming),
                                 ("a normal convention", settings.normal, NormalConvention),
                                 ("bits", settings.bits, Bits)):
        choices = get_args(literal)
        if value not in choices:
            raise ConfigError(f"{what} of {', '.join(map(str, choices))}", repr(value), "choose one of these")
    if settings.side is not None and not SMALLEST <= 100 * settings.side <= LARGEST:
        raise ConfigError(f"a side of {SMALLEST:g} to {LARGEST:g} cm", f"{100 * settings.side:g}",
                          "ExportSettings takes metres, --side-cm centimetres")
    if "maps" not in to and (settings.naming, settings.normal) != ("own", "gl"):
        raise ConfigError("maps among the formats, beside a naming or DirectX normals", ", ".join(to),
                          "add maps: the other formats define names and normals themselves")
