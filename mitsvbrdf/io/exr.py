"""EXR files to pixels: which channels are the picture, and which part of them the display window shows."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import MitsvbrdfError
from .decode import check_size

# What a picture's channels are called; vectors, such as a renderer's normals, have X, Y, Z. Alpha and depth
# are not read.
SETS = ("RGB", "rgb", "XYZ", "RG", "XY", "Y", "V", "R")
MAIN = "Combined"  # layer of Blender's that holds the picture itself


def read_exr(path: Path, error: type[MitsvbrdfError]) -> np.ndarray:
    """What an EXR's display window shows: H x W x 3, 2 or 1, contiguous float32; 0 where it has no pixels.

    The picture is R, G, B, or X, Y, Z, or two or one of them, at the top level or in a layer of its own.

    Raises:
        MitsvbrdfError: as ``error``: the file is missing, damaged or too large, or leaves open which picture.
    """
    import OpenEXR

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
    return _within(np.array(pixels, dtype=np.float32, order="C"), held, shown)


def _together(path: Path) -> np.ndarray | None:
    """Red, green and blue in one piece; None where they, or alpha, differ in kind."""
    import OpenEXR

    with contextlib.suppress(Exception):  # of whatever kind OpenEXR's is
        (channel,) = OpenEXR.File(str(path)).channels().values()
        return channel.pixels[..., :3]
    return None


Box = tuple[tuple[int, int], tuple[int, int]]  # first row and column, and those after the last


def _box(window: Any) -> Box:
    (left, top), (right, bottom) = ([int(x) for x in corner] for corner in window)
    return (top, left), (bottom + 1, right + 1)


def _within(pixels: np.ndarray, held: Box, shown: Box) -> np.ndarray:
    """Pixels of the window ``held``, as the window ``shown`` has them: cut, and 0 where there are none."""
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
    """The channels of the picture: those of the top level, else of the one layer that has some."""
    layers: dict[str, list[str]] = {}
    for name in names:
        layer, _, channel = name.rpartition(".")
        layers.setdefault(layer, []).append(channel)
    found = {layer: next(list(wanted) for wanted in SETS if set(wanted) <= set(channels))
             for layer, channels in layers.items() if any(set(wanted) <= set(channels) for wanted in SETS)}
    if not found and len(names) == 1:
        return list(names)
    main = [layer for layer in found if layer in ("", MAIN) or layer.endswith(f".{MAIN}")] or list(found)
    if len(main) != 1:
        raise error("an EXR with R, G, B or one channel" if not main else "an EXR of one picture",
                    f"{path} with {sorted(names)}", "export the layer that is meant alone")
    return [f"{main[0]}.{channel}" if main[0] else channel for channel in found[main[0]]]
