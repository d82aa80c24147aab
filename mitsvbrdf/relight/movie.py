"""Frames as MP4 (H.264) and GIF."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from ..errors import BackendError, MapsError
from ..io import files

CRF = "14"  # below what an eye sees; 18 is the usual "visually lossless"
BT709 = 1  # as matrix, primaries and transfer in ITU-T H.264, tables E-3 to E-5
PALETTE_SIZE = 256  # of a GIF's palette


def write_mp4(path: str | Path, frames: Iterable[Tensor], fps: float) -> None:
    """An MP4 that every player and browser shows: H.264, yuv420p, tagged as BT.709, limited range.

    yuv420p has half as many chroma as luma samples on either axis, so an odd size gets one column or row
    more, a copy of its neighbour: so nothing of the picture is lost.

    Args:
        path: the file to write or replace.
        frames: display values in [0, 1] (clipped), each H x W x 3 of the same size.
        fps: frames a second.

    Raises:
        BackendError: PyAV is not installed.
        MapsError: no frame, or frames of different size.
        OutputError: the file cannot be written.
    """
    av = av_module()
    from av.video.reformatter import ColorRange, Colorspace

    with files.atomic_write(Path(path)) as temporary, av.open(str(temporary), "w", format="mp4",
                                                              options={"movflags": "+faststart"}) as file:
        stream = file.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001),
                                 options={"crf": CRF, "preset": "medium"})
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.color_range = ColorRange.MPEG
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.thread_count = 1  # the same file in every run
        for pixels in _eight_bits(frames):
            height, width = pixels.shape[:2]
            pixels = np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            if not context.is_open:
                stream.height, stream.width = pixels.shape[:2]
            file.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(
                format="yuv420p", src_colorspace=Colorspace.DEFAULT, dst_colorspace=Colorspace.ITU709,
                src_color_range=ColorRange.JPEG, dst_color_range=ColorRange.MPEG)))
        file.mux(stream.encode())


def write_gif(path: str | Path, frames: Iterable[Tensor], fps: float) -> None:
    """A GIF that loops, with a palette for each frame and errors diffused.

    GIF counts in hundredths of a second: frames last as many as keep the whole in step with ``fps``, at least
    two each, since browsers slow down shorter ones.

    Args:
        path: the file to write or replace.
        frames: display values in [0, 1] (clipped), each H x W x 3 of the same size.
        fps: frames a second.

    Raises:
        MapsError: no frame, or frames of different size.
        OutputError: the file cannot be written.
    """
    from PIL import Image

    pictures = [Image.fromarray(pixels) for pixels in _eight_bits(frames)]
    first, *others = (picture.quantize(palette=picture.quantize(PALETTE_SIZE)) for picture in pictures)
    with files.atomic_write(Path(path)) as temporary:
        first.save(temporary, format="GIF", save_all=True, append_images=others, loop=0, optimize=False,
                   disposal=1, duration=durations(len(pictures), fps))


def durations(count: int, fps: float) -> list[int]:
    """Milliseconds of each frame of a GIF, multiples of ten."""
    ends = [round(100 * (k + 1) / fps) for k in range(count)]
    return [10 * max(end - before, 2) for before, end in zip([0, *ends], ends)]


def _eight_bits(frames: Iterable[Tensor]) -> Iterator[np.ndarray]:
    size = None
    for frame in frames:
        size = size or frame.shape
        if frame.shape != size or len(size) != 3 or size[2] != 3:
            raise MapsError(f"frames of H x W x 3, all alike, here {tuple(size)}", str(tuple(frame.shape)),
                            "render them anew")
        yield np.rint(frame.detach().clamp(0, 1).to(torch.float64).numpy() * 255).astype(np.uint8)
    if size is None:
        raise MapsError("at least one frame", "none", "render some first")


def av_module() -> ModuleType:
    """PyAV.

    Raises:
        BackendError: it is not installed.
    """
    try:
        import av
    except ImportError:
        raise BackendError("PyAV, which writes movies", "none",
                           'pip install "mitsvbrdf[movie]", or ask for --movie gif') from None
    return av
