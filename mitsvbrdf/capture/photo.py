"""A raw photo of a phone: its file, its EXIF, and its pixels as stored."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..errors import CaptureError, ConfigError, InputWarning, warn_of
from ..io.colour_profile import Profile
from ..io.decode import Picture, check_size, header, kind_of, needed, opened, picture
from ..io.files import check_names
from ..kinds import kinds_checked

PLAIN = (".png", ".jpg", ".jpeg", ".jpe", ".jfif", ".tif", ".tiff", ".webp")
HEIC = (".heic", ".heif", ".hif")  # need the extra `heic`
RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")  # need the extra `raw`
SUFFIXES = PLAIN + HEIC + RAW
# other files that a folder of photos may contain: notes, settings, pages
BESIDE = (".aae", ".csv", ".db", ".html", ".ini", ".json", ".md", ".pdf", ".txt", ".xml", ".xmp", ".yaml")

ORIENTATION_OF_FLIP = {3: 3, 5: 8, 6: 6}  # LibRaw's flip to EXIF's orientation

# Settings that a user can lock, and their EXIF tags. If values differ, the setting was not locked.
NUMBERS = {"ISO": 34855, "exposure time": 33434, "focal length": 37386, "35 mm focal length": 41989}
WORDS = {"white balance": (41987, {0: "automatic", 1: "manual"}), "flash": (37385, {0: "off", 1: "fired"})}
UNKNOWN = 65535  # some cameras write this, the largest 16-bit number, for an unknown value
SAME = ("ISO", "exposure time", "focal length", "white balance", "flash", "camera")


class Unreadable(CaptureError):
    """A file that is damaged, cut off or no image."""


@dataclass(frozen=True)
class Photo:
    """A photo's file and header; :meth:`read` reads its pixels."""

    # PNG, JPEG, TIFF or WebP; HEIC with the extra heic, RAW (dng, cr2, cr3, nef, arw, ...) with the extra raw
    path: Path
    size: tuple[int, int]  # width and height of the stored pixels, before any EXIF orientation
    orientation: int = 1  # EXIF's, 1 to 8; 1: shown as stored
    exif: dict[str, Any] = field(default_factory=dict)  # see read_exif
    linear: bool = False  # whether its values are proportional to radiance: those of RAW files are
    profile: Profile | None = None  # colour profile; None: sRGB
    balance: tuple[float, ...] = ()  # white balance factors for developing a RAW file; (): the camera's

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name

    @classmethod
    @kinds_checked
    def open(cls, path: str | Path) -> Photo:
        """Open a photo file and read only its header.

        CaptureError: no image can be read from it, or the package that reads such files is missing.
        """
        path = Path(path)
        if not path.is_file():  # reading a pipe or a device would block
            raise Unreadable("a photo", f"no file at {path}", "check the name")
        with _readable(path):
            kind = kind_of(path)
            if kind == "RAW" or kind in ("", "TIFF") and path.suffix.lower() in RAW:
                with needed("rawpy", "raw", path, CaptureError).imread(str(path)) as raw:
                    size = raw.sizes.width, raw.sizes.height
                    turned, balance = ORIENTATION_OF_FLIP.get(raw.sizes.flip, 1), raw.camera_whitebalance
                balance = tuple(balance) if min(balance[:3]) > 0 else ()
                check_size(path, size, CaptureError)
                return cls(path, size, turned, read_exif(path, "TIFF"), True, None, balance)
        about = header(path, Unreadable)
        return cls(path, about.size, about.orientation, read_exif(path, about.kind), False, about.profile)

    def read(self) -> Picture:
        """RGB pixels as stored, linear if RAW; 0 where alpha masks them. ``Unreadable``: a damaged file."""
        with _readable(self.path):
            if not self.linear:
                found = picture(self.path, Unreadable)
                if found.opaque is not None:
                    found.pixels[~found.opaque] = 0
                return found
            rawpy = needed("rawpy", "raw", self.path, CaptureError)
            white: dict = {"user_wb": list(self.balance)} if self.balance else {"use_camera_wb": True}
            # no option that depends on the picture, so that values stay comparable
            with rawpy.imread(str(self.path)) as raw:
                return Picture(raw.postprocess(**white, no_auto_bright=True, output_bps=16,
                                               gamma=(1, 1), user_flip=0, adjust_maximum_thr=0.0))

    def pixels(self, most: int | None = None) -> np.ndarray:
        """The pixels of :meth:`read`, H x W x 3, 8 or 16 bits; :func:`reduced` to at most ``most`` a side."""
        image = self.read().pixels
        with _readable(self.path):
            return np.ascontiguousarray(reduced(image, most) if most else image)


