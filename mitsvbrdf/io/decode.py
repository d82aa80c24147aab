"""Decode picture files by their content, after a check of header and size; errors name the damaged file."""

from __future__ import annotations

import contextlib
import importlib
import struct
import warnings
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import imagecodecs
import numpy as np
import simplejpeg
from PIL import Image, TiffImagePlugin

from ..errors import MitsvbrdfError, warn_of
from .colour_profile import Profile, exif_of, profile_of, to_srgb

MOST_PIXELS = 250_000_000  # of a picture; the largest sensors of phones have 200 million
MOST_BYTES = 8 * MOST_PIXELS  # of a picture's file
MAGIC = {b"\x89PNG\r\n\x1a\n": "PNG", b"\xff\xd8\xff": "JPEG", b"II*\0": "TIFF", b"MM\0*": "TIFF"}
HEIF_BRANDS = b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs", b"mif1", b"msf1"
DNG_VERSION = b"\x12\xc6\1\0\4\0\0\0", b"\xc6\x12\0\1\0\0\0\4"  # tag 50706 of TIFF, four bytes
BITS, PHOTOMETRIC, ORIENTATION, EXTRA_SAMPLES = 258, 262, 274, 338  # tags of TIFF; the third is also in EXIF
BETWEEN = 10, 12, 14  # bits per value; libtiff decodes them to 16. These entries let Pillow read headers:
for _ends, _bits, (_meaning, _count) in product((b"II", b"MM"), BETWEEN, ((0, 1), (1, 1), (2, 3))):
    TiffImagePlugin.OPEN_INFO.setdefault((_ends, _meaning, (1,), 1, (_bits,) * _count, ()),
                                         ("I;16" if _count == 1 else "RGB", f"I;{_bits}"))
FOREIGN = "CMYK", "LAB", "HSV"  # Pillow's modes that are neither RGB nor grey
OPAQUE = 0.98  # a pixel is opaque from this share of the largest alpha on; a constant alpha masks nothing
# EXIF orientation: quarter turns, counter-clockwise, from the photo as shown to the sensor's picture
UNTURNED = {3: 2, 6: 1, 8: -1}


class Header(NamedTuple):
    """What a picture's header states."""

    kind: str  # PNG, JPEG, TIFF, WEBP or HEIF
    size: tuple[int, int]  # width and height as stored
    orientation: int  # EXIF's, 1 to 8; 1: shown as stored
    mode: str  # Pillow's mode, which names the channels
    profile: Profile | None  # of the colours; None: sRGB
    bits: int = 8  # per value of a TIFF
    negative: bool = False  # whether it is a grey TIFF in which 0 is white


class Picture(NamedTuple):
    """Pixels of a file as stored."""

    pixels: np.ndarray  # H x W x 3, RGB, 8 or 16 bits, in the colours of sRGB
    alpha: np.ndarray | None = None  # H x W, as stored; None: it has none
    outside: float = 0.0  # share of pixels whose colours were outside of sRGB

    @property
    def opaque(self) -> np.ndarray | None:
        """H x W, False at pixels that alpha masks; None: no pixel is masked."""
        opaque = None if self.alpha is None else self.alpha >= OPAQUE * self.alpha.max()
        return None if opaque is None or opaque.all() else opaque


def kind_of(path: Path) -> str:
    """The kind of a file, from its first bytes: PNG, JPEG, TIFF, WEBP, HEIF, or RAW (a DNG); else empty."""
    with open(path, "rb") as file:
        head = file.read(4096)
    if head[4:8] == b"ftyp":
        return "HEIF" if head[8:12] in HEIF_BRANDS else ""
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return "WEBP"
    kind = next((kind for start, kind in MAGIC.items() if head.startswith(start)), "")
    return "RAW" if kind == "TIFF" and any(entry in head for entry in DNG_VERSION) else kind


