"""Image files to tensors and back: PNG and JPEG as display values, EXR as it is; row 0 at the top, RGB order.

Photos with EXIF, HEIC or raw data are read by :mod:`mitsvbrdf.capture.photo`, whole sets of maps by
:mod:`mitsvbrdf.material.map_files`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from .. import color
from ..errors import MitsvbrdfError
from .files import beside, write_bytes

MOST_PIXELS = 250_000_000  # the largest sensors of phones have 200 million


def read_image(path: Path, error: type[MitsvbrdfError]) -> Tensor:
    """An image file as float32 H x W x C, row 0 at the top, RGB order.

    8- and 16-bit files give display values in [0, 1]; EXR files give what they hold. Alpha is dropped.

    Args:
        path: png, jpg or exr.
        error: the error type to raise when the file is missing or is no image.
    """
    import cv2

    path = Path(path)
    if not path.is_file():
        raise error("an image file", f"no file at {path}", "check the name")
    if path.suffix.lower() == ".exr":
        return _read_exr(path, error)
    check_whole(path, error)
    data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR) if data.size else None
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise error("a readable 8- or 16-bit image", f"{path}, which is none", "export it again as PNG or JPEG")
    scale = np.float32(255 if image.dtype == np.uint8 else 65535)
    return torch.from_numpy(np.ascontiguousarray(image[..., ::-1]).astype(np.float32) / scale)


def check_whole(path: Path, error: type[MitsvbrdfError]) -> None:
    """Raise for a PNG or JPEG that ends early or is damaged, which OpenCV only prints, or has more pixels than any photo."""
    from PIL import Image

    most, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None  # photos of 200 megapixels are no bombs
    try:
        with Image.open(path, formats=("PNG", "JPEG")) as image:
            check_size(path, image.size, error)
            if image.format == "PNG":
                image.verify()  # its checksums
            else:
                image.draft("RGB", (image.width // 8 or 1, image.height // 8 or 1))  # reads all, and makes an eighth of it
                image.load()
    except (OSError, SyntaxError, ValueError) as reason:
        raise error("a whole PNG or JPEG", f"{path}: {reason}", "copy or export it again") from None
    finally:
        Image.MAX_IMAGE_PIXELS = most


def check_size(path: Path, size: tuple[int, int], error: type[MitsvbrdfError]) -> None:
    """Raise for a picture of more pixels than any camera has, before it fills the memory."""
    if size[0] * size[1] > MOST_PIXELS:
        raise error(f"photos of at most {MOST_PIXELS / 1e6:.0f} megapixels",
                    f"{path} of {size[0]} x {size[1]} pixels", "shrink it, or leave it out")


def _read_exr(path: Path, error: type[MitsvbrdfError]) -> Tensor:
    import OpenEXR

    try:
        channels = OpenEXR.File(str(path)).channels()
    except Exception as reason:  # OpenEXR raises plain RuntimeError and others
        raise error("a readable EXR file", f"{path}: {reason}", "export it again") from None
    for name in ("RGB", "RGBA"):
        if name in channels:
            return torch.from_numpy(np.array(channels[name].pixels[..., :3], dtype=np.float32))
    if all(c in channels for c in "RGB"):
        return torch.from_numpy(np.stack([channels[c].pixels for c in "RGB"], axis=-1).astype(np.float32))
    if len(channels) == 1:
        (channel,) = channels.values()
        return torch.from_numpy(np.array(channel.pixels, dtype=np.float32)[..., None])
    raise error("an EXR with R, G, B or one channel", f"{path} with {sorted(channels)}", "export it again")


def write_exr(path: Path, image: Tensor) -> None:
    """A float32 EXR of an H x W x 3 (R, G, B) or H x W x 1 (Y) tensor, ZIP-compressed."""
    import OpenEXR

    pixels = np.ascontiguousarray(image.detach().to(torch.float32).numpy())
    channels = {"RGB": pixels} if pixels.shape[2] == 3 else {"Y": np.ascontiguousarray(pixels[..., 0])}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with beside(path) as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
        except RuntimeError as reason:  # what OpenEXR makes of a full disk; plain bytes tell its number
            temporary.write_bytes(pixels.tobytes())
            raise OSError(str(reason)) from None


def write_png(path: Path, image: Tensor, bits: int = 8) -> None:
    """An 8- or 16-bit PNG of display values in [0, 1] (clipped), H x W x 3 or H x W x 1."""
    write_bytes(path, encode_png(image, bits))


def encode_png(image: Tensor, bits: int = 8) -> bytes:
    """The content of the file that :func:`write_png` writes."""
    import cv2

    kind = np.uint8 if bits == 8 else np.uint16
    top = np.iinfo(kind).max
    pixels = np.rint(image.detach().clamp(0, 1).to(torch.float64).numpy() * top).astype(kind)
    ok, data = cv2.imencode(".png", np.ascontiguousarray(pixels[..., ::-1] if pixels.shape[2] == 3 else pixels))
    assert ok
    return data.tobytes()


def write_linear(stem: Path, image: Tensor, transfer: color.Transfer) -> None:
    """A linear image as ``stem.exr`` (float32) and as ``stem.png`` (8-bit display values)."""
    write_exr(stem.with_suffix(".exr"), image)
    write_png(stem.with_suffix(".png"), color.to_display(image, transfer))
