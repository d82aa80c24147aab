"""Reading a folder of photos, with or without calibration, and writing a capture back."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch
from torch import Tensor

from .. import color, files
from ..errors import CaptureError, ConfigError
from ..views import Falloff, Views
from .align import FIELD_OF_VIEW, default_views, field_of_view
from .capture import Calibration, Capture
from .photo import UNTURNED, Photo, Unreadable, differences, photos_in

PHOTO_SUFFIXES = (".png", ".jpg", ".jpeg")
LEAST_SIDE = 8  # pixels
MOST_SIDE = 2048  # pixels of a single photo that is read without calibration


def read_capture(
    folder: str | Path,
    resolution: int | None = None,
    index: Sequence[int] | None = None,
    transfer: color.Transfer | None = None,
    falloff: Falloff = "inverse-square",
    log: Callable[[str], None] | None = None,
    report: Callable[[str, float], object] = lambda text, share: None,
) -> Capture:
    """Read photos of one patch. Three kinds of folder are understood, in this order:

    - ``capture.json`` as svbrdf-diff-renderer has it: ``camera_pos`` (rows x, y, z), ``light_pow`` (a number, r g b, or
      one row a photo), ``im_size``, ``target_dir``, and where given ``light_pos`` (else the light is at the camera),
      ``idx`` (which rows and photos ``NN.png|jpg`` are used, else all) and our own ``transfer`` and ``calibration``; without
      ``camera_pos`` nothing is known of the views but that the photos are rectified;
    - ``camera_pos.txt``, ``image_size.txt``, ``light_power.txt`` and where given ``light_pos.txt`` beside the photos
      ``00.png|jpg``, ... (MaterialGAN);
    - photos alone, as a phone wrote them: three or more as :func:`~mitsvbrdf.capture.make.make_capture` sees them, upright as
      the first; fewer, the first by name alone, with the stated default geometry.

    Args:
        folder: the folder, or the JSON file itself.
        resolution: pixels a side to shrink to, by area averages of display values; never enlarged. None: as they are.
        index: numbers of the photos to use; None: all.
        transfer: how display values encode radiance; None: what the capture states, else ``gamma2.2`` for calibrated
            captures (the field's habit), ``srgb`` for plain photos, and ``linear`` for RAW files.
        falloff: see :class:`~mitsvbrdf.views.Views`.
        log: called with each note of the capture.
        report: told what is going on with plain photos, which take long, and the share done.

    Returns:
        The capture, in the unit of length of its calibration.

    Raises:
        CaptureError: photos or calibration that cannot be used, naming the file or row.
        ConfigError: options out of range.
    """
    path = Path(folder)
    if resolution is not None and resolution < LEAST_SIDE:
        raise ConfigError(f"a resolution of {LEAST_SIDE} or more", str(resolution), "choose a larger one")
    if transfer is not None and transfer not in get_args(color.Transfer):
        raise ConfigError(f"a transfer function of {get_args(color.Transfer)}", repr(transfer), "choose one of these")
    if path.is_file() and path.suffix.lower() == ".json":
        capture = _from_json(path, falloff)
    elif not path.is_dir():
        raise CaptureError("a folder of photos", f"no folder at {path}", "check the name")
    elif (path / "capture.json").is_file():
        capture = _from_json(path / "capture.json", falloff)
    elif (path / "camera_pos.txt").is_file():
        capture = _from_text(path, falloff)
    elif (path / "fit.json").is_file():
        raise CaptureError("a folder of photos", f"{path}, the result of a fit", "name the folder that was fitted")
    else:
        capture = _from_plain(path, falloff, transfer, report)
    capture = capture if index is None else capture.pick(index)
    capture = _shrunk(replace(capture, transfer=transfer or capture.transfer), resolution)
    for note in capture.notes if log else ():
        log(note)
    return capture


def write_capture(capture: Capture, folder: str | Path, keys: dict | None = None) -> None:
    """Write ``capture.json`` and ``target/NN.png``, so that :func:`read_capture` gives the same back.

    Photos are numbered anew from 0; lengths stay in the capture's unit. Files have 8 bits, of linear photos 16.

    Args:
        keys: more for the JSON, as :func:`~mitsvbrdf.capture.make.capture_keys` makes them.

    Raises:
        OutputError: the folder cannot be written to.
    """
    folder, views = Path(folder), capture.views
    for i, photo in enumerate(capture.photos):
        files.write_png(folder / "target" / f"{i:02d}.png", photo, 16 if capture.transfer == "linear" else 8)
    power = views.intensity.tolist()
    files.write_json(folder / "capture.json", {
        "target_dir": "target", "im_size": views.size, "idx": list(range(len(capture))),
        "camera_pos": views.camera.tolist(), "light_pos": views.light.tolist(),
        "light_pow": power[0] if all(row == power[0] for row in power) else power,
        "transfer": capture.transfer, "calibration": capture.calibration, **(keys or {})})


def _from_json(path: Path, falloff: Falloff) -> Capture:
    try:
        stated = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as reason:
        raise CaptureError("a valid JSON file", f"{path}: {reason}", "mend it or export it again") from None
    if not isinstance(stated, dict):
        raise CaptureError("a JSON object", f"a {type(stated).__name__} in {path}", "see the format of capture.json")
    uncalibrated = "camera_pos" not in stated
    for key in ("target_dir",) if uncalibrated else ("target_dir", "im_size", "camera_pos", "light_pow"):
        if key not in stated:
            raise CaptureError(f"the key {key!r}", f"{path} with {sorted(stated)}", "add it")
    if not isinstance(stated["target_dir"], str):
        raise CaptureError("target_dir as text", f"{stated['target_dir']!r} in {path}", "name the photos' folder")
    transfer = stated.get("transfer", "gamma2.2")
    if transfer not in get_args(color.Transfer):
        raise CaptureError(f"a transfer of {get_args(color.Transfer)}", f"{transfer!r} in {path}",
                           "choose one of these")

    photos = _numbered(path.parent / stated["target_dir"])
    index = stated.get("idx")
    if uncalibrated:
        stated = stated | _assumed(stated, path, max(photos) + 1)
    size = _number(stated["im_size"], f"im_size in {path}")
    camera = _rows(stated["camera_pos"], f"camera_pos in {path}")
    light = _rows(stated["light_pos"], f"light_pos in {path}") if "light_pos" in stated else camera
    if index is None:
        index = list(photos)
        _same_count(f"camera_pos in {path}", len(camera), len(photos))
    elif not isinstance(index, list) or not index or not all(type(i) is int and i >= 0 for i in index):
        raise CaptureError("idx as a list of photo numbers", f"{index!r} in {path}", "write for example [0, 1, 2]")
    elif len(set(index)) < len(index):
        raise CaptureError("idx with each photo once", f"{index} in {path}", "take the repeated number out")
    elif missing := [i for i in index if i not in photos]:
        raise CaptureError(f"photo {missing[0]:02d}.png or .jpg, which idx names", "no such file in "
                           f"{path.parent / stated['target_dir']}", "add the photo or take it out of idx")
    elif max(index) >= len(camera):
        raise CaptureError(f"a row of camera_pos for each of {len(index)} photos in idx (the last is {max(index)})",
                           f"{len(camera)} rows in {path}", "give one row a photo, or shorten idx")
    views = _views(camera, light, stated["light_pow"], size, falloff, str(path)).pick(index)
    return _calibrated([photos[i] for i in index], views, transfer, index, path.parent,
                       _calibration(stated, path))


def _calibration(stated: dict, path: Path) -> Calibration:
    """Where the views come from, as stated; captures of other tools do not say it, and ``calibrated`` is our older word."""
    found = stated.get("calibration", "none" if stated.get("calibrated", True) is False else "given")
    if found not in get_args(Calibration):
        raise CaptureError(f"a calibration of {get_args(Calibration)}", f"{found!r} in {path}", "choose one of these")
    return found


def _assumed(stated: dict, path: Path, rows: int) -> dict:
    """What a capture without ``camera_pos`` leaves open: the default geometry, in its unit of length."""
    beside = [key for key in ("light_pos", "light_pow") if key in stated]
    if beside:
        raise CaptureError("the key 'camera_pos' beside light_pos and light_pow", f"{' and '.join(beside)} alone in {path}",
                           "add camera_pos, or take these out to have the geometry estimated from the photos")
    size = _number(stated.get("im_size", 1.0), f"im_size in {path}")
    views = default_views(1)
    return {"im_size": size, "camera_pos": [[x * size for x in views.camera[0].tolist()]] * rows,
            "light_pow": float(views.intensity[0, 0]) * size**2, "calibration": "none"}


def _from_text(folder: Path, falloff: Falloff) -> Capture:
    photos = _numbered(folder)
    camera = _rows(_table(folder / "camera_pos.txt"), str(folder / "camera_pos.txt"))
    _same_count(str(folder / "camera_pos.txt"), len(camera), len(photos))
    light = camera
    if (folder / "light_pos.txt").is_file():
        light = _rows(_table(folder / "light_pos.txt"), str(folder / "light_pos.txt"))
    sizes = [number for row in _table(folder / "image_size.txt") for number in row]
    if len(set(sizes)) != 1:
        raise CaptureError("one side length", f"{sizes} in {folder / 'image_size.txt'}", "the patch must be square")
    power = _table(folder / "light_power.txt")
    views = _views(camera, light, power[0][0] if power == [power[0][:1]] else power, sizes[0], falloff, str(folder))
    return _calibrated(list(photos.values()), views, "gamma2.2", list(photos), folder)


def _calibrated(paths: list[Path], views: Views, transfer: color.Transfer, index: list[int], source: Path,
                calibration: Calibration = "given") -> Capture:
    photos = [_photo(path) for path in paths]
    for path, photo in zip(paths, photos):
        if photo.shape != photos[0].shape:
            raise CaptureError("photos of one size", f"{paths[0].name} of {_size(photos[0])} and {path.name} of "
                               f"{_size(photo)} in {source}", "rectify them to one size")
        if photo.shape[0] != photo.shape[1]:
            raise CaptureError("square photos, rectified to the patch", f"{path} of {_size(photo)}",
                               "rectify it, or remove the calibration to read plain photos")
    return Capture(torch.stack(photos), views, transfer, tuple(index), calibration, source)


def _from_plain(folder: Path, falloff: Falloff, transfer: color.Transfer | None,
                report: Callable[[str, float], object]) -> Capture:
    """Raw photos: what `mitsvbrdf capture` would make of them; of fewer than three that can be used, the first alone.

    Photos that show everything in the same place are taken for rectified.
    """
    from .make import LEAST_PHOTOS, OnePlace, make_capture, refuse_tags

    photos = [Photo.open(path) for path in photos_in(folder)]
    reason = f"{LEAST_PHOTOS} or more are needed to find out where they were taken from"
    refuse_tags(photos)
    if len(photos) >= LEAST_PHOTOS:
        try:
            made = make_capture(photos, transfer=transfer, reference="first", report=report)
        except OnePlace:
            return _rectified(photos, falloff, folder)
        except Unreadable:
            raise
        except CaptureError as error:
            reason = error.got
        else:
            left_out = [f"{name} is left out: {why}" for name, why in made.rig.left_out.items()]
            return replace(made.capture, views=replace(made.capture.views, falloff=falloff), source=folder,
                           notes=(*made.warnings, *left_out))
    return _single(photos, falloff, folder, reason)


def _single(photos: Sequence[Photo], falloff: Falloff, folder: Path, reason: str) -> Capture:
    """The middle square of the first photo as it is shown, in the stated default geometry."""
    alone = [f"only {photos[0].name} is used of {len(photos)} photos: {reason}"] if len(photos) > 1 else []
    shot = _unposed(photos[:1], falloff, folder, [*differences(photos), *alone])
    z, focal = float(shot.views.camera[0, 2]), photos[0].exif.get("35 mm focal length")
    geometry = (f"no calibration: camera and light are taken to be together, {z:.2f} patch sides above the centre (field of "
                f"view {_angle(photos[0]):.0f} degrees, {'from EXIF' if focal else 'assumed'}); a white texel there has "
                "radiance 1")
    return replace(shot, notes=(*shot.notes, geometry))


def _rectified(photos: Sequence[Photo], falloff: Falloff, folder: Path) -> Capture:
    """The middle squares of photos that show everything in the same place, of whose views nothing is known."""
    size = Counter(photo.size for photo in photos).most_common(1)[0][0]
    kept = [photo for photo in photos if photo.size == size]
    others = [f"{photo.name} is left out: it has another size" for photo in photos if photo.size != size]
    note = "the photos show everything in the same place, so they are taken for rectified; nothing is known of their views"
    return _unposed(kept, falloff, folder, [*differences(photos), *others, note], [photos.index(photo) for photo in kept])


def _unposed(photos: Sequence[Photo], falloff: Falloff, folder: Path, notes: Sequence[str],
             index: Sequence[int] = (0,)) -> Capture:
    """Middle squares of photos as they are shown, in the default geometry."""
    squares = torch.from_numpy(np.stack([_square(photo) for photo in photos]))
    share = min(photos[0].size) / max(photos[0].size)
    views = replace(default_views(len(photos), _angle(photos[0]), share), falloff=falloff)
    return Capture(squares, views, "linear" if photos[0].linear else "srgb", tuple(index), "none", folder, tuple(notes))


def _angle(photo: Photo) -> float:
    """Field of view in degrees across the long side."""
    focal = photo.exif.get("35 mm focal length")
    return field_of_view(focal, *photo.size) if focal else FIELD_OF_VIEW


def _square(photo: Photo) -> np.ndarray:
    """The middle square of a photo as it is shown, S x S x 3 display values, S at most :data:`MOST_SIDE`."""
    import cv2

    pixels = np.rot90(photo.pixels(), -UNTURNED.get(photo.orientation, 0))
    (height, width), side = pixels.shape[:2], min(pixels.shape[:2])
    if side < LEAST_SIDE:
        raise CaptureError(f"photos of {LEAST_SIDE} pixels or more a side", f"{photo.path} of {width} x {height}",
                           "use the original photo")
    top, left = (height - side) // 2, (width - side) // 2
    square = pixels[top : top + side, left : left + side].astype(np.float32) / np.iinfo(pixels.dtype).max
    return square if side <= MOST_SIDE else cv2.resize(square, (MOST_SIDE, MOST_SIDE), interpolation=cv2.INTER_AREA)


def _shrunk(capture: Capture, resolution: int | None) -> Capture:
    import cv2

    if resolution is None or resolution == capture.resolution:
        return capture
    if resolution > capture.resolution:
        note = f"the photos have {capture.resolution} pixels a side, so they are not enlarged to {resolution}"
        return replace(capture, notes=(*capture.notes, note))
    size = (resolution, resolution)
    photos = [cv2.resize(p.numpy(), size, interpolation=cv2.INTER_AREA) for p in capture.photos]
    return replace(capture, photos=torch.from_numpy(np.stack(photos)))


def _photo(path: Path) -> Tensor:
    """A photo as H x W x 3 display values, EXIF orientation applied."""
    import cv2

    try:
        photo = files.read_image(path, CaptureError)
    except (OSError, cv2.error) as reason:
        raise CaptureError("a readable photo", f"{path}: {reason}", "check the file") from None
    short = min(photo.shape[:2])
    if short < LEAST_SIDE:
        raise CaptureError(f"photos of {LEAST_SIDE} pixels or more a side", f"{path} of {_size(photo)}",
                           "use the original photo")
    return photo


def _photos_in(folder: Path) -> list[Path]:
    """Image files in a folder, hidden ones aside."""
    if not folder.is_dir():
        raise CaptureError("a folder of photos", f"no folder at {folder}", "check target_dir")
    return [p for p in folder.iterdir() if p.suffix.lower() in PHOTO_SUFFIXES and p.name[0] != "." and p.is_file()]


def _numbered(folder: Path) -> dict[int, Path]:
    """The photos NN.png or NN.jpg of a folder by their number, in order."""
    paths: dict[int, Path] = {}
    for path in sorted(p for p in _photos_in(folder) if p.stem.isdecimal()):
        if int(path.stem) in paths:
            raise CaptureError("one photo of each number", f"{paths[int(path.stem)].name} and {path.name} in {folder}",
                               "remove one of them")
        paths[int(path.stem)] = path
    if not paths:
        raise CaptureError("photos 00.png or 00.jpg, ...", f"none in {folder}", "add them or check target_dir")
    return dict(sorted(paths.items()))


def _views(camera: list, light: list, power: Any, size: float, falloff: Falloff, where: str) -> Views:
    """Views with the counts checked and the file named in each error."""
    power = _power(power, len(camera), f"light_pow in {where}")
    if len(light) != len(camera):
        raise CaptureError(f"light_pos of {len(camera)} rows, as camera_pos", f"{len(light)} rows in {where}",
                           "give one row a photo")
    try:
        return Views.of(camera, light, power, size, falloff)
    except CaptureError as error:
        raise CaptureError(error.expected, f"{error.got} in {where}", error.fix) from None


def _power(value: Any, count: int, where: str) -> float | list:
    """A light's intensity as a number, three numbers, or ``count`` rows of three."""
    if not isinstance(value, list):
        return _number(value, where)
    if not value or not isinstance(value[0], list):
        return _row(value, where)
    rows = _rows(value, where)
    if len(rows) not in (1, count):
        raise CaptureError(f"1 or {count} rows of {where}", f"{len(rows)} rows", "give one row a photo")
    return rows


def _same_count(what: str, rows: int, photos: int) -> None:
    if rows != photos:
        raise CaptureError(f"a row of {what} for each of {photos} photos", f"{rows} rows", "give one row a photo")


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) > 1e300:
        raise CaptureError("a finite number", f"{value!r} as {where}", "check the calibration")
    return float(value)


def _row(value: Any, where: str) -> list[float]:
    if not isinstance(value, list) or len(value) != 3:
        raise CaptureError("three numbers", f"{value!r} in {where}", "check the calibration")
    return [_number(x, where) for x in value]


def _rows(value: Any, where: str) -> list[list[float]]:
    if not isinstance(value, list) or not value:
        raise CaptureError("rows of three numbers", f"{value!r} as {where}", "give one row a photo")
    return [_row(row, where) for row in value]


def _table(path: Path) -> list[list[float]]:
    """The numbers of a text file, row by row, separated by commas or blanks."""
    if not path.is_file():
        raise CaptureError(path.name, f"no such file in {path.parent}", "add it, or remove camera_pos.txt")
    try:
        lines = path.read_text(encoding="utf-8").replace(",", " ").splitlines()
        rows = [[float(x) for x in line.split()] for line in lines if line.strip()]
    except (OSError, ValueError) as reason:
        raise CaptureError("rows of numbers", f"{path}: {reason}", "check the calibration") from None
    if not rows:
        raise CaptureError("rows of numbers", f"{path}, which is empty", "check the calibration")
    return rows


def _size(photo: Tensor) -> str:
    return f"{photo.shape[1]} x {photo.shape[0]}"
