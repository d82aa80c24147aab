"""``mitsvbrdf capture``: raw photos of a phone become a capture."""

from __future__ import annotations

import contextlib
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from ..errors import ConfigError
from ..io import results
from ..io.interrupts import deferred_signals
from ..io.progress import print_rich, progress_bar, say
from .options import Out, Overwrite

if TYPE_CHECKING:
    from ..capture.stages import CaptureResult

PAPER_THICKNESS = 0.01  # cm


def capture(photos: Annotated[Positional[Path],
                              arg(metavar="PHOTOS", help="A folder of raw photos: jpg, png, heic, dng, ...")],
            out: Out,
            sheet: Annotated[float | None,
                             arg(metavar="CM", help="A printed sheet of tags lies around the material: its "
                                 "measured size, over the outer edges of the tags.")] = None,
            depth: Annotated[float, arg(metavar="CM", help="How far the sheet lies above the material; left "
                                                           "out: the paper's "
                                                           "own thickness.")] = PAPER_THICKNESS,
            transfer: Annotated[Literal["auto", "srgb", "gamma2.2", "linear"],
                                arg(help="How photos encode light; auto: linear for RAW files, else srgb.")] = "auto",
            resolution: Annotated[int, arg(help="Side of the rectified photos; never more than the photos "
                                                "show.")] = 1024,
            reference: Annotated[Literal["best", "first"],
                                 arg(help="Without a sheet, which photo says what is up: the one taken most "
                                          "nearly from "
                                          "straight above, or the first.")] = "best",
            overwrite: Overwrite = False) -> int:
    """Make a capture of raw photos, for `mitsvbrdf fit`: find out where the phone was, rectify, leave bad
    photos out.

    Nine photos of a flat material from nine places, flash on, exposure and focus locked; see docs/capture.md.
    With a printed sheet of tags around the material (`mitsvbrdf sheet`) and --sheet, lengths are in cm and
    exact; without, poses come from what the photos have in common.

    OUT holds capture.json, the rectified photos in target/, and quality.html: what was left out and why, and
    where to stand for one more photo; contact.jpg and quality.json beside it.
    """
    from ..capture import write_capture
    from ..capture.align.from_sheet import refuse_tags
    from ..capture.photo import Photo, photos_in
    from ..capture.stages import capture_keys, make_capture
    from ..report.capture_page import write_quality

    if os.path.realpath(photos) in (os.path.realpath(out), os.path.realpath(out / "target")):
        raise ConfigError("an output folder of its own", f"{out}, which holds the photos",
                          "choose another folder")
    if sheet is None and depth != PAPER_THICKNESS:
        raise ConfigError("--sheet CM beside --depth", f"--depth {depth:g} alone",
                          "add --sheet, or leave --depth out")
    if (photos / "capture.json").is_file():
        raise ConfigError("a folder of raw photos", f"{photos}, which is a capture already",
                          f"mitsvbrdf fit {photos} -o OUT")
    raw = [Photo.open(path) for path in photos_in(photos)]
    if sheet is None:
        refuse_tags(raw)
    with contextlib.ExitStack() as last, results.output_folder(out, overwrite) as folder:
        with progress_bar("capture") as report:
            result = make_capture(raw, sheet, depth, None if transfer == "auto" else transfer, resolution,
                                  reference, report)
        last.enter_context(deferred_signals())  # until all is in place
        write_capture(result.capture, folder, capture_keys(result))
        write_quality(result, folder)
    _print(result, resolution)
    say(f"wrote {out}/quality.html, contact.jpg, capture.json, target/; next: mitsvbrdf fit {out} -o OUT")
    return 0


def _print(result: CaptureResult, asked: int) -> None:
    """Each photo with the number that a fit calls it by, and what the user should know; ``asked`` is the
    resolution wanted.
    """
    from rich.table import Table

    from ..capture.quality.next_view import HIGHLIGHT_ANGLE
    from ..fit.options import FitOptions

    table = Table(title=f"{len(result.used)} of {len(result.photos)} photos used", title_justify="left")
    for heading in ("photo", "", "reprojection", "sharpness", "clipped"):
        text = heading in ("photo", "")
        table.add_column(heading, justify="left" if text else "right", no_wrap=not text)
    number = {name: f"used as {i:02d}" for i, name in enumerate(result.used)}
    for photo in result.photos:
        quality, error = result.qualities.get(photo.name), result.rig.errors.get(photo.name)
        table.add_row(photo.name, result.rig.rejected.get(photo.name) or number[photo.name],
                      "" if error is None else f"{error:.2f} px", f"{quality.sharpness:.2f}" if quality
                      else "",
                      f"{quality.clipped:.0%}" if quality else "")
    print_rich(table, markup=False)
    for warning in result.warnings:
        say(f"note: {warning}")
    if (side := result.capture.resolution) < asked:
        say(f"{side} pixels are {'enough' if side >= FitOptions.resolution else 'few'}: a fit takes "
            f"{FitOptions.resolution} "
            "where --resolution asks for no more; photos from closer by would show more")
    say(f"highlights shown of {result.covered:.0%} of the patch"
        + (f"; one more photo would show most {result.next_view.words}" if result.next_view else ""))
    say(f"shown: some photo has its highlight within {math.degrees(HIGHLIGHT_ANGLE):.0f} degrees; how "
        "surely that tells "
        "specular and roughness, `fit` says in its line how sure")