def header(path: Path, error: type[MitsvbrdfError]) -> Header:
    """Read only the header. ``error`` is raised if the file is no picture, or larger than any photo."""
    if not path.is_file():  # reading a pipe or a device would wait
        raise error("an image file", f"no file at {path}", "check the name")
    with _named(path, error):
        kind = kind_of(path)
        if kind in ("", "RAW"):
            raise ValueError("it holds no such picture")
        if kind == "HEIF":
            _check_boxes(path)
            needed("pillow_heif", "heic", path, error).register_heif_opener()
        with opened(path, kind) as image:
            size, turned = image.size, exif_of(image, ORIENTATION)
            if kind == "HEIF":  # decoded as shown; the lens is calibrated on the sensor's picture
                turned = stored if (stored := image.info.get("original_orientation", 1)) in UNTURNED else 1
                size = size[::-1] if turned in (6, 8) else size
            elif kind == "TIFF":
                tags = image.tag_v2  # type: ignore[attr-defined]
                size = tags[256], tags[257]
            check_size(path, size, error)
            if image.mode in FOREIGN:
                raise error("a picture in RGB or grey", f"{path} in {image.mode}",
                            "convert it to sRGB where its profile is known, and save it as RGB")
            masked, mode, bits, negative = image.has_transparency_data, image.mode, 8, False
            if kind == "TIFF":
                masked = masked and tags.get(EXTRA_SAMPLES, (0,))[0]
                bits, negative = tags.get(BITS, (1,))[0], tags.get(PHOTOMETRIC) == 0
                if bits < 8 or mode == "P":  # read by Pillow, which turns it upright
                    mode, turned, size = "P", 1, size[::-1] if turned in (5, 6, 7, 8) else size
            return Header(kind, size, turned if turned in range(1, 9) else 1, "RGBA" if masked else mode,
                          profile_of(image, path), bits, negative)


def picture(path: Path, error: type[MitsvbrdfError], data: bool = False) -> Picture:
    """Decode a PNG, JPEG, TIFF, WebP or HEIC file by its content, whatever its name; grey becomes RGB.

    ``error`` is raised for a file that is missing, too large, cut short, or damaged beyond reading.
    InputWarning: parts of a JPEG are unreadable, and the decoder made them up. ``data``: the values are no
    colours, and are not converted.
    """
    about = header(path, error)
    with _named(path, error):
        content = path.read_bytes()
        if about.kind == "JPEG" and about.mode in ("L", "RGB"):
            pixels = _jpeg(path, content)
        elif about.kind == "PNG":
            if b"IEND" not in content:
                raise ValueError("it ends early")
            pixels = _decoded(imagecodecs.png_decode, content, about.mode == "RGBA")
        elif about.kind == "TIFF" and about.mode != "P":  # for a palette, libtiff gives the indices
            pixels = _decoded(imagecodecs.tiff_decode, content, about.mode == "RGBA")
            if about.bits in BETWEEN:
                pixels = pixels << 16 - about.bits | pixels >> 2 * about.bits - 16
            pixels = ~pixels if about.negative and about.mode != "RGBA" else pixels
        else:
            pixels = _by_pillow(path, about)
    alpha, outside = None, 0.0
    if pixels.shape[2] == 4:
        alpha, pixels = pixels[..., 3], np.ascontiguousarray(pixels[..., :3])
    if about.profile and about.profile.icc and not data:
        pixels, outside = to_srgb(pixels, about.profile)
    return Picture(pixels, alpha, outside)


def _check_boxes(path: Path) -> None:
    """Raise ValueError if a HEIC ends early: its decoder would leave missing tiles grey without a warning."""
    with open(path, "rb") as file:
        at, end = 0, file.seek(0, 2)
        while at + 8 <= end:
            file.seek(at)
            length, kind, long = struct.unpack(">I4sQ", file.read(16).ljust(16, b"\0"))
            length = long if length == 1 else length or end - at  # 0: up to the end
            if kind in (b"meta", b"mdat") and at + length > end:
                raise ValueError("it ends early")
            at += max(length, 8)


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Pixels (H x W x C or H x W), turned upright by EXIF's orientation."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels[:, ::-1] if orientation in (2, 3, 6, 7) else pixels


