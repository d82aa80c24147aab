"""Read and write images as tensors: PNG and JPEG in display values, EXR unchanged; RGB, row 0 at the top.

Photos with EXIF, HEIC or raw data are read by :mod:`mitsvbrdf.capture.photo`, whole sets of maps by
:mod:`mitsvbrdf.material.map_files`.
"""

import contextlib
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import OpenEXR
import torch
from torch import Tensor

from .. import color
from ..errors import MitsvbrdfError, warn_of
from .colour_profile import is_rec709, to_rec709
from .decode import check_size, header, picture, upright
from .files import atomic_write, write_bytes

BANDED = 64  # rows of a PNG that are rounded at a time
BAND = 2**22  # pixels that are averaged at a time
OUTSIDE = 1e-4  # of the brightest value; colours outside of Rec. 709 by less are rounding errors
# Names of a picture's channels; vectors, such as a renderer's normals, have X, Y, Z. Alpha and depth are not
# read.
SETS = ("RGB", "rgb", "XYZ", "xyz", "RG", "XY", "Y", "V", "R")
T = TypeVar("T")
MAIN = "Combined"  # the layer in which Blender stores the picture itself


def read_image(path: Path, error: type[MitsvbrdfError], data: bool = False, alpha: bool = False) -> Tensor:
    """An image file as float32 H x W x C, row 0 at the top, RGB order, turned upright by its EXIF.

    8- and 16-bit files give display values in [0, 1]. EXR files give their values unchanged, in one to three
    channels (:func:`read_exr`). Colours of other spaces are converted to sRGB or Rec. 709.

    Args:
        error: the error to raise if the file is missing or unreadable.
        data: the values are no colours (roughness, normals), and are not converted.
        alpha: whether to read only the alpha channel; otherwise it is dropped.

    Warns:
        InputWarning: a damaged JPEG (see :func:`~mitsvbrdf.io.decode.picture`); colours outside of sRGB,
            moved to its edge; a colour profile that cannot be used.
    """
    path = Path(path)
    if path.suffix.lower() == ".exr" and not alpha:
        linear = torch.from_numpy(read_exr(path, error))
        return linear if data or linear.shape[2] != 3 else _in_rec709(linear, path, error)
    about = header(path, error)
    found = picture(path, error, data)
    if about.profile and about.profile.reason and not data:
        warn_of(f": {about.profile.name} cannot be used ({about.profile.reason}); the values are taken as "
                "sRGB; export it as sRGB", path)
    _warn_outside(path, found.outside)
    pixels = found.alpha if alpha else found.pixels
    if pixels is None:
        raise error("a map in the alpha channel, as the name says", f"{path} without alpha",
                    "name the file for the one map that it holds")
    return torch.from_numpy(np.atleast_3d(display(upright(pixels, about.orientation))))


def read_exr(path: Path, error: type[MitsvbrdfError]) -> np.ndarray:
    """An EXR's display window, H x W x C (1 to 3), contiguous float32; 0 where the file has no pixels.

    The channels are R, G, B, or X, Y, Z, or one or two of these, at the top level or in one layer. ``error``
    is raised if the file is missing, damaged or too large, or if it is unclear which picture to read.
    """
    if not path.is_file():
        raise error("an image file", f"no file at {path}", "check the name")
    try:
        parts = OpenEXR.File(str(path), header_only=True).parts
        kinds = [str(part.header["type"]) for part in parts]
        if len(parts) > 1 or "deep" in kinds[0].lower():
            raise error("an EXR of one flat picture", f"{path} of {len(parts)} parts ({', '.join(kinds)})",
                        "export it flat")
        shown, held = (_box(parts[0].header[name]) for name in ("displayWindow", "dataWindow"))
        for (top, left), (bottom, right) in (shown, held):
            check_size(path, (right - left, bottom - top), error)
        header = {channel.name: channel for channel in parts[0].header["channels"]}
        names = _picture(list(header), path, error)
        if any((header[name].xSampling, header[name].ySampling) != (1, 1) for name in names):
            raise error("an EXR with whole channels", f"{path} with {'/'.join(names)} at half resolution",
                        "export it as R, G, B")
        pixels = _together(path) if set("RGB") <= set(header) <= set("RGBA") else None
        if pixels is None:
            channels = OpenEXR.File(str(path), separate_channels=True).channels()
            pixels = np.stack([channels[name].pixels for name in names], axis=-1)
    except MitsvbrdfError:
        raise
    except Exception as reason:  # OpenEXR raises plain RuntimeError and others
        raise error("a readable EXR file", f"{path}: {reason}", "export it again") from None
    return _within(np.require(pixels, np.float32, ["C", "W"]), held, shown)


