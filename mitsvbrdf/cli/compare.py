"""``mitsvbrdf compare``: maps of several methods on one page."""

import os
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..calibrate.refine import Priors
from ..capture import guess_diffuse
from ..errors import ConfigError
from ..evaluate.photos import Entry
from ..evaluate.photos import compare as measure
from ..io import files
from ..io.progress import print_numbers, say, say_written
from ..render import RendererName, make_renderer
from ..report.compare_page import write_compare_page
from ..views import photo_numbers
from . import options

LARGEST_SIDE = 256  # pixels a side, without --resolution


def compare(maps: Positional[Annotated[list[str], arg(metavar="[NAME=]MAPS", help=(
                "Folders of published maps, OUT folders of fits, or builtin:NAME. NAME= sets the caption. "
                "Default caption: the name of the folder."))]],
            capture: Annotated[Path, arg(metavar="CAPTURE", help="Photos to compare.")], out: options.Out,
            reference: options.Reference = None, encoding: options.MapEncoding = (),
            normal: options.MapNormal = "auto", views: options.ViewList = None,
            resolution: Annotated[int | None, arg(
                help="Side of photos and maps. Default: the smallest among them, at most 256.")] = None,
            renderer: RendererName = "mitsuba", transfer: options.FittedTransfer = "auto",
            refine_views: options.RefineViews = False, json_file: options.JsonFile = None,
            variant: options.Variant = "llvm_ad_rgb", overwrite: options.Overwrite = False,
            strict: options.Strict = False) -> int:
    """Show maps of several methods side by side, with errors, and every photo beside its re-renderings.

    `mitsvbrdf compare out materialgan=captures/wood/materialgan --capture captures/wood -o page.html` writes
    one HTML file that needs no network. A photo that a fit saw is rendered with the final view of that fit,
    any other photo as in `mitsvbrdf evaluate`.
    """
    if not maps:
        raise ConfigError("one or more folders of maps", "none", "name them before --capture")
    options.check_side(resolution)
    sources = [*map(_folder, maps), reference]
    options.check_new_files(out, json_file, overwrite=overwrite, photos=capture, read=sources)
    read = ((), "auto") if reference else (encoding, normal)
    entries = [_entry(text, resolution or LARGEST_SIDE, *read) for text in maps]
    size = resolution or min(LARGEST_SIDE, *(entry.svbrdf.resolution for entry in entries))
    photos = options.read_photos(capture, size, None, transfer, "inverse-square")
    chosen = photo_numbers(views)
    shots = photos if chosen is None else photos.pick(chosen)
    for entry in entries:
        if entry.svbrdf.resolution != shots.resolution:
            say(f"{entry.name}: maps of {entry.svbrdf.resolution} px are compared at {shots.resolution} px")
    known, map_errors = None, None
    if reference is not None:
        known = options.material_of(reference, shots.resolution, encoding, normal)
        map_errors = options.errors_against(reference, shots.resolution, encoding, normal)
    record, pictures = measure(entries, photos, make_renderer(renderer, variant), map_errors,
                               None if transfer == "auto" else transfer, Priors() if refine_views else None,
                               shots.index)
    record["reference"] = reference
    for method in record["methods"]:
        say(f"{method['name']}: {method['folder']}, {method['views']}")
    if known is not None:
        print_numbers("Map RMSE, mean", {m["name"]: m["map_rmse"]["mean"] for m in record["methods"]})
    print_numbers("Re-rendering RMSE", {m["name"]: m["rerender_rmse"] for m in record["methods"]})
    write_compare_page(out, record, entries, shots, pictures, guess_diffuse(shots), known)
    if json_file:
        files.write_json(json_file, record)
    say_written(out, json_file)
    return 0


def _entry(text: str, resolution: int, encoding: options.MapEncoding, normal: options.MapNormal) -> Entry:
    """Maps, name and fit of ``[NAME=]MAPS``. Default name: that of the folder."""
    maps = _folder(text)
    name = text[:len(text) - len(maps)].removesuffix("=") or options.name_of(maps)
    svbrdf = options.material_of(maps, resolution, encoding, normal)
    return Entry(name, maps, svbrdf, options.fit_of_maps(maps))


def _folder(text: str) -> str:
    """MAPS of ``[NAME=]MAPS``. An existing path with a = in it is MAPS as a whole."""
    return text if os.path.exists(text) or "=" not in text else text.partition("=")[2]
