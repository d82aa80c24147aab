"""Frames as MP4 (H.264) and GIF."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

import numpy as np
from torch import Tensor

from ..errors import BackendError
from ..io import files

FPS = 24
CRF = "14"  # below what an eye sees; 18 is the usual "visually lossless"
BT709 = 1  # as matrix, primaries and transfer in ITU-T H.264, tables E-3 to E-5
PALETTE_SIZE = 256  # of a GIF's palette


def write_mp4(path: Path, frames: Iterable[Tensor]) -> None:
    """An MP4 that every player and browser shows: H.264, yuv420p, tagged as BT.709, limited range.

    yuv420p has half as many chroma as luma samples on either axis, so an odd size gets one column or row
    more, a copy of its neighbour: so nothing of the picture is lost.

    Args:
        frames: display values in [0, 1] (clipped), each H x W x 3 of the same size.

    Raises:
        BackendError: PyAV is not installed.
        OutputError: the file cannot be written.
    """
    av = av_module()
    from av.video.reformatter import ColorRange, Colorspace

    with files.atomic_write(path) as temporary, av.open(str(temporary), "w", format="mp4",
                                                        options={"movflags": "+faststart"}) as file:
        stream = file.add_stream("libx264", rate=FPS, options={"crf": CRF, "preset": "medium"})
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.color_range = ColorRange.MPEG
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.thread_count = 1  # the same file in every run
        for pixels in map(_eight_bits, frames):
            height, width = pixels.shape[:2]
            pixels = np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            if not context.is_open:
                stream.height, stream.width = pixels.shape[:2]
            file.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(
                format="yuv420p", src_colorspace=Colorspace.DEFAULT, dst_colorspace=Colorspace.ITU709,
                src_color_range=ColorRange.JPEG, dst_color_range=ColorRange.MPEG)))
        file.mux(stream.encode())


def write_gif(path: Path, frames: Iterable[Tensor]) -> None:
    """A GIF that loops, with a palette for each frame and errors diffused; arguments as :func:`write_mp4`."""
    from PIL import Image

    pictures = [Image.fromarray(_eight_bits(frame)) for frame in frames]
    # GIF counts in hundredths of a second: frames last as many as keep the whole in step.
    ends = [round(100 * k / FPS) for k in range(len(pictures) + 1)]
    first, *others = (picture.quantize(palette=picture.quantize(PALETTE_SIZE)) for picture in pictures)
    with files.atomic_write(Path(path)) as temporary:
        first.save(temporary, format="GIF", save_all=True, append_images=others, loop=0, optimize=False,
                   disposal=1, duration=[10 * (end - begin) for begin, end in zip(ends, ends[1:])])


def _eight_bits(frame: Tensor) -> np.ndarray:
    return np.rint(frame.clamp(0, 1).double().numpy() * 255).astype(np.uint8)


def av_module() -> ModuleType:
    """PyAV."""
    try:
        import av
    except ImportError:
        raise BackendError("PyAV, which writes movies", "none",
                           'pip install "mitsvbrdf[movie]", or ask for --movie gif') from None
    return av
