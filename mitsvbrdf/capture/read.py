"""Reading a folder of photos, with or without calibration, and writing a capture back."""

import contextlib
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch

from .. import color
from ..errors import CaptureError, ConfigError, noted
from ..io import Report, files
from ..io.decode import Picture, upright
from ..io.entry import entry
from ..io.images import averaged, hide, write_png
from ..io.json import load
from ..material.naming import SUFFIXES as MAPS
from ..material.naming import kind_of
from ..views import FIELD_OF_VIEW, Falloff, default_views
from .calibrated import from_json, from_text, stated_in
from .capture import LEAST_SIDE, Capture, check_held, converted, notes_of, used_transfer
from .lens import field_of_view
from .photo import SUFFIXES, Photo, Unreadable, differences, files_of, photos_in, with_one_balance
from .rectify import filled
from .sharpness import CLEARLY, MOST_PHOTOS, carried, middle
from .turned import laid_alike

OF_MATERIALS = "give photos; `synth` makes some of a material, `evaluate --reference` compares a fit with it"
MOST_SQUARE = 2048  # most pixels a side of a photo without calibration, if no resolution is asked for


@entry()
def read_capture(folder: str | Path, resolution: int | None = None, index: Sequence[int] | None = None,
                 transfer: color.Transfer | None = None, falloff: Falloff = "inverse-square",
                 report: Report = lambda text, share: None) -> Capture:
    """Read photos of one patch.

    Three kinds of folder are understood, in this order:

    - ``capture.json`` of svbrdf-diff-renderer (docs/formats.md lists its keys). Without ``camera_pos``, the
      photos are rectified, but their views are unknown. Without ``capture.json``, another JSON file with
      ``camera_pos`` and ``target_dir`` is read, such as ``optim_latent_256.json``;
    - MaterialGAN's ``camera_pos.txt`` and other text files beside the photos ``00.png|jpg``, ...;
    - photos alone, as a phone wrote them. :func:`~mitsvbrdf.capture.stages.make_capture` makes the capture
      of three or more; the first photo defines which side is up. If that fails, or of fewer photos, only the
      first by name is used, with the default geometry; a note states this.

    Args:
        folder: the folder, the JSON file itself, or a lone photo.
        resolution: pixels a side to shrink to, by area averages of display values; never enlarged. None:
            calibrated photos as they are, plain ones at most 1024, or 2048 if their views are not found.
        index: numbers of the photos to use; None: all.
        transfer: how display values encode radiance; None: as the capture states, else ``gamma2.2`` if it
            is calibrated and has no colour profile, ``linear`` for RAW files, and ``srgb`` for others.
        falloff: see :class:`~mitsvbrdf.views.Views`.
        report: called with the current step and the share done, but only for plain photos, which take long.

    Returns:
        The capture, in the unit of length of its calibration.

    Each photo is decoded and shrunk before the next one. Limits: 250 megapixels a photo; all photos together,
    shrunk, 500. Photos that are turned or mirrored relative to the others are turned back (:mod:`.turned`).
    Completely masked photos are omitted; if ``index`` lists one, that is an error. Notes name both.

    Raises:
        CaptureError: photos or a calibration that cannot be used; the message names the file or row.
        ConfigError: options out of range.

    Warns:
        InputWarning: a photo's decoder warned; inside :func:`~mitsvbrdf.errors.strict`, this is an error.
    """
    path = Path(folder)
    if resolution is not None and resolution < LEAST_SIDE:
        raise ConfigError(f"a resolution of {LEAST_SIDE} or more", str(resolution), "choose a larger one")
    if transfer is not None:
        color.parts(transfer)
    with noted() as faults:
        capture = _read(path, resolution, falloff, transfer, report)
    capture = laid_alike(capture)
    capture = capture if index is None else capture.pick(index)
    transfer, told = used_transfer(transfer or capture.transfer, capture.colours)
    notes = tuple(dict.fromkeys((*capture.notes, *faults, *told)))
    capture = _shrunk(capture.but(transfer=transfer, notes=notes), resolution)
    hidden = [] if capture.measured is None else [
        number for number, mask in zip(capture.index, capture.measured) if not mask.any()]
    if not hidden:
        return capture
    those = f"photo {', '.join(f'{number:02d}' for number in hidden)} of {path}, masked whole"
    if index is not None or len(hidden) == len(capture):
        raise CaptureError("photos with something to see", those,
                           "leave it out (--views), mend its alpha, or keep more pixels (--resolution)")
    notes = (*capture.notes, f"not used: {those}")
    return capture.but(notes=notes).pick([number for number in capture.index if number not in hidden])