def reduced(image: np.ndarray, most: int) -> np.ndarray:
    """Average squares of n x n pixels, with the smallest n that makes the long side ``most`` or less."""
    import cv2

    times = math.ceil(max(image.shape[:2]) / most)
    if times == 1:
        return image
    # whole blocks only: what remains at two edges is cut off
    height, width = (side // times for side in image.shape[:2])
    return cv2.resize(image[: height * times, : width * times], (width, height), interpolation=cv2.INTER_AREA)


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn any exception of a decoder into one error that names the file."""
    try:
        yield
    except (CaptureError, InputWarning):
        raise
    except Exception as reason:  # Pillow, OpenCV and LibRaw raise all kinds
        said = reason.args[0] if reason.args else type(reason).__name__
        said = said.decode(errors="replace") if isinstance(said, bytes) else said
        raise Unreadable("a readable photo", f"{path}: {said}",
                         "copy it from the phone again, or take it out of the folder") from None


def files_of(folder: Path, suffixes: Sequence[str] | None) -> list[Path]:
    """The files of a folder with these suffixes (None: any), sorted by name, without hidden ones."""
    if not folder.is_dir():
        raise CaptureError("a folder of photos", f"no folder at {folder}", "check the name")
    return sorted(p for p in folder.iterdir() if (suffixes is None or p.suffix.lower() in suffixes)
                  and p.name[0] != "." and p.is_file())


def listed(names: Sequence[str]) -> str:
    """The first four names, and how many more there are."""
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if names[4:] else "")


@kinds_checked
def photos_in(folder: str | Path) -> list[Path]:
    """The photos of a folder, sorted by name, without hidden ones.

    CaptureError: no photo, or RAW files (linear values) together with others. ConfigError: a name that is
    not UTF-8.
    """
    found = files_of(folder := Path(folder), SUFFIXES)
    check_names(*found)
    others = [p.name for p in files_of(folder, None) if p.suffix.lower() not in SUFFIXES + BESIDE]
    way_out = "export the photos among them as JPEG, PNG, TIFF or HEIC"
    if not found:
        raise CaptureError("photos (jpg, png, heic, dng, ...)", f"{listed(others) or 'none'} in {folder}",
                           way_out if others else "give the folder that holds them")
    if others:
        warn_of(f" holds files that are not read: {listed(others)}; {way_out}", folder, stacklevel=3)
    raw = [p for p in found if p.suffix.lower() in RAW]
    if raw and len(raw) < len(found):
        raise CaptureError("photos of one kind", f"{len(raw)} RAW files and {len(found) - len(raw)} others "
                           f"in {folder}", "move one kind to another folder")
    return found


def of_one_camera(photos: Sequence[Photo]) -> tuple[list[Photo], dict[str, str], list[str]]:
    """Photos of the most common size, so of one lens; a dict, name of each other photo to the reason why it
    is rejected; and notes on camera settings that differ.

    CaptureError: RAW files among others, or a name twice. ConfigError: something else than photos.
    """
    if others := [photo for photo in photos if not isinstance(photo, Photo)]:
        raise ConfigError("photos, each from Photo.open", repr(others[0]),
                          "open each file that photos_in(folder) lists")
    if len({photo.linear for photo in photos}) > 1:
        raise CaptureError("photos of one kind", "RAW files among others", "give one kind alone")
    if twice := [name for name, count in Counter(photo.name for photo in photos).items() if count > 1]:
        raise CaptureError("a name of its own for each photo", f"two of {listed(twice)}", "rename them")
    usual = Counter(photo.size for photo in photos).most_common(1)[0][0] if photos else (0, 0)
    reasons = {}
    for photo in photos:
        if photo.size != usual:
            why = ("its pixels were turned when it was stored; give the file as the phone wrote it"
                   if photo.size == usual[::-1] else "cropped, scaled, or of another lens")
            reasons[photo.name] = (f"{photo.size[0]} x {photo.size[1]} pixels, the others have "
                                   f"{usual[0]} x {usual[1]}: {why}")
    photos, told = with_one_balance(photos)
    return [photo for photo in photos if photo.size == usual], reasons, [*differences(photos), *told]


def with_one_balance(photos: Sequence[Photo]) -> tuple[list[Photo], list[str]]:
    """The photos, RAW files with the most common white balance, so that values are comparable; and notes."""
    usual, count = Counter(photo.balance for photo in photos).most_common(1)[0] if photos else ((), 0)
    if not usual or count == len(photos):
        return list(photos), []
    return [replace(photo, balance=usual) for photo in photos], [
        f"white balance differs in {len(photos) - count} of {len(photos)} RAW files; all are developed with "
        f"that of {next(photo.name for photo in photos if photo.balance == usual)}"]


def differences(photos: Sequence[Photo]) -> list[str]:
    """Warnings: one for each setting that differs, with photos and values; one if flash was off in all."""
    found = []
    for what in SAME:
        names: dict[str, list[str]] = {}
        for photo in photos:
            if (value := photo.exif.get(what)) is not None:
                names.setdefault(value if isinstance(value, str) else f"{value:g}", []).append(photo.name)
        if len(names) > 1:
            usual = max(names, key=lambda value: len(names[value]))
            odd = sorted((name, value) for value, those in names.items() if value != usual for name in those)
            rest = listed([f"{value} in {name}" for name, value in odd])
            found.append(f"{what} differs: {usual} in {names[usual][0]}"
                         f"{' and others' * (len(names[usual]) > 1)}, {rest}; keep it the same in all photos")
    if all(photo.exif.get("flash") == "off" for photo in photos):
        found.append("no photo was taken with the flash, says EXIF: the highlights are those of the room")
    return found


def read_exif(path: Path, kind: str) -> dict[str, float | str]:
    """A photo's EXIF; empty if it is missing or unreadable.

    Numbers: "ISO", "exposure time" (s), "focal length" and "35 mm focal length" (mm). Words: "white balance"
    (automatic or manual), "flash" (fired or off), "camera" (maker and model), "date" (as the camera wrote
    it).
    """
    try:
        with opened(path, kind) as image:
            block = Image.Image.getexif(image)  # the method of a PNG would decode its pixels
            tags = dict(block.get_ifd(0x8769))
            camera = " ".join(str(block.get(tag, "")).strip("\0 ") for tag in (271, 272)).strip()
    except Exception:  # a block that cannot be read: the photo itself may still be fine
        return {}
    found: dict[str, Any] = {}
    for name, tag in NUMBERS.items():
        with contextlib.suppress(TypeError, ValueError, ZeroDivisionError, IndexError):
            value: Any = tags.get(tag)
            number = float(value[0] if isinstance(value, tuple) else value)
            if 0 < number < UNKNOWN:
                found[name] = number
    for name, (tag, words) in WORDS.items():
        value = tags.get(tag)
        if isinstance(value, int):
            found[name] = words[value & 1]  # the lowest bit of the flash: whether it fired
    if camera:
        found["camera"] = camera
    if isinstance(tags.get(36867), str):
        found["date"] = tags[36867].strip("\0 ")
    return found
