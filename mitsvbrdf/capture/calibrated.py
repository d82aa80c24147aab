"""Captures whose files state a calibration.

:func:`from_json` reads ``capture.json`` (the format of svbrdf-diff-renderer, and keys of our own),
:func:`from_text` the text files of MaterialGAN. Both check what they read, photo by photo and number by
number, before a :class:`Capture` is made.
"""

import contextlib
import json
import reprlib
from pathlib import Path
from typing import Annotated, Any, get_args

import msgspec
import numpy as np
import torch
from msgspec import Meta

from .. import color
from ..errors import CaptureError, ConfigError, warn_of
from ..io.decode import header, picture, upright
from ..io.images import averaged, display, hide
from ..io.json import error_text, load
from ..views import Falloff, Views, default_views
from .capture import (
    LEAST_SIDE,
    Calibration,
    Capture,
    Converted,
    check_held,
    converted,
    notes_of,
    single_pixels,
)
from .photo import HEIC, PLAIN, files_of, listed
from .rectify import filled
from .sharpness import CLEARLY, MOST_PHOTOS, carried, middle
from .turned import SIDE, laid_alike

NUMBER = Annotated[float, Meta(ge=-1e300, le=1e300)]  # NaN is invalid, too
ROW = Annotated[list[NUMBER], Meta(min_length=3, max_length=3)]
ROWS = Annotated[list[ROW], Meta(min_length=1)]
COLOURS = dict[str, Converted]
KINDS = {NUMBER: "a finite number", ROW: "three numbers", ROWS: "rows of three numbers",
         COLOURS: "`photos` and `outside` by name of a colour profile"}
STATED = "target_dir", "camera_pos", "light_pos", "light_pow", "im_size", "idx"


def stated_in(folder: Path) -> Path | None:
    """The JSON file with the views of a folder's photos, or None. CaptureError: several files differ."""
    found: dict[Path, list] = {}
    for path in sorted(folder.glob("*.json")):
        with contextlib.suppress(OSError, ValueError, TypeError):  # a file without these keys, or no JSON
            stated = load(path)
            if "camera_pos" in stated and any((folder / stated.get("target_dir")).glob("[0-9]*.*")):
                found[path] = [stated.get(key) for key in STATED]
    if any(numbers != next(iter(found.values())) for numbers in found.values()):
        names = ", ".join(path.name for path in found)
        raise CaptureError("one calibration", f"{names} in {folder}, which differ",
                           "name the file to read, instead of the folder")
    return next(iter(found), None)


def from_json(path: Path, falloff: Falloff, resolution: int | None) -> Capture:
    """Read a ``capture.json``. Without ``camera_pos``: default views. CaptureError: invalid content."""
    try:
        stated = load(path)
    except (OSError, ValueError) as reason:
        raise CaptureError("a valid JSON file", f"{path}: {error_text(reason)}",
                           "mend it or export it again") from None
    uncalibrated = "camera_pos" not in stated
    for key in ("target_dir",) if uncalibrated else ("target_dir", "im_size", "camera_pos", "light_pow"):
        if key not in stated:
            raise CaptureError(f"the key {key!r}", f"{path} with {sorted(stated)}", "add it")
    if not isinstance(stated["target_dir"], str):
        raise CaptureError("target_dir as text", f"{stated['target_dir']!r} in {path}", "name a folder")
    photos = _numbered(path.parent / stated["target_dir"])
    index = stated.get("idx")
    if uncalibrated:
        stated = stated | _assumed(stated, path, len(photos))
    stated = {"transfer": None, "calibration": "given"} | stated  # other tools do not state these
    if stated["calibration"] not in (known := get_args(Calibration)):
        raise CaptureError(f"a calibration of {known}", f"{stated['calibration']!r} in {path}",
                           "choose one of these")
    try:
        color.parts("srgb" if stated["transfer"] is None else stated["transfer"])
    except ConfigError as error:
        raise CaptureError(error.expected, f"{error.got} in {path}", error.fix) from None
    size = _stated(stated["im_size"], NUMBER, f"im_size in {path}")
    camera = _stated(stated["camera_pos"], ROWS, f"camera_pos in {path}")
    light = _stated(stated["light_pos"], ROWS, f"light_pos in {path}") if "light_pos" in stated else camera
    if index is None:
        _same_count(f"camera_pos in {path}", len(camera), len(photos))
    elif not isinstance(index, list) or not index or not all(type(i) is int and i >= 0 for i in index):
        raise CaptureError("idx as a list of photo numbers", f"{index!r} in {path}",
                           "write for example [0, 1, 2]")
    elif len(set(index)) < len(index):
        raise CaptureError("idx with each photo once", f"{index} in {path}", "take the repeated number out")
    elif missing := [i for i in index if i not in photos]:
        raise CaptureError(f"photo {missing[0]:02d}.png or .jpg, which idx names", "no such file in "
                           f"{path.parent / stated['target_dir']}", "add the photo or take it out of idx")
    elif max(index) >= len(camera) and not uncalibrated:
        raise CaptureError(f"{max(index) + 1} rows of camera_pos, as idx names photo {max(index)}",
                           f"{len(camera)} rows in {path}", "give one row a photo, or shorten idx")
    # without idx, there is one row per photo, in order; without camera_pos, all rows are equal
    rows = range(len(index or photos)) if index is None or uncalibrated else index
    views = _views(camera, light, stated["light_pow"], size, falloff, str(path)).pick(rows)
    index = list(photos) if index is None else index
    return _calibrated([photos[i] for i in index], views, stated["transfer"], index, path.parent,
                       resolution, stated["calibration"],
                       _stated(stated.get("colours", {}), COLOURS, f"colours in {path}"))


