"""Maps in files: a folder has one image for each map, and the images' encodings in ``material.json``.

:func:`load_maps` reads our own sets, those of SVBRDF research ("the field") and those of texture libraries.
:func:`save_maps` writes our own.
"""

import contextlib
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..errors import MapsError
from ..io import files, images
from ..io.entry import entry
from .encoding import ENCODINGS, NormalConvention, asked_codes, read_material_json
from .gltf_set import gltf_set
from .map_set import MapSet, find_maps, read_set, strip_set
from .maps import COLOURS, SVBRDF, TITLES, Bsdf
from .mtlx_set import mtlx_set
from .naming import SUFFIXES

DETAIL, FORMER_DETAIL = "detail", "look"
MAP_FOLDERS = "maps", DETAIL, FORMER_DETAIL  # of a fit: expected values; with plausible detail (two names)


@entry()
def load_maps(folder: str | Path, bsdf: Bsdf | None = None, encoding: str | None = None,
              normal: NormalConvention | None = None) -> SVBRDF:
    """Read a set of maps.

    It reads our own folders, the field's four images and strips, and files named as libraries and programs
    name them (words of ``names.toml``), with prefixes, sizes and packed channels. EXR is preferred over PNG.
    If the folder has a ``maps/``, that is read; if it has no maps, its ``textures/``. List: docs/formats.md.

    Args:
        folder: a folder; a .glb, .gltf or .mtlx file of one material; or a strip (one image of all maps). In
            a folder, ``tex.png`` and ``strip.png`` are strips, and a .mtlx is preferred to the files' names.
        bsdf: which parameter set to read. Default: the one in material.json. If none is stated and there is
            no metallic, ``roughconductor`` for the field's names and for a specular map in colour or beside
            gloss. Else ``principled``, converted to ``roughconductor`` if there is a specular level.
        encoding: of 8- and 16-bit files: ``linear``, ``gamma 2.2`` or ``srgb``, or one for each map:
            ``roughness=linear,diffuse=srgb``. Default: material.json, else the file's colour profile, else
            gamma 2.2 for the field's names; for other names, sRGB for colours, else linear. EXR is linear.
        normal: ``gl`` (+Y up) or ``dx`` (+Y down). Default: as stated in material.json or the file's name,
            else by the curl of the slopes, else ``gl``.

    Warns:
        AssumedWarning: something is assumed, missing or not read.
        MapsWarning: normals are or may be DirectX's; values, or up to 1 % of the normals, were corrected.

    Raises:
        MapsError: something is missing or wrong. ConfigError: an unknown word in ``encoding``.
    """
    with _found(Path(folder), encoding, normal) as found:
        return read_set(found, bsdf).check()


@contextlib.contextmanager
def _found(path: Path, encoding: str | None, normal: NormalConvention | None = None) -> Iterator[MapSet]:
    """The map set at a path, with the requested encodings; its temporary files exist only in the context."""
    asked = asked_codes(encoding, normal)
    with contextlib.ExitStack() as last:
        found = _set_of(path, last)
        exr = [name for name, source in found.sources.items() if asked.get(name) in ("srgb", "gamma 2.2")
               and source.path and source.path.suffix.lower() == ".exr"]
        said = (f"--encoding does not apply to EXR, which is linear: {', '.join(exr)}",) if exr else ()
        yield found._replace(stated=dict(found.stated) | asked, remarks=(*found.remarks, *said))


def _set_of(path: Path, last: contextlib.ExitStack) -> MapSet:
    """The map set of a document, of a strip, of the document in a folder, or of the folder's files."""
    if path.suffix.lower() in (".glb", ".gltf") and path.is_file():
        return gltf_set(path, Path(last.enter_context(tempfile.TemporaryDirectory())))
    if path.suffix.lower() in SUFFIXES and path.is_file():
        return strip_set(path, read_material_json(path.parent).get("encoding", {}))
    documents = [*path.glob("material.mtlx")] or sorted(path.glob("*.mtlx")) or (
        [path] if path.suffix.lower() == ".mtlx" and path.is_file() else [])
    if not documents or (path / "material.json").is_file():
        return find_maps(path)
    try:
        if len(documents) > 1:
            raise MapsError("one .mtlx", ", ".join(each.name for each in documents), "give one of the files")
        return mtlx_set(documents[0])
    except MapsError as error:
        if path.is_file() or "roughness" not in (found := find_maps(path)).sources:
            raise
        said = f"read by the names of the files, without the document: {error.got}"
        return found._replace(remarks=(said,))


def encodings(folder: str | Path, encoding: str | None = None) -> dict[str, str]:
    """The encoding of each map's file (not of normals): a dict, map to encoding; see :func:`load_maps`."""
    with _found(Path(folder), encoding) as found:
        return {name: found.code(name) for name in TITLES if name != "normal"}


@entry()
def save_maps(svbrdf: SVBRDF, folder: str | Path) -> SVBRDF:
    """Write float32 EXR masters (linear), 16-bit PNGs (colours sRGB, the rest linear) and material.json.

    Normals are (n + 1) / 2 in both. For a principled material, diffuse and specular maps are written too, for
    tools that need them. Returns the material as :func:`load_maps` reads it: its normals differ by rounding.
    MapsError: values out of range (:meth:`SVBRDF.check`), which :func:`load_maps` would refuse.
    """
    folder = Path(folder)
    svbrdf = svbrdf.detach().check()
    both = dict(svbrdf.as_roughconductor().maps) | dict(svbrdf.maps)

    def write(name: str, value: Tensor) -> None:
        linear = (value + 1) / 2 if name == "normal" else value
        images.write_exr(folder / f"{name}.exr", linear)
        images.write_png(folder / f"{name}.png", linear, 16,
                         partial(color.encode, transfer="srgb") if name in COLOURS else Tensor.detach)

    images.write_all([partial(write, *each) for each in both.items()])
    encoding = {name: code for name, code in ENCODINGS["srgb"].items() if name in both}
    files.write_json(folder / "material.json", {
        "bsdf": svbrdf.bsdf, "size": svbrdf.resolution, "encoding": encoding | {"normal": "(n+1)/2, +Y up"},
        "note": "encoding of the PNG files; EXR files are linear"})
    stored = {name: value.float() for name, value in svbrdf.maps.items()}
    return SVBRDF(svbrdf.bsdf, stored | {"normal": F.normalize((stored["normal"] + 1) / 2 * 2 - 1, dim=-1)})
