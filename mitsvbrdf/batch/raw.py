"""Photos as a phone wrote them become a capture before they are fitted."""

from __future__ import annotations

from pathlib import Path

from ..capture import write_capture
from ..capture.align.from_sheet import refuse_tags
from ..capture.photo import Photo, photos_in
from ..capture.rig import LEAST_PHOTOS, OnePlace
from ..capture.stages import capture_keys, make_capture
from ..color import Transfer
from ..report.capture_page import write_quality
from .identity import is_calibrated

SIDE = 1024  # pixels, of the rectified photos


def rectified(folder: Path, out: Path, sheet: float | None, transfer: Transfer | None) -> Path:
    """The capture to fit: of raw photos the one that is made of them, with its page; any other as it is.

    Args:
        folder: the capture's, or its JSON file.
        out: where one is made.
        sheet: size of the printed sheet around the material in cm; None where there is none.
        transfer: how the photos encode light; None where they say it.

    Raises:
        CaptureError: raw photos of which none can be made.
    """
    if is_calibrated(str(folder)):
        return folder
    photos = [Photo.open(path) for path in photos_in(folder)]
    if sheet is None:
        refuse_tags(photos, "give that, for example `--sheet 18`, to the command or on the line of a list")
        if len(photos) < LEAST_PHOTOS:
            return folder
    try:
        made = make_capture(photos, sheet, transfer=transfer, resolution=SIDE)
    except OnePlace:  # rectified already, without views: the fit estimates them
        return folder
    write_capture(made.capture, out, capture_keys(made))
    write_quality(made, out)
    return out
