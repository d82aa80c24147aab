"""The top of a page: the material on a sphere, and a verdict."""

from ..errors import BackendError
from ..fit.result import Fit
from ..relight.stage import sphere
from .pictures import picture_uri

QUICK, FULL = 256, 512  # pixels of the sphere


def header(found: Fit, quick: bool) -> dict:
    """Picture and verdict of a fit; ``quick``: a smaller picture.

    Returns ``picture`` (a ``data:`` address; None if Mitsuba cannot run), ``good`` and ``verdict``.
    """
    try:
        picture = picture_uri(sphere(found.svbrdf, QUICK if quick else FULL))
    except BackendError:
        picture = None
    good, verdict = judged(found.record)
    return {"picture": picture, "good": good, "verdict": verdict}


def material_name(found: Fit) -> str:
    """The name of the material on all pages and in all files of a fit: that of the folder of its photos."""
    return found.capture or "material"


def judged(record: dict) -> tuple[bool, str]:
    """Whether the fit ran to its end without a warning; and a verdict: what to look at first."""
    photos = f"{len(record['per_photo'])} photo{'s' * (len(record['per_photo']) != 1)}"
    error = f"{record['rerender_rmse']:.3f} (RMSE, where 1 is white)"
    met = f"the maps, rendered again, differ from {photos} by {error}"
    if record["stopped"] == "interrupted":
        return False, f"Look at this: the fit was interrupted, and these are the best maps until then; {met}."
    if record["warnings"]:
        more = len(record["warnings"]) - 1
        rest = f" ({more} more below)" if more else ""
        return False, f"Look at this: {record['warnings'][0].rstrip('.')}{rest}. {met[0].upper()}{met[1:]}."
    return True, f"The fit gave no warning; {met}."
