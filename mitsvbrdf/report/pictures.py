"""Pictures inside a page: tensors as ``data:`` addresses for ``<img src>``, shrunk, or as colours of errors.

Pictures have display values (encoded, 0 to 1), never linear radiance. OpenCV and matplotlib are
loaded with the first picture.
"""

import base64
import math
from collections.abc import Callable

import torch
from torch import Tensor

from .. import color
from ..material.resample import averaged_rows


def magma(share: Tensor) -> Tensor:
    """Numbers 0 to 1, of any shape, in colours of matplotlib's ``magma``: display values, that shape x 3."""
    import matplotlib

    return torch.as_tensor(matplotlib.colormaps["magma"](share.clamp(0, 1).numpy())[..., :3],
                           dtype=torch.float32)


def png_uri(display: Tensor) -> str:
    """A picture for ``<img src>``, exact to 8 bits, of display values H x W x 3 (or x 1), clipped."""
    return _uri(display, "png")


def picture_uri(display: Tensor, exact_up_to: int = 64 * 1024) -> str:
    """A picture like :func:`png_uri`: a PNG of at most ``exact_up_to`` bytes, else a JPEG of quality 85."""
    import cv2

    exact = png_uri(display)
    if len(exact) < 4 / 3 * exact_up_to:
        return exact
    return _uri(display, "jpeg", cv2.IMWRITE_JPEG_QUALITY, 85, cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
                cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)


def _uri(display: Tensor, kind: str, *options: int) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(encoded(display, kind, *options)).decode()}"


def encoded(display: Tensor, kind: str, *options: int) -> bytes:
    """Display values H x W x 3 or x 1 as an image file of this kind; ``options`` are OpenCV's."""
    import cv2

    levels = (color.clip(display.detach().float()) * 255).round().to(torch.uint8)
    pixels = levels.expand(*levels.shape[:2], 3).flip(-1).contiguous().numpy()  # OpenCV writes BGR
    return cv2.imencode(f".{kind}", pixels, options)[1].tobytes()


def at_most(picture: Tensor, side: int, shown: Callable[[Tensor], Tensor] = Tensor.detach) -> Tensor:
    """A picture H x W x C area-averaged so that no side is longer than this many pixels.

    ``shown`` turns some of its rows into display values.
    """
    if max(picture.shape[:2]) <= side:
        return shown(picture)
    return averaged_rows(lambda rows: shown(picture[rows]), len(picture), *shrunk(picture, side))


def shrunk(picture: Tensor, side: int) -> tuple[int, int]:
    """Height and width of a picture H x W (x C) whose longer side is to have this many pixels."""
    height, width = picture.shape[:2]
    rows, columns = (max(1, round(length * side / max(height, width))) for length in (height, width))
    return rows, columns


def error_picture(error: Tensor, high: float, low: float | None = None) -> Tensor:
    """Sizes of an error, H x W, in the colours of ``magma``, log scale, as H x W x 3 display values.

    ``low`` is shown black, ``high`` brightest. Default of ``low``: ``high`` / 1e4.
    """
    low = low or high / 1e4
    share = (torch.log(error.double().clamp_min(1e-300) / low) / math.log(high / low)).clamp(0, 1)
    return magma(torch.where(torch.isfinite(error), share, torch.ones_like(share)))
