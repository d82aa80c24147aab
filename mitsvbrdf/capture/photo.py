"""A raw photo of a phone: its file, what its EXIF says, and its pixels as stored."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ..errors import CaptureError, ConfigError, InputWarning
from ..io.decode import check_size, decoded, opened
from ..io.decode import orientation as orientation_of
from ..io.files import check_names
from ..kinds import kinds_checked

PLAIN = (".png", ".jpg", ".jpeg")
HEIC = (".heic", ".heif")  # need the extra `heic`
RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")  # need the extra `raw`
SUFFIXES = PLAIN + HEIC + RAW

ORIENTATION_OF_FLIP = {3: 3, 5: 8, 6: 6}  # EXIF's by LibRaw's
# quarter turns against the clock, from how a photo is shown to how the sensor saw it
UNTURNED = {3: 2, 6: 1, 8: -1}

# What can be locked, and shows where it was not: EXIF tags of the Exif block, a number each.
NUMBERS = {"ISO": 34855, "exposure time": 33434, "focal length": 37386, "35 mm focal length": 41989}
WORDS = {"white balance": (41987, {0: "automatic", 1: "manual"}), "flash": (37385, {0: "off", 1: "fired"})}
UNKNOWN = 65535  # what some cameras write for a number they do not know, the largest of 16 bits
SAME = ("ISO", "exposure time", "focal length", "white balance", "flash", "camera")


class Unreadable(CaptureError):
    """A file that is damaged, cut off or no image."""


@dataclass(frozen=True)
class Photo:
    """A file; its pixels are read when they are asked for.

    Args:
        path: png or jpg; HEIC with the extra ``heic``, RAW (dng, cr2, cr3, nef, arw, ...) with the extra
            ``raw``.
        size: width and height of the stored pixels, before any EXIF orientation.
        orientation: EXIF's, 1 to 8; 1: shown as stored.
        exif: see :func:`read_exif`.
    """

    path: Path
    size: tuple[int, int]
    orientation: int = 1
    exif: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name

    @property
    def linear(self) -> bool:
        """Whether its values are proportional to radiance: those of RAW files are."""
        return self.path.suffix.lower() in RAW

    @classmethod
    @kinds_checked
    def open(cls, path: str | Path) -> Photo:
        """A photo by its file, with only its header read.

        Raises:
            CaptureError: no image can be read from it, or the package that reads such files is missing.
        """
        path = Path(path)
        if not path.is_file():  # a pipe or a device would be waited for
            raise Unreadable("a photo", f"no file at {path}", "check the name")
        if path.suffix.lower() in RAW:
            with _readable(path), _needed("rawpy", "raw", path).imread(str(path)) as raw:
                size = raw.sizes.width, raw.sizes.height
                orientation = ORIENTATION_OF_FLIP.get(raw.sizes.flip, 1)
        else:
            with _readable(path), _opened(path) as image:
                size, orientation = image.size, orientation_of(image)
                # decoded as it is shown; the sensor's pixels are what the lens knows
                if path.suffix.lower() in HEIC:
                    orientation = image.info.get("original_orientation") or 1
                    size = size[::-1] if orientation in (6, 8) else size
        check_size(path, size, CaptureError)
        return cls(path, size, orientation if orientation in range(1, 9) else 1, read_exif(path))

    def pixels(self, most: int | None = None) -> np.ndarray:
        """H x W x 3, RGB as stored, 8 or 16 bits: display values, of RAW files linear ones. Alpha is dropped.

        Args:
            most: pixels of the long side; a longer one is divided by the least whole number that makes it
                short enough, by area averages.

        Raises:
            Unreadable: the file is damaged or cut off.
        """
        with _readable(self.path):
            image = self._decoded()
            return np.ascontiguousarray(reduced(image, most) if most else image)

    def _decoded(self) -> np.ndarray:
        suffix = self.path.suffix.lower()
        if suffix in RAW:
            rawpy = _needed("rawpy", "raw", self.path)
            # nothing that depends on the picture: values stay comparable
            with rawpy.imread(str(self.path)) as raw:
                return raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=16, gamma=(1, 1),
                                       user_flip=0, adjust_maximum_thr=0.0)
        if suffix in PLAIN:
            return decoded(self.path, Unreadable)
        with _opened(self.path) as image:
            return np.rot90(np.asarray(image.convert("RGB")), UNTURNED.get(self.orientation, 0))


def reduced(image: np.ndarray, most: int) -> np.ndarray:
    """Pixels averaged over squares of the least whole side that makes the long side ``most`` or less."""
    import cv2

    times = math.ceil(max(image.shape[:2]) / most)
    if times == 1:
        return image
    # whole blocks only: what remains at two edges is cut off
    height, width = (side // times for side in image.shape[:2])
    return cv2.resize(image[: height * times, : width * times], (width, height), interpolation=cv2.INTER_AREA)


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Whatever a decoder raises becomes one error that names the file."""
    try:
        yield
    except (CaptureError, InputWarning):
        raise
    except Exception as reason:  # Pillow, OpenCV and LibRaw raise all kinds
        said = reason.args[0] if reason.args else type(reason).__name__
        said = said.decode(errors="replace") if isinstance(said, bytes) else said
        raise Unreadable("a readable photo", f"{path}: {said}",
                         "copy it from the phone again, or take it out of the folder") from None