def check_size(path: Path, size: tuple[int, int], error: type[MitsvbrdfError]) -> None:
    """Before decoding, raise ``error`` if a picture has more pixels or bytes than those of any camera."""
    if size[0] * size[1] > MOST_PIXELS:
        raise error(f"pictures of at most {MOST_PIXELS / 1e6:.0f} megapixels",
                    f"{path} of {size[0]} x {size[1]} pixels", "shrink it, or leave it out")
    if (held := path.stat().st_size) > MOST_BYTES:
        raise error(f"files of at most {MOST_BYTES / 1e9:.0f} GB", f"{path} of {held / 1e9:.1f} GB",
                    "export it again")


@contextlib.contextmanager
def opened(path: Path, kind: str) -> Iterator[Image.Image]:
    """Open a file in Pillow as this kind only. Otherwise, Pillow would run Ghostscript on PostScript files.

    Pillow gets an open file. From a path, it would map a plain TIFF into memory and not turn it upright.
    """
    most, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        with (warnings.catch_warnings(action="ignore"), open(path, "rb") as file,  # warnings of EXIF
              Image.open(file, formats=(kind,)) as image):
            yield image
    finally:
        Image.MAX_IMAGE_PIXELS = most


def _jpeg(path: Path, content: bytes) -> np.ndarray:
    """Decode a JPEG, and warn if it is damaged: only libjpeg-turbo's own interface reports damage."""
    try:
        return simplejpeg.decode_jpeg(content, strict=True)
    except ValueError as complaint:
        with opened(path, "JPEG") as image:  # raises if the JPEG ends early
            image.draft("RGB", (image.width // 8 or 1, image.height // 8 or 1))
            image.load()
        pixels = simplejpeg.decode_jpeg(content, strict=False)
        warn_of(f" is damaged ({complaint}) and may look wrong; copy it again", path, stacklevel=4)
        return pixels


def _decoded(decode: Callable[[bytes], np.ndarray], content: bytes, masked: bool) -> np.ndarray:
    try:
        pixels = decode(content)
    except Exception as reason:  # each codec has an error of its own
        raise ValueError(str(reason)) from None
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"an image of 8 or 16 bits is needed, not of {pixels.dtype}")
    if pixels.ndim == 3 and pixels.shape[0] in (3, 4) and pixels.shape[2] > 4:  # channels first
        pixels = np.moveaxis(pixels, 0, -1)
    return _coloured(pixels, masked)


def _coloured(pixels: np.ndarray, masked: bool) -> np.ndarray:
    """Pixels as H x W x 3, or x 4 with alpha; grey is repeated."""
    pixels = np.atleast_3d(pixels)
    if pixels.shape[2] < 3:  # grey, perhaps with alpha
        pixels = np.concatenate((*[pixels[..., :1]] * 3, pixels[..., 1:]), axis=2)
    return np.ascontiguousarray(pixels[..., :3 + masked])


def _by_pillow(path: Path, about: Header) -> np.ndarray:
    masked = about.mode == "RGBA"
    with opened(path, about.kind) as image:
        if (bits := image.info.get("bit_depth", 8)) == 8:
            pixels = np.asarray(image.convert("RGBA" if masked else "RGB"))
    if bits > 8:  # HEIC; Pillow has no colours of more than 8 bits
        heif = importlib.import_module("pillow_heif")
        stored = heif.open_heif(path, convert_hdr_to_8bit=False, hdr_to_16bit=False)
        pixels = (_coloured(np.asarray(stored), masked) * (65535 / (2**bits - 1))).round().astype(np.uint16)
    return np.rot90(pixels, UNTURNED.get(about.orientation, 0)) if about.kind == "HEIF" else pixels


def needed(module: str, extra: str, path: Path, error: type[MitsvbrdfError]) -> ModuleType:
    """Import a package of an optional extra; if it is missing, ``error`` names the extra to install."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise error(f"the package {module} for files like {path.name}", "none installed",
                    f'pip install "mitsvbrdf[{extra}]", or export the photos as JPEG') from None


@contextlib.contextmanager
def _named(path: Path, error: type[MitsvbrdfError]) -> Iterator[None]:
    try:
        yield
    except (OSError, SyntaxError, ValueError) as reason:
        raise error("a whole PNG, JPEG, TIFF, WebP or HEIC file", f"{path}: {reason}",
                    "copy or export it again") from None
