"""Shared by the commands: types of options, checks of outputs, reading of photos, maps and views.

Every command imports this module. Modules that need torch are therefore imported inside functions.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import UseAppendAction, arg

from ..color import Transfer
from ..errors import ConfigError, OutputError, noted
from ..io import files
from ..io.progress import progress_bar, say
from ..io.results import MANIFEST, own_files

if TYPE_CHECKING:
    from ..capture import Capture
    from ..fit.result import Fit
    from ..material.maps import SVBRDF
    from ..views import Falloff, Views

Out = Annotated[Path, arg(aliases=["-o"], help="Folder (or file) to write.")]
Overwrite = Annotated[bool, arg(help="Replace earlier results, and remove their export/ and relight/.")]
JsonFile = Annotated[Path | None, arg(name="json", help="Write all figures to this file.")]
Reference = Annotated[str | None, arg(help="Known maps: a folder, a .glb file or builtin:NAME.")]
# cli.command runs the commands that have Strict inside errors.strict.
# MapEncoding and MapNormal apply to the files of --reference, or without --reference to those of MAPS.
MapEncoding = UseAppendAction[Annotated[tuple[str, ...], arg(metavar="NAME=CODE", help=(
    "Encoding of known maps of 8 or 16 bits: linear, srgb or gamma2.2 for all maps (with "
    "NAME=: for one map), normal=dx or normal=gl. Overrides the stated encoding. May be repeated."))]]
MapNormal = Annotated[Literal["auto", "gl", "dx"], arg(help=(
    "Normals of known maps. gl: +Y up. dx: +Y down (DirectX). auto: as stated, else found from the slopes."))]
Strict = Annotated[bool, arg(help="Refuse damaged photos and maps. Default: mend them with a warning.")]
Variant = Annotated[Literal["llvm_ad_rgb", "cuda_ad_rgb"], arg(help="Mitsuba variant.")]
ViewList = Annotated[str | None, arg(metavar="0,1,2,...", help="Numbers of photos to use. Default: all.")]
Material = Annotated[str, arg(metavar="MAPS", help=(
    "The OUT of a fit (OUT/detail for its plausible detail), a folder of maps, a .glb file, or builtin:NAME "
    "(inlay, tiles, leather, plates)."))]
ViewSource = Annotated[str, arg(help="Capture with the views, or builtin:grid: nine, 2 patch sides away.")]
Photos = Annotated[Path, arg(metavar="CAPTURE", help=(
    "A folder of photos, calibrated or plain; see docs/formats.md."))]
TransferChoice = Literal["auto", Transfer]
TransferOption = Annotated[TransferChoice, arg(help=(
    "How photos encode light. auto: as stated in the capture, else gamma2.2 if calibrated without a "
    "colour profile, linear if RAW, else srgb."))]
FittedTransfer = Annotated[TransferChoice, arg(help=(
    "Encoding of light in photos. auto: as in the fit to these photos, else as stated in the capture."))]
RefineViews = Annotated[bool, arg(help="Also measure with refined camera, flash and exposure of each photo.")]
FalloffOption = Literal["auto", "inverse-square", "none"]


def folder_of_its_own(out: Path, what: str) -> ConfigError:
    """The error for an output folder that contains the photos or maps to be read."""
    got = f"{out}, which holds the {what}"
    return ConfigError("an output folder of its own", got, "choose another folder")


def keep_apart(capture: Path, out: Path) -> None:
    """Raise ConfigError if the photos are in ``out`` or its photos/: results could replace them."""
    if _photo_folders(capture) & {os.path.realpath(path) for path in (out, out / "photos")}:
        raise folder_of_its_own(out, "photos")


def keep_apart_from_maps(maps: str, out: Path) -> None:
    """Raise ConfigError if ``out`` is the folder of the maps, its maps/, or the folder above it."""
    folders = {os.path.realpath(os.path.join(maps, part)) for part in ("", "maps", "..")}
    if not maps.startswith("builtin:") and os.path.realpath(out) in folders:
        raise folder_of_its_own(out, "maps")


def folder_inside(maps: str, name: str) -> Path:
    """The default output: folder ``name`` in ``maps``. Raises if ``maps`` is no folder or ``name`` a link."""
    if maps.startswith("builtin:") or Path(maps).is_file():
        raise ConfigError(f"an output folder beside {maps}, which is no folder", "none", "add -o FOLDER")
    found = files.inside(Path(maps), name)
    if found is None:
        raise OutputError(f"a folder {name} inside {maps}", "a link, or a name that leads elsewhere",
                          "move the link away, or name a folder with -o")
    return found


def name_of(maps: str) -> str:
    """Name of a material: NAME of ``builtin:NAME``, else its folder's name (detail maps: with -detail)."""
    if maps.startswith("builtin:"):
        return maps.removeprefix("builtin:")
    folder = Path(os.path.abspath(maps))
    from ..material.map_files import DETAIL, FORMER_DETAIL

    if folder.name in (DETAIL, FORMER_DETAIL) and (folder.parent / "maps").is_dir():
        return f"{folder.parent.name}-{DETAIL}"
    return folder.parent.name if folder.name == "maps" else folder.name