def _read(path: Path, resolution: int | None, falloff: Falloff, transfer: color.Transfer | None,
          report: Report) -> Capture:
    if path.is_file() and path.suffix.lower() == ".json":
        return from_json(path, falloff, resolution)
    if path.is_file() and path.suffix.lower() in SUFFIXES:
        return _from_plain(path, falloff, resolution, transfer, report)
    if path.is_file():
        raise CaptureError("a photo or a folder of photos", f"the file {path}", OF_MATERIALS)
    if not path.is_dir():
        raise CaptureError("a photo or a folder of photos", f"no folder at {path}", "check the name")
    if (path / "capture.json").is_file():
        return from_json(path / "capture.json", falloff, resolution)
    if (path / "camera_pos.txt").is_file():
        return from_text(path, falloff, resolution)
    if (path / "fit.json").is_file():
        raise CaptureError("a folder of photos", f"{path}, the result of a fit",
                           "name the folder that was fitted")
    if stated := stated_in(path):
        capture = from_json(stated, falloff, resolution)
        return capture.but(notes=(f"the calibration is that of {stated.name}", *capture.notes))
    if {"normal", "roughness"} <= {kind.partition(" ")[0] for p in files_of(path, MAPS)
                                     for kind in kind_of(p.stem)}:
        raise CaptureError("a folder of photos", f"the maps of a material in {path}", OF_MATERIALS)
    capture = _from_plain(path, falloff, resolution, transfer, report)
    if above := _stated_above(path):
        note = f"../{above.name} states views of these photos, which are read without them: name it instead"
        capture = capture.but(notes=(*capture.notes, note))
    return capture


@entry()
def write_capture(capture: Capture, folder: str | Path, keys: dict | None = None) -> None:
    """Write ``capture.json`` and ``target/NN.png``, for :func:`read_capture`. The falloff is not written.

    Photos are renumbered from 0; lengths stay in the capture's unit. Files have 8 bits, linear ones 16.

    Args:
        keys: further keys of the JSON, as :func:`~mitsvbrdf.capture.stages.capture_keys` makes them.

    Raises:
        OutputError: the folder cannot be written to.
    """
    folder, views = Path(folder), capture.views
    bits = 16 if color.parts(capture.transfer)[0] == "linear" else 8
    for i in range(len(capture)):
        photo = capture.photo(i)
        if capture.measured is not None:
            photo = torch.cat((photo, capture.measured[i, ..., None]), dim=-1)
        write_png(folder / "target" / f"{i:02d}.png", photo, bits)
    power = views.intensity.tolist()
    stated = {"camera_pos": views.camera.tolist(), "light_pos": views.light.tolist(),
              "light_pow": power[0] if all(row == power[0] for row in power) else power}
    here, usual = views.in_patch_sides().to(torch.float64), default_views(len(capture))
    if not capture.calibrated and all(torch.allclose(getattr(here, part), getattr(usual, part))
                                      for part in ("camera", "light", "intensity")):
        stated = {}  # the default geometry: read_capture assumes it if these keys are missing
    files.write_json(folder / "capture.json",
                     {"target_dir": "target", "im_size": views.size, "idx": list(range(len(capture))),
                      **stated, "transfer": capture.transfer, "calibration": capture.calibration,
                      "colours": {name: asdict(found) for name, found in capture.colours.items()},
                      **(keys or {})})


def _stated_above(folder: Path) -> Path | None:
    """The calibration file in the folder above, if it has the views of these photos; else None."""
    here = Path(os.path.realpath(folder))
    with contextlib.suppress(CaptureError, OSError, ValueError, KeyError, TypeError):
        ours = here.parent / "capture.json"
        above = ours if ours.is_file() else stated_in(here.parent)
        if above and "camera_pos" in (stated := load(above)):
            return above if os.path.realpath(above.parent / stated["target_dir"]) == str(here) else None
    return None


def _from_plain(folder: Path, falloff: Falloff, resolution: int | None, transfer: color.Transfer | None,
                report: Report) -> Capture:
    """The capture that `mitsvbrdf capture` makes of raw photos; if it fails, that of the first photo alone.

    Photos that show everything in the same place are assumed to be rectified.
    """
    from .align.from_sheet import refuse_tags
    from .rig import LEAST_PHOTOS, OnePlace
    from .stages import MOST_SIDE, make_capture

    photos = [Photo.open(path) for path in ([folder] if folder.is_file() else photos_in(folder))]
    reason = f"{LEAST_PHOTOS} or more are needed to find out where they were taken from"
    refuse_tags(photos)
    if len(photos) >= LEAST_PHOTOS:
        try:
            made = make_capture(photos, transfer=transfer, reference="first", report=report,
                                resolution=min(max(resolution or 0, 1024), MOST_SIDE))
        except OnePlace:
            return _rectified(photos, falloff, folder, resolution)
        except Unreadable:
            raise
        except CaptureError as error:
            reason = error.got
        else:
            rejected = [f"{name} is rejected: {why}" for name, why in made.rig.rejected.items()]
            return made.capture.but(views=replace(made.capture.views, falloff=falloff), source=folder,
                           notes=(*made.warnings, *rejected))
    return _single(photos, falloff, folder, resolution, reason)