def _together(path: Path) -> np.ndarray | None:
    """Red, green and blue as one array; None if the channels, alpha included, differ in data type."""
    with contextlib.suppress(Exception):  # OpenEXR raises several kinds
        (channel,) = OpenEXR.File(str(path)).channels().values()
        return channel.pixels[..., :3]
    return None


Box = tuple[tuple[int, int], tuple[int, int]]  # first row and column; row and column after the last


def _box(window: Any) -> Box:
    (left, top), (right, bottom) = ([int(x) for x in corner] for corner in window)
    return (top, left), (bottom + 1, right + 1)


def _within(pixels: np.ndarray, held: Box, shown: Box) -> np.ndarray:
    """The part of ``pixels`` (window ``held``) in the window ``shown``; 0 where there are no pixels."""
    if held == shown:
        return pixels
    out = np.zeros((*(b - a for a, b in zip(*shown)), pixels.shape[2]), np.float32)
    first, last = np.maximum(held[0], shown[0]), np.minimum(held[1], shown[1])
    if (first < last).all():
        there, here = (tuple(slice(a, b) for a, b in zip(first - corner[0], last - corner[0]))
                       for corner in (shown, held))
        out[there] = pixels[here]
    return out


def _picture(names: Sequence[str], path: Path, error: type[MitsvbrdfError]) -> list[str]:
    """The picture's channels: those at the top level or in :data:`MAIN`, else in the only layer with any."""
    layers: dict[str, list[str]] = {}
    for name in names:
        layer, _, channel = name.rpartition(".")
        layers.setdefault(layer, []).append(channel)
    found = {layer: next(list(wanted) for wanted in SETS if set(wanted) <= set(channels))
             for layer, channels in layers.items() if any(set(wanted) <= set(channels) for wanted in SETS)
             and "RY" not in channels}  # with RY and BY (colour), Y is only luminance
    if not found and len(names) == 1:
        return list(names)
    main = [layer for layer in found if layer in ("", MAIN) or layer.endswith(f".{MAIN}")] or list(found)
    if len(main) != 1:
        raise error("an EXR with R, G, B or one channel" if not main else "an EXR of one picture",
                    f"{path} with {sorted(names)}", "export the layer that is meant alone")
    return [f"{main[0]}.{channel}" if main[0] else channel for channel in found[main[0]]]


def _in_rec709(linear: Tensor, path: Path, error: type[MitsvbrdfError]) -> Tensor:
    """Convert an EXR's pixels from the chromaticities in its header to Rec. 709."""
    stated = OpenEXR.File(str(path), header_only=True).parts[0].header.get("chromaticities")
    if stated is None or is_rec709(stated):
        return linear
    try:
        pixels = to_rec709(linear.numpy(), stated)
    except ValueError as reason:
        raise error("chromaticities of a colour space", f"{path}: {reason}", "export as Rec. 709") from None
    kept = pixels.clip(0, 1 if linear.max() <= 1 else None)
    _warn_outside(path, float((np.abs(kept - pixels) > OUTSIDE * pixels.max()).any(axis=-1).mean()))
    return torch.from_numpy(kept)


def _warn_outside(path: Path, share: float) -> None:
    if share > 0:
        warn_of(f": {share:.2%} of the pixels have colours outside of sRGB, which were moved to its edge",
                path, stacklevel=3)


