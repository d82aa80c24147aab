"""A raw photo of a phone: its file, what its EXIF says, and its pixels as stored."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import CaptureError


@dataclass(frozen=True)
class Photo:
    """A file; its pixels are read when they are asked for.

    Args:
        path: jpg or png.
        size: width and height of the stored pixels, before any EXIF orientation.
        orientation: EXIF's, 1 to 8; 1: shown as stored.
        exif: see :func:`read_exif`.
    """

    path: Path
    size: tuple[int, int]
    orientation: int = 1
    exif: dict[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.path.name

    @classmethod
    def open(cls, path: Path) -> Photo:
        """A photo by its file, with only its header read.

        Raises:
            CaptureError: no image can be read from it.
        """
        from PIL import Image

        try:
            with Image.open(path) as image:
                size, orientation = image.size, image.getexif().get(0x0112, 1)
        except Exception as reason:  # Pillow raises all kinds
            raise CaptureError("a readable photo", f"{path}: {reason}", "check the file") from None
        return cls(path, size, orientation if orientation in range(1, 9) else 1, read_exif(path))

    def pixels(self, most: int | None = None) -> np.ndarray:
        """H x W x 3, RGB display values as stored, 8 or 16 bits.

        Args:
            most: pixels of the long side; a longer one is divided by the least whole number that makes it short enough,
                by area averages.
        """
        import cv2

        image = cv2.imread(str(self.path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if image is None or image.dtype not in (np.uint8, np.uint16):
            raise CaptureError("a readable 8- or 16-bit photo", str(self.path), "export it again as PNG or JPEG")
        times = math.ceil(max(self.size) / most) if most else 1
        if times > 1:  # whole blocks only: a remainder at the right and bottom edge is cut off
            height, width = (side // times for side in image.shape[:2])
            image = cv2.resize(image[: height * times, : width * times], (width, height), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(image[..., ::-1])


def read_exif(path: Path) -> dict[str, float]:
    """What a photo's EXIF says of "ISO", "exposure time", "focal length" (mm) and "35 mm focal length"; else empty."""
    try:
        from PIL import Image

        with Image.open(path) as image:
            tags = image.getexif().get_ifd(0x8769)
    except Exception:  # no Pillow, or an EXIF block that it cannot read: the photo itself may still be fine
        return {}
    known = {"ISO": 34855, "exposure time": 33434, "focal length": 37386, "35 mm focal length": 41989}
    found = {}
    for name, tag in known.items():
        value = tags.get(tag)
        value = value[0] if isinstance(value, tuple) and value else value
        try:
            number = float(value)
        except (TypeError, ValueError, ZeroDivisionError):
            continue
        if math.isfinite(number) and number > 0:
            found[name] = number
    return found