def _single(photos: Sequence[Photo], falloff: Falloff, folder: Path, resolution: int | None,
            reason: str) -> Capture:
    """The middle square of the first photo as displayed, in the default geometry; a note states this."""
    alone = [f"only {photos[0].name} is used of {len(photos)} photos: {reason}"] if len(photos) > 1 else []
    shot = _unposed(photos[:1], falloff, folder, resolution, [*differences(photos), *alone])
    z, focal = float(shot.views.camera[0, 2]), photos[0].exif.get("35 mm focal length")
    geometry = (f"no calibration: camera and light are taken to be together, {z:.2f} patch sides above the "
                f"centre (field of view {_angle(photos[0]):.0f} degrees, "
                f"{'from EXIF' if focal else 'assumed'}); a white texel there has radiance 1")
    return shot.but(notes=(*shot.notes, geometry))


def _rectified(photos: Sequence[Photo], falloff: Falloff, folder: Path, resolution: int | None) -> Capture:
    """The middle squares of photos from one place; their views are unknown."""
    size = Counter(photo.size for photo in photos).most_common(1)[0][0]
    kept = [photo for photo in photos if photo.size == size]
    others = [f"{photo.name} is rejected: it has another size" for photo in photos if photo.size != size]
    note = ("the photos show everything in the same place, so they are taken for rectified; nothing is known "
            "of their views")
    notes = [*differences(photos), *others, note]
    looked_at = resolution and max(resolution, MOST_SQUARE)  # read_capture shrinks them later
    return _unposed(kept, falloff, folder, looked_at, notes, [photos.index(photo) for photo in kept])


def _unposed(photos: Sequence[Photo], falloff: Falloff, folder: Path, resolution: int | None,
             notes: Sequence[str], index: Sequence[int] = (0,)) -> Capture:
    """The middle squares of photos as displayed, in the default geometry."""
    check_held(len(photos), min(*photos[0].size, resolution or MOST_SQUARE), folder)
    photos, told = with_one_balance(photos)
    squares, outside = [], {}
    for photo in photos:
        found = photo.read()
        squares.append(_square(photo, found, resolution))
        outside[photo.name] = found.outside
    colours = converted({photo.name: photo.profile for photo in photos}, outside)
    share = min(photos[0].size) / max(photos[0].size)
    views = replace(default_views(len(photos), _angle(photos[0]), share), falloff=falloff)
    pictures, measured = filled(squares)
    return Capture(pictures, views, "linear" if photos[0].linear else "srgb", tuple(index), "none", folder,
                   (*notes, *told, *notes_of(colours)), colours, measured)


def _angle(photo: Photo) -> float:
    """Field of view in degrees across the long side."""
    focal = photo.exif.get("35 mm focal length")
    return field_of_view(focal, *photo.size) if focal else FIELD_OF_VIEW


def _square(photo: Photo, found: Picture, resolution: int | None) -> np.ndarray:
    """The middle square of a photo as displayed, shrunk, S x S x 3 display values; NaN: masked by alpha."""
    pixels = upright(found.pixels, photo.orientation)
    (height, width), side = pixels.shape[:2], min(pixels.shape[:2])
    if side < LEAST_SIDE:
        raise CaptureError(f"photos of {LEAST_SIDE} pixels or more a side",
                           f"{photo.path} of {width} x {height}", "use the original photo")
    top, left = (height - side) // 2, (width - side) // 2
    middle = np.s_[top : top + side, left : left + side]
    square = averaged(pixels[middle], min(side, max(MOST_SQUARE, resolution or 0)))
    square = averaged(square, min(len(square), resolution or MOST_SQUARE))
    if found.opaque is not None:
        hide(square, upright(found.opaque, photo.orientation)[middle])
    return square


def _shrunk(capture: Capture, resolution: int | None) -> Capture:
    if resolution is None or resolution == capture.resolution:
        return capture
    if resolution > capture.resolution:
        note = f"the photos give {capture.resolution} pixels a side, so they are not enlarged to {resolution}"
        return capture.but(notes=(*capture.notes, note))
    carries = None
    if capture.resolution >= CLEARLY * resolution:
        middles = [middle(photo.numpy()) for photo in capture.stored[:MOST_PHOTOS]]
        carries = carried(middles, capture.resolution, resolution)
    return capture.averaged(resolution).but(carries=carries)
