"""From raw photos to a capture: poses, rectified photos, the flash, and which photos are better left out.

    photos -> rig (tags of a sheet, or features) -> rectified -> flash, vignetting, exposures -> verdicts ->
    Capture

One photo at a time is in memory; of each, what is kept is the rectified patch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import torch

from .. import color
from ..errors import CaptureError, ConfigError
from ..io.entry import entry
from ..io.profile import STEP, profiled, profiling, switch
from ..views import Views, coverage_angle
from .capture import LEAST_SIDE, Capture
from .light.samples import LONG_SIDE
from .light.shading import shading_of_material, shading_of_paper
from .light.solve import Shading
from .photo import Photo, differences, other_sizes
from .quality.next_view import HIGHLIGHT_ANGLE, NextView, next_best_view
from .quality.photo_quality import PhotoQuality, detail_of, photo_qualities
from .quality.verdicts import LEAST_DETAIL, spoils, verdicts
from .rectify import Rectified, filled, without_vignetting
from .rig import LEAST_PHOTOS, Rig, rig_to_json

Reference = Literal["best", "first"]

MOST_SIDE_RECTIFIED = 4096  # pixels
COVERAGE_SIDE = 64
# Spread of the cameras over their height below which all photos are from one place. Nine places as in
# docs/capture.md: 0.2; seven real captures that were rectified already: 0.003 to 0.009.
ONE_PLACE = 0.03
FARTHEST_FLASH = 5.0  # cm from the lens; phones have 1 to 3


class OnePlace(CaptureError):
    """Photos that show everything in the same place: rectified already, or taken from a tripod."""


@dataclass(frozen=True)
class CaptureResult:
    """A capture, and what is known about how good it is.

    Args:
        capture: the photos that are used, rectified, in their order.
        photos: all that were given.
        rig: lens and poses of those used; ``rejected`` has the reason of each other photo.
        shading: what light and lens were found to be; None: nothing, the flash is taken to be at the lens.
        qualities: how good each photo is that a pose was found of, by name.
        coverage: smallest angle (rad) between half vector and upright that a photo shows, 64 x 64, row 0 at
            the top.
        next_view: where one more photo would show most; None: nowhere much.
        warnings: what a user should know.
        seconds: by stage.
    """

    capture: Capture
    photos: tuple[Photo, ...]
    rig: Rig
    shading: Shading | None
    qualities: dict[str, PhotoQuality]
    coverage: torch.Tensor
    next_view: NextView | None
    warnings: tuple[str, ...]
    seconds: dict[str, float]

    @property
    def used(self) -> list[str]:
        """Names of the photos of the capture, in its order."""
        return list(self.rig.poses)

    @property
    def covered(self) -> float:
        """Share of the patch of which some photo shows a highlight."""
        return float((self.coverage <= HIGHLIGHT_ANGLE).double().mean())


@entry()
def make_capture(photos: Sequence[Photo], sheet_cm: float | None = None, depth_cm: float = 0.0,
                 transfer: color.Transfer | None = None, resolution: int = 1024,
                 reference: Reference = "best",
                 report: Callable[[str, float], object] = lambda text, share: None) -> CaptureResult:
    """Raw photos of a flat material, taken with one phone and its flash, to a capture.

    Args:
        photos: three or more; the order is kept.
        sheet_cm: size of the printed sheet of tags around the material; None: without, poses come from what
            photos share.
        depth_cm: how far the sheet lies above the material.
        transfer: how the photos encode light; None: ``linear`` for RAW files, else ``srgb``.
        resolution: pixels a side, at most; never more than the photos show.
        reference: the photo that says what is up, without a sheet; see
            :func:`~mitsvbrdf.capture.align.from_photos.rig_from_photos`.
        report: told what is going on and the share done.

    Raises:
        CaptureError: fewer than three photos can be used, with the reasons.
        OnePlace: without a sheet, photos that are all from one place.
        ConfigError: options out of range.
    """
    _check(photos, sheet_cm, depth_cm, resolution, reference)
    with profiling() as profile, profile.scope(STEP):
        result = _made(photos, sheet_cm, depth_cm, transfer, resolution, reference, report)
    return replace(result, seconds=profile.steps[0])


def _made(photos: Sequence[Photo], sheet_cm: float | None, depth_cm: float, transfer: color.Transfer | None,
          resolution: int, reference: Reference, report: Callable[[str, float], object]) -> CaptureResult:
    """What :func:`make_capture` returns, without the seconds."""
    warnings = differences(photos)
    if all(photo.exif.get("flash") == "off" for photo in photos):
        warnings.append("no photo was taken with the flash (says their EXIF); highlights then are those of "
                        "the room's lights")
    transfer = transfer or ("linear" if photos[0].linear else "srgb")
    left, rejected = list(photos), other_sizes(photos)[1]
    found: dict[str, PhotoQuality] = {}
    _enough(photos, rejected)
    for attempt in (0, 1):
        left = [photo for photo in left if photo.name not in rejected]
        told = _within(report, 0.5 * attempt, 0.5 * attempt + 0.5)
        rig = _rig(left, sheet_cm, depth_cm, reference, _within(told, 0, 0.6))
        rejected |= rig.rejected
        _from_places(rig)
        with profiled("rectifying"):
            rectified = Rectified.of(rig, left, resolution, _within(told, 0.6, 1))
        lit = _Lit.of(rig, rectified, sheet_cm, depth_cm, transfer)
        with profiled("quality"):
            evenness = lit.shading.evenness if lit.shading else None
            qualities = photo_qualities(lit.pictures, lit.views, transfer, lit.names, lit.overlap, evenness)
            found |= {quality.name: quality for quality in qualities}
            fired = {photo.name: str(photo.exif["flash"]) for photo in left if "flash" in photo.exif}
            bad = verdicts(qualities, lit.pictures, lit.views, fired)
        rejected |= bad
        _enough(photos, rejected)
        # tags that were seen are where they are
        if rig.source == "sheet" or not any(map(spoils, bad.values())):
            break
    if bad:
        rig = replace(rig, poses={name: pose for name, pose in rig.poses.items() if name not in bad})
        lit = _Lit.of(rig, rectified, sheet_cm, depth_cm, transfer)
    with profiled("quality"):
        without_pose = [photo for photo in photos if photo.name in rejected and photo.name not in found]
        rejected |= _blurred(without_pose, rejected, rectified)
        next_view = next_best_view(lit.views, lit.names, rig.unit)
        coverage = coverage_angle(lit.views, COVERAGE_SIDE)
    index = tuple(i for i, photo in enumerate(photos) if photo.name in lit.names)
    capture = Capture(lit.pictures, lit.views, transfer, index, rig.source, photos[0].path.parent)
    return CaptureResult(capture, tuple(photos), replace(lit.rig, rejected=rejected), lit.shading, found,
                         coverage, next_view, (*warnings, *rig.notes, *rectified.notes, *lit.notes), {})


def _check(photos: Sequence[Photo], sheet_cm: float | None, depth_cm: float, resolution: int,
           reference: str) -> None:
    if not LEAST_SIDE <= resolution <= MOST_SIDE_RECTIFIED:
        raise ConfigError(f"a resolution of {LEAST_SIDE} to {MOST_SIDE_RECTIFIED}", str(resolution),
                          "try 1024")
    if sheet_cm is not None and not (math.isfinite(sheet_cm) and sheet_cm > 0):
        raise ConfigError("the size of the sheet in cm", str(sheet_cm),
                          "measure the frame of tags from edge to edge")
    # NaN, too; below 0 where the sheet lies below the material
    if sheet_cm is not None and not abs(depth_cm) < sheet_cm:
        raise ConfigError(f"a sheet less than its size of {sheet_cm:g} cm above the material",
                          f"{depth_cm:g} cm",
                          "measure how far it is, in cm")
    if reference not in get_args(Reference):
        raise ConfigError(f"a reference of {get_args(Reference)}", repr(reference), "choose one of these")
    _enough(photos, {})
    if len({photo.linear for photo in photos}) > 1:
        raise CaptureError("photos of one kind", "RAW files among others", "give one kind alone")


def _enough(photos: Sequence[Photo], rejected: Mapping[str, str]) -> None:
    if len(photos) - len(rejected) < LEAST_PHOTOS:
        named: dict[str, list[str]] = {}
        for name, reason in rejected.items():
            named.setdefault(reason, []).append(name)
        reasons = "".join(f"; {', '.join(names)}: {reason}" for reason, names in named.items())
        sheet = ("; if no sheet lies there, leave --sheet out"
                 if any("tags seen" in reason for reason in named) else "")
        raise CaptureError(f"{LEAST_PHOTOS} photos or more that can be used",
                           f"{len(photos) - len(rejected)} of "
                           f"{len(photos)}{reasons}", "take more photos from different places, flash on"
                           + sheet)


def _from_places(rig: Rig) -> None:
    camera = np.stack([pose.position for pose in rig.poses.values()])
    if rig.source == "photos" and camera.std(axis=0).max() < ONE_PLACE * camera[:, 2].mean():
        raise OnePlace("photos from different places", f"{len(camera)} photos that show everything in the "
                                                       "same place: from a "
                       "tripod, or rectified already", "move the phone between photos; rectified ones "
                                                       "`mitsvbrdf fit` takes as "
                       "they are")


def _blurred(photos: Sequence[Photo], reasons: Mapping[str, str], rectified: Rectified) -> dict[str, str]:
    """The reasons of photos without a pose that are blurred, which is why they have none."""
    usual = float(np.median([detail_of(pixels) for pixels in rectified.small.values()]))
    sharpness = {photo.name: detail_of(photo.pixels(LONG_SIDE)) / usual for photo in photos}
    return {name: f"blurred: {sharp:.2f} times as sharp as the others ({reasons[name]})"
            for name, sharp in sharpness.items() if sharp < LEAST_DETAIL}


def _within(report: Callable[[str, float], object], low: float, high: float) -> Callable[[str, float],
                                                                                         object]:
    return lambda text, share: report(text, low + (high - low) * share)


def _rig(photos: Sequence[Photo], sheet_cm: float | None, depth_cm: float, reference: Reference,
         report: Callable[[str, float], object]) -> Rig:
    """Lens and poses; the stages are called what is reported."""
    def told(text: str, share: float) -> None:
        switch(text.partition(" of ")[0])
        report(text, share)

    with profiled("poses"):
        if sheet_cm is not None:
            from .align.from_sheet import rig_from_sheet
            return rig_from_sheet(photos, sheet_cm, depth_cm, told)
        from .align.from_photos import rig_from_photos
        return rig_from_photos(photos, reference, told)


@dataclass(frozen=True)
class _Lit:
    """The photos of a rig with its flash known: without vignetting (N x R x R x 3, filled), and their
    views.
    """

    rig: Rig
    shading: Shading | None
    pictures: torch.Tensor
    overlap: dict[str, float]
    views: Views
    notes: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        return list(self.rig.poses)

    @classmethod
    def of(cls, rig: Rig, rectified: Rectified, sheet_cm: float | None, depth_cm: float,
           transfer: color.Transfer) -> _Lit:
        # as they were given
        in_order = {name: rig.poses[name] for name in rectified.pictures if name in rig.poses}
        rig = replace(rig, poses=in_order)
        with profiled("flash"):
            shading, notes = _shading(rig, rectified, sheet_cm, depth_cm, transfer)
            if shading:
                rig = replace(rig, lens=shading.lens)
            pictures = [without_vignetting(rectified.pictures[name], rig, name, transfer)
                        for name in rig.poses]
        overlap = {name: float(np.isfinite(picture).all(axis=-1).mean()) for name, picture in zip(rig.poses,
                                                                                                  pictures)}
        return cls(rig, shading, filled(pictures), overlap, _views(rig, shading), notes)


def _shading(rig: Rig, rectified: Rectified, sheet_cm: float | None, depth_cm: float, transfer: color.Transfer
             ) -> tuple[Shading | None, tuple[str, ...]]:
    """From the paper of the sheet, else from the material, else nothing; and what was noticed."""
    notes = []
    if sheet_cm is not None:
        from .align.sheet import Sheet
        try:
            shading = shading_of_paper(rig, rectified.small, transfer, Sheet(sheet_cm).white, depth_cm)
            beside = float(np.linalg.norm(shading.lens.flash))
            far = (f"the flash seems to be {beside:.0f} cm beside the lens: is --sheet in cm, and as "
                   "measured?",)
            return shading, shading.notes + (far if beside > FARTHEST_FLASH else ())
        except CaptureError as reason:
            notes.append(f"the paper says nothing of the light ({reason.got}); the material is asked instead")
    try:
        shading = shading_of_material(rig, {name: rectified.pictures[name] for name in rig.poses}, transfer)
        return shading, (*notes, *shading.notes)
    except CaptureError as reason:
        return None, (*notes, f"the shading says nothing of the light ({reason.got}): the flash is taken to "
                              "be at the lens, "
                              "and so bright that a white texel has radiance 1")


def _views(rig: Rig, shading: Shading | None) -> Views:
    """Where cameras and flashes were, and how bright each photo shows them."""
    camera = np.stack([pose.position for pose in rig.poses.values()])
    light = np.stack([pose.flash(rig.lens) for pose in rig.poses.values()])
    if shading is None:
        return Views.of(camera, light, math.pi * float(np.median(np.square(camera).sum(axis=1))), rig.size)
    power = [[i * math.exp(shading.log_exposure.get(name, 0.0)) for i in shading.intensity]
             for name in rig.poses]
    return Views.of(camera, light, power, rig.size)


def refuse_tags(photos: Sequence[Photo], how: str = "give that, for example `mitsvbrdf capture PHOTOS -o "
                                                    "CAPTURE --sheet 18`"
                ) -> None:
    """Raise CaptureError where a sheet of tags is in the first photo: without its size the tags would pass
    for material.

    Args:
        photos: those of a capture.
        how: what to do with the size.
    """
    from .align.from_sheet import LEAST_TAGS
    from .align.sheet import Sheet
    from .align.tag_edges import find_edges

    count = len(find_edges(photos[0], Sheet()).corners) if photos else 0
    if count >= LEAST_TAGS:
        raise CaptureError("--sheet CM for photos of a sheet of tags",
                           f"{count} tags in {photos[0].name} and no size",
                           f"measure the frame of tags from outer edge to outer edge and {how}")


def capture_keys(result: CaptureResult) -> dict:
    """What ``capture.json`` says beside the views: see docs/formats.md."""
    uncertainty = None
    if result.shading:
        exposures = {name: sd for name, sd in result.shading.exposure_deviations.items()
                     if name in result.used}
        uncertainty = dict(result.shading.deviations) | {"log_exposure": exposures}
    return {"unit": result.rig.unit, "photos": result.used, "rejected": result.rig.rejected,
            "rig": rig_to_json(result.rig),
            "uncertainty": uncertainty}
