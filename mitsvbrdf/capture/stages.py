"""From raw photos to a capture, in stages: photos of one camera, poses, rectified photos, light, verdicts.

Stages are functions without side effects. Those that reject photos return the reasons. One whole photo at a
time is in memory. The rectified patch and a small copy of each photo are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import torch

from .. import color
from ..errors import ConfigError, noted
from ..io import Report
from ..io.entry import entry
from ..views import coverage_angle
from .align.from_photos import rig_from_photos
from .align.from_sheet import rig_from_sheet
from .align.sheet import Sheet
from .capture import LEAST_SIDE, Capture, converted, notes_of, used_transfer
from .light.lit import Lit
from .light.solve import Shading
from .photo import Photo, of_one_camera
from .quality.next_view import HIGHLIGHT_ANGLE, NextView, next_best_view
from .quality.photo_quality import PhotoQuality, photo_qualities
from .quality.verdicts import blurred, judge
from .rectify import Rectified
from .rig import Rig, check_enough, rig_to_json

Reference = Literal["best", "first"]

MOST_SIDE = 4096  # pixels, of a rectified photo
COVERAGE_SIDE = 64


@dataclass(frozen=True)
class CaptureResult:
    """A capture, and numbers of its quality."""

    capture: Capture  # the photos that are used, rectified, in their order
    photos: tuple[Photo, ...]  # all that were given
    rig: Rig  # lens, and poses of the photos used; rejected: photo name to reason, of the others
    # flash, vignetting and exposures; None: unknown, and the flash is assumed to be at the lens
    shading: Shading | None
    qualities: dict[str, PhotoQuality]  # photo name to quality, of photos with a pose
    next_view: NextView | None  # best place for one more photo; None: no place adds much, or no view is known
    warnings: tuple[str, ...]  # what a user should know

    @property
    def used(self) -> list[str]:
        """Names of the photos of the capture, in its order."""
        return list(self.rig.poses)

    @cached_property
    def coverage(self) -> torch.Tensor:
        """Smallest angle (rad) between half vector and flat normal over all photos, 64 x 64, row 0 on top."""
        return coverage_angle(self.capture.views, COVERAGE_SIDE)

    @property
    def covered(self) -> float:
        """Share of the patch where some photo shows a highlight."""
        return float((self.coverage <= HIGHLIGHT_ANGLE).double().mean())


@entry()
def make_capture(photos: Sequence[Photo], sheet_cm: float | None = None, depth_cm: float = 0.0,
                 transfer: color.Transfer | None = None, resolution: int = 1024,
                 reference: Reference = "best", report: Report = lambda text, share: None) -> CaptureResult:
    """A capture from raw photos of a flat material, taken with one phone and its flash.

    Args:
        photos: three or more; the order is kept.
        sheet_cm: size of the printed sheet of tags around the material; None: there is no sheet, and poses
            are found from features that the photos share.
        depth_cm: how far the sheet is above the material.
        transfer: how the photos encode light; None: ``linear`` for RAW files, else ``srgb``.
        resolution: pixels a side, at most; never more than the photos show.
        reference: without a sheet, the photo that defines which side is up; see
            :func:`~mitsvbrdf.capture.align.from_photos.rig_from_photos`.

    Raises:
        CaptureError: fewer than three photos can be used; the message has the reasons.
        OnePlace: most photos (with a sheet: all) are from one place, and not rectified to a sheet.
        ConfigError: options out of range.
    """
    if not LEAST_SIDE <= resolution <= MOST_SIDE:
        raise ConfigError(f"a resolution of {LEAST_SIDE} to {MOST_SIDE}", str(resolution), "try 1024")
    # NaN is invalid, too; depth is below 0 if the sheet is below the material
    if sheet_cm is not None and not abs(depth_cm) < Sheet(sheet_cm).size:
        raise ConfigError(f"a sheet less than its size of {sheet_cm:g} cm above the material",
                          f"{depth_cm:g} cm", "measure how far it is, in cm")
    if reference not in get_args(Reference):
        raise ConfigError(f"a reference of {get_args(Reference)}", repr(reference), "choose one of these")
    with noted() as faults:
        made = _in_stages(photos, sheet_cm, depth_cm, transfer, resolution, reference, report)
    return replace(made, warnings=tuple(dict.fromkeys((*faults, *made.warnings))))


def _in_stages(photos: Sequence[Photo], sheet_cm: float | None, depth_cm: float,
               transfer: color.Transfer | None, resolution: int, reference: Reference, report: Report
               ) -> CaptureResult:
    kept, rejected, notes = of_one_camera(photos)
    check_enough(kept, rejected)
    paper = None if sheet_cm is None else Sheet(sheet_cm).white
    transfer = stated = transfer or ("linear" if kept[0].linear else "srgb")
    fired = {photo.name: str(photo.exif["flash"]) for photo in photos if "flash" in photo.exif}
    qualities: dict[str, PhotoQuality] = {}
    for start in (0, 0.5):
        told = _within(report, start, 0.3)
        rig = (rig_from_photos(kept, reference, told) if sheet_cm is None
               else rig_from_sheet(kept, sheet_cm, depth_cm, told))
        rectified = Rectified.of(rig, kept, resolution, _within(report, start + 0.3, 0.2))
        profiles = {photo.profile.name: photo for photo in kept
                    if photo.name in rectified.outside and photo.profile and not photo.profile.reason}
        transfer, overruled = used_transfer(stated, profiles)
        lit = Lit.of(rig, rectified, transfer, paper, depth_cm)
        even, exposed = (lit.shading.evenness, lit.shading.log_exposure) if lit.shading else (None, None)
        found = photo_qualities(lit.pictures, lit.views, transfer, rectified.overlap, even, lit.measured,
                                exposed)
        bad, misled = judge(found, lit.pictures, lit.views, fired)
        qualities |= {photo.name: photo for photo in found}
        rejected |= rig.rejected | bad
        kept = [photo for photo in kept if photo.name not in rejected]
        check_enough(kept, rejected)
        # A bad photo does not spoil poses from tags. Its features may have spoiled the poses of all photos:
        # repeat without it.
        if sheet_cm is not None or not misled:
            break
    if bad:
        rig = replace(rig, poses={photo.name: rig.poses[photo.name] for photo in kept})
        lit = Lit.of(rig, rectified, transfer, paper, depth_cm)
    without_pose = [photo for photo in photos if photo.name in rejected.keys() - qualities.keys()]
    rejected |= blurred(without_pose, rejected, rectified.small.values())
    index = tuple(i for i, photo in enumerate(photos) if photo.name in lit.rig.poses)
    colours = converted({photo.name: photo.profile for photo in kept}, rectified.outside)
    notes += [*overruled, *notes_of(colours), *rig.notes, *rectified.notes, *lit.notes]
    capture = Capture(lit.pictures, lit.views, transfer, index, rig.source, photos[0].path.parent,
                      colours=colours, measured=lit.measured)
    return CaptureResult(capture, tuple(photos), replace(lit.rig, rejected=rejected), lit.shading, qualities,
                         next_best_view(lit.views, list(lit.rig.poses), rig.unit) if capture.calibrated
                         else None, tuple(notes))


def _within(report: Report, start: float, length: float) -> Report:
    """``report`` for a part of the work; ``start`` and ``length`` are shares of the whole."""
    return lambda text, share: report(text, start + length * share)


def capture_keys(result: CaptureResult) -> dict:
    """The keys of ``capture.json`` other than the views: see docs/formats.md."""
    uncertainty = None
    if result.shading:
        exposures = {name: sd for name, sd in result.shading.exposure_deviations.items()
                     if name in result.used}
        uncertainty = dict(result.shading.deviations) | {"log_exposure": exposures}
    return {"unit": result.rig.unit, "photos": result.used, "rejected": result.rig.rejected,
            "rig": rig_to_json(result.rig) if result.capture.calibrated else None, "uncertainty": uncertainty}
