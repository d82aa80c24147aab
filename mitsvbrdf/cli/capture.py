"""``mitsvbrdf capture``: raw photos of a phone become a capture."""

import contextlib
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rich.table import Table
from tyro.conf import Positional, arg

from ..capture.align.sheet import PAPER_THICKNESS
from ..errors import ConfigError, noted
from ..io import results
from ..io.progress import print_rich, progress_bar, say
from ..io.signals import deferred_signals
from .options import Out, Overwrite, Strict, TransferChoice, folder_of_its_own

if TYPE_CHECKING:
    from ..capture.stages import CaptureResult


def capture(photos: Annotated[Positional[Path], arg(
                metavar="PHOTOS", help="A folder of raw photos: jpg, png, heic, dng, ...")],
            out: Out,
            sheet: Annotated[float | None, arg(metavar="CM", help=(
                "Measured size of the printed sheet of tags around the material, from outer edge to outer "
                "edge of the tags. Default: no sheet."))] = None,
            depth: Annotated[float, arg(metavar="CM", help=(
                "Height of the sheet above the material. Default: thickness of paper."))] = PAPER_THICKNESS,
            transfer: Annotated[TransferChoice, arg(
                help="How photos encode light. auto: linear for RAW files, else srgb.")] = "auto",
            resolution: Annotated[int, arg(
                help="Largest side of the rectified photos. Photos are never enlarged.")] = 1024,
            reference: Annotated[Literal["best", "first"], arg(help=(
                "Without a sheet: photo that defines up. best: the one most nearly from above."))] = "best",
            overwrite: Overwrite = False, strict: Strict = False) -> int:
    """Make a capture from raw photos for `mitsvbrdf fit`: find the poses, rectify, reject bad photos.

    Take nine photos of a flat material from nine places, with flash, exposure and focus locked; see
    docs/capture.md. With a printed sheet of tags (`mitsvbrdf sheet`) and --sheet, lengths are exact and in
    cm. Without a sheet, poses come from image features that the photos share.

    OUT contains capture.json and the rectified photos in target/. quality.html lists rejected photos with
    the reason, and the place where one more photo helps most. quality.json has the numbers of that page.
    """
    from ..capture import write_capture
    from ..capture.align.from_sheet import refuse_tags
    from ..capture.photo import Photo, photos_in
    from ..capture.stages import capture_keys, make_capture
    from ..report.capture_page import write_quality

    if os.path.realpath(photos) in (os.path.realpath(out), os.path.realpath(out / "target")):
        raise folder_of_its_own(out, "photos")
    if sheet is None and depth != PAPER_THICKNESS:
        raise ConfigError("--sheet CM beside --depth", f"--depth {depth:g} alone", "give both, or none")
    if (photos / "capture.json").is_file():
        raise ConfigError("a folder of raw photos", f"{photos}, which is a capture already",
                          f"mitsvbrdf fit {photos} -o OUT")
    with noted() as warned:
        raw = [Photo.open(path) for path in photos_in(photos)]
        if sheet is None:
            refuse_tags(raw)
    with contextlib.ExitStack() as last, results.output_folder(out, overwrite) as folder:
        with noted() as later, progress_bar("capture") as report:
            result = make_capture(raw, sheet, depth, None if transfer == "auto" else transfer, resolution,
                                  reference, report)
        warned += later
        result = replace(result, warnings=tuple(dict.fromkeys((*warned, *result.warnings))))
        last.enter_context(deferred_signals())  # no Ctrl-C until all files are in place
        write_capture(result.capture, folder, capture_keys(result))
        write_quality(result, folder)
    _print(result, warned)
    say(f"wrote {out}/quality.html, capture.json, target/; next: mitsvbrdf fit {out} -o OUT")
    return 0


def _print(result: "CaptureResult", warned: list[str]) -> None:
    """Print a table of the photos, new warnings, and the share of the patch that has a highlight."""
    from ..capture.quality.next_view import HIGHLIGHT_ANGLE

    table = Table(title=f"{len(result.used)} of {len(result.photos)} photos used", title_justify="left")
    tags = result.rig.tags
    for heading in ("photo", "", *(["tags"] if tags else []), "reprojection", "sharpness", "clipped"):
        text = heading in ("photo", "")
        table.add_column(heading, justify="left" if text else "right", no_wrap=not text)
    number = {name: f"used as {i:02d}" for i, name in enumerate(result.used)}
    for photo in result.photos:
        quality, error = result.qualities.get(photo.name), result.rig.errors.get(photo.name)
        table.add_row(photo.name, result.rig.rejected.get(photo.name) or number[photo.name],
                      *([f"{tags[photo.name]} of 16" if photo.name in tags else ""] if tags else []),
                      "" if error is None else f"{error:.2f} px",
                      *((f"{quality.sharpness:.2f}", f"{quality.clipped:.0%}") if quality else ("", "")))
    print_rich(table, markup=False)
    for warning in result.warnings:
        if warning not in warned:
            say(f"note: {warning}")
    if not result.capture.calibrated:
        return
    say(f"{result.covered:.0%} of the patch has a highlight, within {math.degrees(HIGHLIGHT_ANGLE):.0f} "
        "degrees, in some photo"
        + (f"; one more photo would show most {result.next_view.words}" if result.next_view else ""))
    say("`mitsvbrdf fit` says how well these highlights determine specular and roughness")