def display(pixels: np.ndarray) -> np.ndarray:
    """8- or 16-bit pixels as display values in [0, 1], float32 pixels unchanged; contiguous float32."""
    if pixels.dtype == np.float32:
        return np.ascontiguousarray(pixels)
    return np.divide(pixels, np.float32(np.iinfo(pixels.dtype).max), dtype=np.float32, order="C")


def averaged(pixels: np.ndarray, side: int) -> np.ndarray:
    """A square picture (S x S x 3, 8 or 16 bits or float32), averaged to display values, ``side`` a side.

    To need little memory, it is averaged in bands of whole rows of the result.
    """
    import cv2

    height, width = pixels.shape[:2]
    if side == height:
        return display(pixels)
    unit = height // math.gcd(height, side)
    rows = unit * max(1, BAND // (unit * width))
    out = np.empty((side, side, 3), np.float32)
    for first in range(0, height, rows):
        band = display(pixels[first:first + rows])
        begin, end = first * side // height, (first + len(band)) * side // height
        out[begin:end] = cv2.resize(band, (side, end - begin), interpolation=cv2.INTER_AREA)
    return out


def hide(photo: np.ndarray, shown: np.ndarray) -> None:
    """Set a pixel of an averaged photo (S x S x 3) to NaN if it covers a pixel that is False in ``shown``."""
    import cv2

    photo[cv2.resize((~shown).astype(np.float32), photo.shape[:2], interpolation=cv2.INTER_AREA) > 0] = np.nan


def write_all(writes: Sequence[Callable[[], T]]) -> list[T]:
    """Call functions that write files in parallel, as compression is slow. The first error is raised."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return [done.result() for done in [pool.submit(write) for write in writes]]


def write_exr(path: Path, image: Tensor) -> None:
    """Write an H x W x 3 (R, G, B) or H x W x 1 (Y) tensor as a ZIP-compressed float32 EXR."""
    pixels = np.ascontiguousarray(image.detach().to(torch.float32).numpy())
    write_channels(path, {"RGB": pixels} if pixels.shape[2] == 3 else {"Y": pixels[..., 0]})


def write_channels(path: Path, channels: Mapping[str, np.ndarray]) -> None:
    """Write named channels as a ZIP-compressed EXR."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    with atomic_write(path) as temporary:
        try:
            OpenEXR.File(header, planes).write(str(temporary))
        except RuntimeError as reason:  # a full disk, say; then this write raises its OSError
            temporary.write_bytes(b"".join(map(bytes, channels.values())))
            raise OSError(str(reason)) from None


def write_png(path: Path, image: Tensor, bits: int = 8, shown: Callable[[Tensor], Tensor] = Tensor.detach
              ) -> None:
    """Write display values in [0, 1] (clipped), H x W x 1, 3 or 4 (alpha), as an 8- or 16-bit PNG.

    ``shown`` converts rows of the image to display values.
    """
    write_bytes(path, encode_png(image, bits, shown))


def encode_png(image: Tensor, bits: int = 8, shown: Callable[[Tensor], Tensor] = Tensor.detach) -> bytes:
    """The content of the file that :func:`write_png` writes."""
    import cv2

    kind = np.uint8 if bits == 8 else np.uint16
    pixels, count = np.empty(tuple(image.shape), kind), image.shape[2]
    order = [2, 1, 0, 3][:count] if count > 1 else [0]
    for first in range(0, len(image), BANDED):
        rows = shown(image.detach()[first:first + BANDED]).clamp(0, 1).to(torch.float64).numpy()
        pixels[first:first + BANDED, :, order] = np.rint(rows * np.iinfo(kind).max)
    return cv2.imencode(".png", pixels)[1].tobytes()


def linear_writes(stem: Path, image: Tensor, transfer: color.Transfer) -> list[Callable[[], None]]:
    """Functions that write an image as ``stem.exr`` (linear, float32) and ``stem.png`` (display, 8-bit)."""
    return [partial(write_exr, stem.with_suffix(".exr"), image),
            partial(write_png, stem.with_suffix(".png"), image,
                    shown=partial(color.to_display, transfer=transfer))]