def _assumed(stated: dict, path: Path, rows: int) -> dict:
    """Keys for a capture without ``camera_pos``: the default geometry, in the capture's unit of length."""
    beside = [key for key in ("light_pos", "light_pow") if key in stated]
    if beside:
        raise CaptureError("the key 'camera_pos' beside light_pos and light_pow",
                           f"{' and '.join(beside)} alone in {path}",
                           "add camera_pos, or take these out to have the geometry estimated from the photos")
    size = _stated(stated.get("im_size", 1.0), NUMBER, f"im_size in {path}")
    views = default_views(1)
    return {"im_size": size, "camera_pos": [[x * size for x in views.camera[0].tolist()]] * rows,
            "light_pow": float(views.intensity[0, 0]) * size**2, "calibration": "none"}


def from_text(folder: Path, falloff: Falloff, resolution: int | None) -> Capture:
    """Read a folder with photos and MaterialGAN's text files. CaptureError: invalid content."""
    photos = _numbered(folder)
    camera = _stated(_table(folder / "camera_pos.txt"), ROWS, str(folder / "camera_pos.txt"))
    _same_count(str(folder / "camera_pos.txt"), len(camera), len(photos))
    light = camera
    if (folder / "light_pos.txt").is_file():
        light = _stated(_table(folder / "light_pos.txt"), ROWS, str(folder / "light_pos.txt"))
    sizes = [number for row in _table(folder / "image_size.txt") for number in row]
    if len(set(sizes)) != 1:
        raise CaptureError("one side length", f"{sizes} in {folder / 'image_size.txt'}",
                           "the patch must be square")
    power = _table(folder / "light_power.txt")
    views = _views(camera, light, power[0][0] if power == [power[0][:1]] else power, sizes[0], falloff,
                   str(folder))
    return _calibrated(list(photos.values()), views, None, list(photos), folder, resolution)


def _calibrated(paths: list[Path], views: Views, transfer: color.Transfer | None, index: list[int],
                source: Path, resolution: int | None, calibration: Calibration = "given",
                told: dict[str, Converted] | None = None) -> Capture:
    """The capture of these photos. Each is decoded, and shrunk or kept as stored, before the next one.

    ``transfer``: None if the calibration states none. ``told``: the conversions to sRGB that it states.
    """
    headers = [header(path, CaptureError) for path in paths]
    side = _common_side(paths, [each.size for each in headers], source)
    kept = min(side, resolution or side)
    check_held(len(paths), kept, source)
    photos, outside = np.empty(0), {}
    middles, single, larger = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for row, (path, about) in enumerate(zip(paths, headers)):
        found = picture(path, CaptureError)
        pixels = upright(found.pixels, about.orientation)
        if side >= CLEARLY * kept and row < MOST_PHOTOS:
            middles.append(middle(pixels))
        if kept < side:
            single.append(display(single_pixels(pixels, kept)))
        if kept < SIDE <= side:
            larger.append(averaged(pixels, SIDE))
        if kept < side or found.opaque is not None:
            pixels = averaged(pixels, kept)
        if not row:
            photos = np.empty((len(paths), kept, kept, 3), pixels.dtype)
        elif pixels.dtype != photos.dtype:
            photos, pixels = display(photos), display(pixels)
        photos[row] = pixels
        if found.opaque is not None:
            hide(photos[row], upright(found.opaque, about.orientation))
        outside[path.name] = found.outside
    whole = bool(np.isfinite(photos).all())
    pictures, measured = (torch.from_numpy(photos), None) if whole else filled(list(photos))
    colours = {**(told or {}),
               **converted({path.name: about.profile for path, about in zip(paths, headers)}, outside)}
    capture = Capture(pictures, views, transfer or ("srgb" if colours else "gamma2.2"), tuple(index),
                      calibration, source, tuple(notes_of(colours)), colours, measured,
                      carried(middles, side, kept) if middles else None,
                      torch.from_numpy(np.stack(single)) if single else None)
    return laid_alike(capture, Capture(torch.from_numpy(np.stack(larger)), views)) if larger else capture