def check_new_files(*outputs: Path | None, overwrite: bool, read: Sequence[str | Path | None] = (),
                    photos: str | Path | None = None) -> None:
    """Before any work: refuse output files that exist or cannot be written. None is passed over.

    ``overwrite`` allows an existing file. Always refused: a file in ``read``, a file of a result folder, and
    a file beside the photos of the capture ``photos``.

    Raises:
        OutputError: a file exists already, or cannot be written.
        ConfigError: two outputs are one file, or an output is always refused.
    """
    files.check_output(*outputs)
    sources, earlier = {os.path.realpath(path) for path in (*read, photos) if path}, list[Path]()
    for path in filter(None, outputs):
        target = Path(os.path.realpath(path))
        if any(target == other or target in other.parents or other in target.parents for other in earlier):
            raise ConfigError("a file of its own for each output", f"{path} for two", "give another name")
        if str(target) in sources or photos and os.path.realpath(path.parent) in _photo_folders(Path(photos)):
            raise ConfigError("an output apart from what is read", str(path), "choose another name or folder")
        home = next((folder for folder in target.parents if (folder / MANIFEST).is_file()), None)
        if home is not None and str(target.relative_to(home)) in own_files(home):
            raise ConfigError("an output that is no part of a result", str(path), "choose another name")
        if path.is_file() and not overwrite:
            raise OutputError("a new file", f"{path}, which exists",
                              "add --overwrite to replace it, or choose another name")
        earlier.append(target)


def _photo_folders(capture: Path) -> set[str]:
    """Folders that may have photos: ``capture`` (of a file: its folder), and target/ in this folder."""
    capture = capture.parent if capture.is_file() else capture
    return {os.path.realpath(path) for path in (capture, capture / "target")}


def chosen(option: str, text: str, choices: Collection[str]) -> list[str]:
    """Split a text at its commas into words. ConfigError: there is no word, or one that is no choice."""
    found = list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    for each in found or ["none"]:
        if each not in choices:
            raise ConfigError(f"{option} of {', '.join(choices)}", repr(each), f"check {option}")
    return found


def check_side(resolution: int | None) -> None:
    """Raise ConfigError for a --resolution below 8. None is allowed."""
    if resolution is not None and resolution < 8:
        raise ConfigError("--resolution of 8 or more", str(resolution), "try 256")


def read_photos(capture: Path, resolution: int, views: str | None, transfer: TransferChoice,
                falloff: Falloff) -> Capture:
    """Read a capture with these options, and print its notes."""
    from ..capture import read_capture
    from ..views import photo_numbers

    check_side(resolution)
    with noted() as warned, ExitStack() as open_bar:
        # only plain photos report progress
        bar = functools.cache(lambda: open_bar.enter_context(progress_bar("capture")))
        shots = read_capture(capture, resolution=resolution, index=photo_numbers(views), falloff=falloff,
                             transfer=None if transfer == "auto" else transfer,
                             report=lambda text, share: bar()(text, share))
    if shots.source and (shots.source / "quality.html").is_file():
        say(f"photos go by their numbers in {shots.source}/quality.html, which names the file of each")
    for note in shots.notes:
        if note not in warned:
            say(note)
    return shots


def material_of(name: str, resolution: int = 256, encoding: MapEncoding = (),
                normal: MapNormal = "auto") -> SVBRDF:
    """Maps: from a folder or file; ``builtin:NAME`` is made at this resolution."""
    from ..material.made import make_material
    from ..material.map_files import load_maps

    if name.startswith("builtin:"):
        if encoding or normal != "auto":
            raise ConfigError("files beside --encoding or --normal", name, "leave these options out")
        return make_material(name.removeprefix("builtin:"), resolution)
    return load_maps(name, None, ",".join(encoding) or None, None if normal == "auto" else normal)


def errors_against(reference: str, resolution: int, encoding: MapEncoding,
                   normal: MapNormal) -> Callable[[SVBRDF], dict[str, float]]:
    """A function: maps to their RMSE against ``reference``; ``builtin:NAME`` is made at this resolution."""
    from ..evaluate import evaluate_maps
    from ..measure.metrics import map_rmse

    if reference.startswith("builtin:"):
        known = material_of(reference, resolution, encoding, normal)
        return lambda maps: map_rmse(maps, known)
    return lambda maps: evaluate_maps(maps, reference, ",".join(encoding) or None,
                                      None if normal == "auto" else normal)


def views_of(source: str, falloff: Falloff, fit: Fit | None = None) -> tuple[list[str], Views]:
    """Names and views: of a capture, placed as in the fit, or of ``builtin:grid``. Prints notes."""
    from ..evaluate.placement import named_views

    names, views, notes = named_views(source, falloff, fit)
    for note in notes:
        say(note)
    return names, views


def fit_of_maps(maps: str | None) -> Fit:
    """The fit that made the maps. If there is none, as for ``builtin:NAME``: a fit without a record."""
    from ..fit.result import Fit

    return Fit() if maps is None or maps.startswith("builtin:") else Fit.of_maps(maps)
