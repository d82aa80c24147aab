"""Movies read back by other code."""

import av
import numpy as np
import pytest
import torch
from PIL import Image

from mitsvbrdf.errors import OutputError
from mitsvbrdf.relight.frames import write_gif, write_mp4


@pytest.fixture(scope="module")
def frames():
    """Twelve frames of odd size, smooth colours that move."""
    y, x = torch.meshgrid(torch.linspace(0, 1, 63), torch.linspace(0, 1, 65), indexing="ij")
    return [torch.stack((x, y, torch.full_like(x, 0.2 + k / 20)), dim=-1) for k in range(12)]


def decoded(frame):
    """A yuv420p frame as RGB, by the equations of BT.709 with limited range."""
    def plane(k, width):
        return np.frombuffer(frame.planes[k],
                             np.uint8).reshape(-1, frame.planes[k].line_size)[:, :width].astype(float)

    luma = (plane(0, frame.width) - 16) / 219
    blue, red = ((plane(k, frame.width // 2).repeat(2, 0).repeat(2, 1) - 128) / 224 for k in (1, 2))
    kr, kb = 0.2126, 0.0722
    r, b = luma + 2 * (1 - kr) * red, luma + 2 * (1 - kb) * blue
    return np.stack((r, (luma - kr * r - kb * b) / (1 - kr - kb), b), axis=-1)


def test_mp4_holds_the_frames(tmp_path, frames):
    write_mp4(tmp_path / "a.mp4", frames)
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        assert (stream.codec.name, stream.pix_fmt, stream.average_rate) == ("h264", "yuv420p", 24)
        # BT.709
        assert (context.colorspace, context.color_range, context.color_primaries,
                context.color_trc) == (1, 1, 1, 1)
        assert (stream.width, stream.height) == (66, 64)  # one more where odd
        assert float(stream.duration * stream.time_base) == 0.5
        shown = [decoded(each) for each in container.decode(video=0)]
    assert len(shown) == 12
    for frame, seen in zip(frames, shown):
        off = seen[:63, :65] - frame.numpy()
        assert np.sqrt((off**2).mean()) < 0.012  # 0.0085 seen; with the matrix of BT.601 0.03 or more
        assert np.abs(off.mean(axis=(0, 1))).max() < 0.008  # 0.005 seen: half of it is rounding to 8 bits
        assert np.allclose(seen[63], seen[62], atol=0.06)  # the row that was added is a copy


def test_gif_holds_the_frames(tmp_path, frames):
    write_gif(tmp_path / "a.gif", iter(frames))
    with Image.open(tmp_path / "a.gif") as movie:
        assert (movie.n_frames, movie.size, movie.info["loop"]) == (12, (65, 63), 0)
        total = 0
        for number, frame in enumerate(frames):
            movie.seek(number)
            total += movie.info["duration"]
            off = np.asarray(movie.convert("RGB")) / 255 - frame.numpy()
            assert np.sqrt((off**2).mean()) < 0.03  # 0.020 seen: 256 colours, errors diffused
            assert np.abs(off.mean(axis=(0, 1))).max() < 0.004
    assert total == 500


@pytest.mark.parametrize("write", [write_mp4, write_gif])
def test_nothing_half_written_is_left(write, tmp_path, frames):
    (tmp_path / "taken").mkdir()
    with pytest.raises(OutputError):
        write(tmp_path / "taken", frames)
    assert [each.name for each in tmp_path.iterdir()] == ["taken"]