@contextlib.contextmanager
def _opened(path: Path) -> Iterator:
    """The file in Pillow, read as its name says: Pillow hands PostScript of any name to Ghostscript."""
    if heic := path.suffix.lower() in HEIC:
        _needed("pillow_heif", "heic", path).register_heif_opener()
    with opened(path, ("HEIF",) if heic else ("PNG", "JPEG")) as image:
        yield image


def _needed(module: str, extra: str, path: Path) -> ModuleType:
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError:
        raise CaptureError(f"the package {module} for files like {path.name}", "none installed",
                           f'pip install "mitsvbrdf[{extra}]", or export the photos as JPEG') from None


def files_of(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """Files of a folder with these suffixes by name, hidden ones aside."""
    if not folder.is_dir():
        raise CaptureError("a folder of photos", f"no folder at {folder}", "check the name")
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in suffixes and p.name[0] != "."
                  and p.is_file())


@kinds_checked
def photos_in(folder: str | Path) -> list[Path]:
    """The photos of a folder by name, hidden ones aside.

    Raises:
        CaptureError: none, or RAW files beside others, whose values mean something else.
        ConfigError: a name that is not UTF-8.
    """
    found = files_of(folder := Path(folder), SUFFIXES)
    check_names(*found)
    if not found:
        raise CaptureError("photos (jpg, png, heic, dng, ...)", f"none in {folder}",
                           "give the folder that holds them")
    raw = [p for p in found if p.suffix.lower() in RAW]
    if raw and len(raw) < len(found):
        raise CaptureError("photos of one kind",
                           f"{len(raw)} RAW files and {len(found) - len(raw)} others in {folder}",
                           "move one kind to another folder")
    return found


def of_one_camera(photos: Sequence[Photo]) -> tuple[list[Photo], dict[str, str], list[str]]:
    """Photos that one lens can explain.

    Returns:
        The photos of the size that most have; the reason, by name, of each other photo; and what a user
        should know of the camera's settings.

    Raises:
        CaptureError: RAW files among others.
        ConfigError: something else than photos.
    """
    if others := [photo for photo in photos if not isinstance(photo, Photo)]:
        raise ConfigError("photos, each from Photo.open", repr(others[0]),
                          "open each file that photos_in(folder) lists")
    if len({photo.linear for photo in photos}) > 1:
        raise CaptureError("photos of one kind", "RAW files among others", "give one kind alone")
    usual = Counter(photo.size for photo in photos).most_common(1)[0][0] if photos else (0, 0)
    reasons = {}
    for photo in photos:
        if photo.size != usual:
            why = ("its pixels were turned when it was stored; give the file as the phone wrote it"
                   if photo.size == usual[::-1] else "cropped, scaled, or of another lens")
            reasons[photo.name] = (f"{photo.size[0]} x {photo.size[1]} pixels, the others have "
                                   f"{usual[0]} x {usual[1]}: {why}")
    notes = differences(photos)
    if all(photo.exif.get("flash") == "off" for photo in photos):
        notes.append("no photo was taken with the flash, as their EXIF says: the highlights are those of the "
                     "room's lights")
    return [photo for photo in photos if photo.size == usual], reasons, notes


def differences(photos: Sequence[Photo]) -> list[str]:
    """A warning for each setting of the camera that is not the same in all photos, with photos and values."""
    found = []
    for what in SAME:
        names: dict[float | str, list[str]] = {}
        for photo in photos:
            if what in photo.exif:
                names.setdefault(photo.exif[what], []).append(photo.name)
        if len(names) > 1:
            usual = max(names, key=lambda value: len(names[value]))
            odd = sorted((name, value) for value, those in names.items() if value != usual for name in those)
            listed = ", ".join(f"{_shown(value)} in {name}" for name, value in odd[:4])
            more = f" and {len(odd) - 4} more" if len(odd) > 4 else ""
            found.append(f"{what} differs: {_shown(usual)} in {names[usual][0]}"
                         f"{' and others' if len(names[usual]) > 1 else ''}, {listed}{more}; lock it for "
                         "comparable photos")
    return found


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def read_exif(path: Path) -> dict[str, float | str]:
    """What a photo's EXIF says, else empty.

    Numbers: "ISO", "exposure time" (s), "focal length" and "35 mm focal length" (mm). Words: "white balance"
    (automatic or manual), "flash" (fired or off), "camera" (maker and model), "date" (as the camera wrote
    it).
    """
    try:
        from PIL import Image

        with _opened(path) as image:
            block = Image.Image.getexif(image)  # that of a PNG would decode it
            tags = dict(block.get_ifd(0x8769))
            camera = " ".join(str(block.get(tag, "")).strip("\0 ") for tag in (271, 272)).strip()
    # no such package, or an EXIF block that cannot be read: the photo itself may still be fine
    except Exception:
        return {}
    found: dict[str, Any] = {}
    for name, tag in NUMBERS.items():
        value: Any = tags.get(tag)
        value = value[0] if isinstance(value, tuple) and value else value
        try:
            number = float(value)
        except (TypeError, ValueError, ZeroDivisionError):
            continue
        if 0 < number < UNKNOWN:
            found[name] = number
    for name, (tag, words) in WORDS.items():
        value = tags.get(tag)
        if isinstance(value, int):
            found[name] = words[value & 1]  # of the flash, only the lowest bit says whether it fired
    if camera:
        found["camera"] = camera
    if isinstance(tags.get(36867), str):
        found["date"] = tags[36867].strip("\0 ")
    return found
