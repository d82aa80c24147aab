"""PNG and JPEG files to pixels: their header first, within a limit, and damage by the name of the file."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import InputWarning, MitsvbrdfError

if TYPE_CHECKING:
    from PIL.Image import Image

MOST_PIXELS = 250_000_000  # of a picture; the largest sensors of phones have 200 million
MOST_BYTES = 8 * MOST_PIXELS  # of its file


class Header(NamedTuple):
    """What a file says of itself."""

    kind: str  # PNG or JPEG
    size: tuple[int, int]  # width and height as stored
    orientation: int  # EXIF's, 1 to 8; 1: shown as stored
    mode: str  # Pillow's name of the channels


def header(path: Path, error: type[MitsvbrdfError]) -> Header:
    """Read the header alone, and raise ``error`` for what is no PNG or JPEG, or is larger than any photo."""
    if not path.is_file():  # a pipe or a device would be waited for
        raise error("an image file", f"no file at {path}", "check the name")
    with _named(path, error), opened(path, ("PNG", "JPEG")) as image:
        check_size(path, image.size, error)
        return Header("PNG" if image.format == "PNG" else "JPEG", image.size, orientation(image), image.mode)


def decoded(path: Path, error: type[MitsvbrdfError]) -> np.ndarray:
    """A PNG or JPEG as H x W x 3, RGB as stored, 8 or 16 bits. Alpha is dropped, grey repeated.

    Raises:
        MitsvbrdfError: as ``error``: the file is missing, too large, cut short, or damaged beyond reading.

    Warns:
        InputWarning: a JPEG is damaged; its decoder made up what it could not read.
    """
    about = header(path, error)
    with _named(path, error):
        content = path.read_bytes()
        if about.kind == "PNG":
            return _png(path, content)
        if about.mode in ("L", "RGB"):
            return _jpeg(path, content)
        with opened(path) as image:  # of four inks
            return np.asarray(image.convert("RGB"))


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Pixels (H x W x C) turned as EXIF's orientation says they are shown."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels[:, ::-1] if orientation in (2, 3, 6, 7) else pixels


def check_size(path: Path, size: tuple[int, int], error: type[MitsvbrdfError]) -> None:
    """Raise for a picture of more pixels or bytes than any camera makes, before it fills the memory."""
    if size[0] * size[1] > MOST_PIXELS:
        raise error(f"photos of at most {MOST_PIXELS / 1e6:.0f} megapixels",
                    f"{path} of {size[0]} x {size[1]} pixels", "shrink it, or leave it out")
    if (held := path.stat().st_size) > MOST_BYTES:
        raise error(f"files of at most {MOST_BYTES / 1e9:.0f} GB", f"{path} of {held / 1e9:.0f}",
                    "export it again")


@contextlib.contextmanager
def opened(path: Path, formats: tuple[str, ...] | None = None) -> Iterator[Image]:
    """The file in Pillow, without Pillow's own limit of pixels: photos of phones have up to 200 million."""
    from PIL import Image

    most, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path, formats=formats) as image:  # of EXIF
            yield image
    finally:
        Image.MAX_IMAGE_PIXELS = most


def orientation(image: Image) -> int:
    """EXIF's, 1 to 8, of the header alone; 1 where there is none."""
    from PIL import Image

    try:
        found = Image.Image.getexif(image).get(0x0112, 1)  # that of a PNG would decode it
    except Exception:  # an EXIF block that cannot be read
        return 1
    return found if found in range(1, 9) else 1


def _png(path: Path, content: bytes) -> np.ndarray:
    import cv2

    with opened(path) as image:
        image.verify()  # its checksums, of which OpenCV only prints
    how = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), how)
    except cv2.error as reason:
        raise ValueError(str(reason)) from None
    if pixels is None or pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError("no 8- or 16-bit image")
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB, dst=pixels)


def _jpeg(path: Path, content: bytes) -> np.ndarray:
    """Warns where the decoder complained. Only libjpeg-turbo's own interface tells that."""
    import simplejpeg

    try:
        return simplejpeg.decode_jpeg(content, strict=True)
    except ValueError as complaint:
        with opened(path) as image:  # raises for one that ends early
            image.draft("RGB", (image.width // 8 or 1, image.height // 8 or 1))
            image.load()
        pixels = simplejpeg.decode_jpeg(content, strict=False)
        warnings.warn(f"{path} is damaged ({complaint}), and what it shows may be wrong; copy it again",
                      InputWarning, stacklevel=4)
        return pixels


@contextlib.contextmanager
def _named(path: Path, error: type[MitsvbrdfError]) -> Iterator[None]:
    try:
        yield
    except (OSError, SyntaxError, ValueError) as reason:
        raise error("a whole PNG or JPEG", f"{path}: {reason}", "copy or export it again") from None