def _common_side(paths: list[Path], sizes: list[tuple[int, int]], source: Path) -> int:
    """Pixels a side of the photos. CaptureError: photos too small, not square, or of different sizes."""
    for path, (width, height) in zip(paths, sizes):
        if min(width, height) < LEAST_SIDE:
            raise CaptureError(f"photos of {LEAST_SIDE} pixels or more a side",
                               f"{path} of {width} x {height}", "use the original photo")
        if (width, height) != sizes[0]:
            raise CaptureError("photos of one size",
                               f"{paths[0].name} of {sizes[0][0]} x {sizes[0][1]} and {path.name} of "
                               f"{width} x {height} in {source}", "rectify them to one size")
        if width != height:
            raise CaptureError("square photos, rectified to the patch", f"{path} of {width} x {height}",
                               "rectify it, or remove the calibration to read plain photos")
    return sizes[0][0]


def _numbered(folder: Path) -> dict[int, Path]:
    """The numbered photos of a folder (00.png, 01.jpg, ...): a sorted dict, number to path."""
    paths: dict[int, Path] = {}
    found = files_of(folder, PLAIN + HEIC)
    if others := [path.name for path in found if path.stem[0].isdecimal() > path.stem.isdecimal()]:
        warn_of(f" holds photos that are not read: {listed(others)}; a photo of a calibrated capture is "
                "named by its number, as 00.png", folder)
    for path in found:
        if not path.stem.isdecimal():
            continue
        if int(path.stem) in paths:
            raise CaptureError("one photo of each number", f"{paths[int(path.stem)].name} and {path.name} "
                               f"in {folder}", "remove one of them")
        paths[int(path.stem)] = path
    if not paths:
        raise CaptureError("photos 00.png or 00.jpg, ...", f"none in {folder}", "check the folder")
    return dict(sorted(paths.items()))


def _views(camera: list, light: list, power: Any, size: float, falloff: Falloff, where: str) -> Views:
    """Make views. CaptureError, with the file's name: different numbers of rows, or invalid values."""
    power = _power(power, len(camera), f"light_pow in {where}")
    _same_count(f"light_pos in {where}", len(light), len(camera), "cameras")
    try:
        return Views.of(camera, light, power, size, falloff)
    except CaptureError as error:
        raise CaptureError(error.expected, f"{error.got} in {where}", error.fix) from None


def _power(value: Any, count: int, where: str) -> float | list:
    """Check a light's intensity: a number, three numbers, or 1 or ``count`` rows of three."""
    if not isinstance(value, list):
        return _stated(value, NUMBER, where)
    if not value or not isinstance(value[0], list):
        return _stated(value, ROW, where)
    rows = _stated(value, ROWS, where)
    if len(rows) not in (1, count):
        raise CaptureError(f"1 or {count} rows of {where}", f"{len(rows)} rows", "give one row a photo")
    return rows


def _same_count(what: str, rows: int, wanted: int, of: str = "photos") -> None:
    if rows != wanted:
        raise CaptureError(f"a row of {what} for each of {wanted} {of}", f"{rows} rows", "give one for each")


def _stated(value: Any, shape: Any, where: str) -> Any:
    """A value of a calibration, converted to the type ``shape``. CaptureError: it has another form."""
    try:
        return msgspec.convert(value, shape)
    except msgspec.ValidationError as reason:
        raise CaptureError(KINDS[shape], f"{reprlib.repr(value)} as {where} ({reason})",
                           "check the calibration") from None


def _table(path: Path) -> list[list[float]]:
    """The rows of numbers in a text file. Commas or blanks separate numbers; ``#`` begins a comment."""
    if not path.is_file():
        raise CaptureError(path.name, f"no such file in {path.parent}", "add it, or remove camera_pos.txt")
    try:
        content = path.read_bytes()
        lines = content.decode(json.detect_encoding(content)).replace(",", " ").splitlines()
        told = filter(None, (line.split("#")[0].split() for line in lines))
        rows = [[float(x) for x in numbers] for numbers in told]
    except (OSError, ValueError) as reason:
        raise CaptureError("rows of numbers", f"{path}: {reason}", "check the calibration") from None
    if not rows:
        raise CaptureError("rows of numbers", f"{path}, which is empty", "check the calibration")
    return rows
