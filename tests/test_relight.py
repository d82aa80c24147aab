"""Renders in passes: their error against repeated renders, limits, going on, movies read back by other code; off-axis light."""

import contextlib
import errno
import json
import math
import os
import re
import signal
import sys
import time

import av
import numpy as np
import pytest
import torch
from PIL import Image

from mitsvbrdf.cli.relight import relight
from mitsvbrdf.errors import BackendError, ConfigError, MapsError, MitsvbrdfError, OutputError
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.relight import frames as frames_module
from mitsvbrdf.relight import make_stage
from mitsvbrdf.relight.check import check_novel
from mitsvbrdf.relight.curve import error_curve
from mitsvbrdf.relight.movie import durations, write_gif, write_mp4
from mitsvbrdf.relight.passes import GroupedMean, Stop, one_sample, render_frame, render_passes
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.render.llvm import mitsuba_module
from mitsvbrdf.render.needs import Needs
from mitsvbrdf.system import images, result_folder


def srgb(x):
    x = np.asarray(x, dtype=np.float64)
    return np.clip(np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055), 0, 1)


def rmse(a, b):
    return float(np.sqrt(np.mean((srgb(a) - srgb(b)) ** 2)))


@pytest.fixture(scope="module")
def mi():
    return mitsuba_module()


@pytest.fixture(scope="module")
def scenes(mi):
    """Small frames of three presets; leather shows highlights, clipped ones too."""
    material = make_material("leather", 64)
    kinds = {"sphere": "studio", "turntable": "studio", "sweep": "none"}
    return {name: make_stage(mi, material, name, environment=environment, size=(48, 48), frames=4).at(mi, 1)
            for name, environment in kinds.items()}


# The error of a frame

@pytest.mark.parametrize("preset", ["sweep", *(pytest.param(each, marks=pytest.mark.slow) for each in ("turntable", "sphere"))])
def test_estimated_error_is_the_scatter_of_repeated_renders(mi, scenes, preset):
    truth = render_frame(mi, scenes[preset], Stop(samples=2048), seed=99).image.numpy()
    for samples in (8, 32):
        renders = [render_frame(mi, scenes[preset], Stop(samples=samples), seed=seed) for seed in range(6)]
        true = math.sqrt(np.mean([rmse(each.image.numpy(), truth) ** 2 for each in renders]))
        estimated = math.sqrt(np.mean([each.error ** 2 for each in renders]))
        # 0.97 to 1.04 seen; the few pixels at the edge of a patch that is swept scatter most
        assert estimated == pytest.approx(true, rel=0.12)


def test_estimate_knows_clipping_and_the_dark():
    # A pixel that is dark but for one sample in 32 that is 100 times too bright for the display; others near black.
    noise = np.random.default_rng(3)

    def draw(call, samples):
        rare = (noise.random((samples, 96, 96, 1)) < 1 / 32) * 100.0
        dark = noise.exponential(0.002, (samples, 96, 96, 1))
        return torch.from_numpy(np.concatenate((rare, dark, dark), axis=-1).mean(axis=0)).float()

    truth = np.broadcast_to([100 / 32, 0.002, 0.002], (96, 96, 3))
    found = render_passes(draw, Stop(samples=32), pixels=96 * 96)
    # 0.97 to 0.99 in four runs; half the difference of two halves of 16 samples gives 0.57 to 0.58
    assert found.error == pytest.approx(rmse(found.image.numpy(), truth), rel=0.06)


@pytest.mark.parametrize("counts", [(1, 1, 1, 1), (4, 4, 4, 4, 4, 4, 4, 4), (7, 1, 2, 4, 8, 1, 1, 1)])
def test_groups_of_any_size_give_the_standard_error_of_a_mean(counts):
    # Mid-grey with little noise: there display values are as good as linear, and the textbook's sigma / sqrt(n) holds.
    torch.manual_seed(1)
    mean, sigma = GroupedMean(), 0.004
    for count in counts:
        mean.add(0.5 + sigma / math.sqrt(count) * torch.randn(200, 200, 3), count)
    slope = 1.055 / 2.4 * 0.5 ** (1 / 2.4 - 1)  # of the sRGB curve at 0.5
    assert mean.samples == sum(counts)
    assert mean.error() == pytest.approx(slope * sigma / math.sqrt(sum(counts)), rel=0.02)  # 0.3 to 1.1 % seen


def test_mean_is_that_of_all_samples():
    pictures = [torch.rand(5, 4, 3, generator=torch.Generator().manual_seed(k)) for k in range(12)]
    mean = GroupedMean()
    for k, picture in enumerate(pictures):
        mean.add(picture, 1 + k % 3)
    weights = [1 + k % 3 for k in range(12)]
    expected = sum(w * p.double() for w, p in zip(weights, pictures)) / sum(weights)
    assert torch.allclose(mean.image.double(), expected, atol=1e-6)


def test_exposure_counts_in_the_error():
    torch.manual_seed(2)
    mean = GroupedMean()
    for _ in range(8):
        mean.add(0.01 + 0.001 * torch.randn(100, 100, 3), 1)
    brighter = GroupedMean()
    for one in mean.sums:
        brighter.add(one * 8, 1)
    assert mean.error(exposure=3) == pytest.approx(brighter.error(), rel=1e-6)
    assert mean.error(exposure=3) > 1.5 * mean.error()
    assert mean.error(exposure=12) == 0  # all white


@pytest.mark.parametrize("preset", ["sphere", "turntable"])
def test_target_is_met_and_not_by_far(mi, scenes, preset):
    truth = render_frame(mi, scenes[preset], Stop(samples=4096), seed=99).image.numpy()
    found = render_frame(mi, scenes[preset], Stop(target_error=0.02), seed=1)
    assert found.stopped == "target"
    assert 0.85 * 0.02 <= found.error <= 0.02  # the next sample was needed: 0.95 to 1.0 seen
    assert rmse(found.image.numpy(), truth) == pytest.approx(0.02, rel=0.2)  # 0.93 to 1.05 seen


def test_one_sample_that_is_enough_is_noticed():
    picture = torch.full((8, 8, 3), 0.4)
    found = render_passes(lambda call, samples: picture, Stop(target_error=0.01), pixels=64)
    assert found.samples == 2 and found.error == one_sample(found.curve) == 0 and torch.equal(found.image, picture)


# Limits

def test_number_of_samples_is_kept_and_calls_are_independent():
    calls = []

    def draw(call, samples):
        calls.append((call, samples))
        return torch.zeros(4, 4, 3)

    for wanted in (1, 2, 3, 8, 37, 100):
        calls.clear()
        found = render_passes(draw, Stop(samples=wanted), pixels=16)
        assert found.samples == wanted == sum(count for _, count in calls) and found.stopped == "samples"
        assert [call for call, _ in calls] == list(range(len(calls)))  # no random numbers twice
        assert all(count & (count - 1) == 0 for _, count in calls)  # powers of two: one kernel
        assert (found.error is None) == (wanted == 1)


def test_all_numbers_of_samples_share_one_kernel(mi, scenes):
    import drjit as dr
    render_frame(mi, scenes["sphere"], Stop(samples=2))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        render_frame(mi, scenes["sphere"], Stop(samples=93), seed=5)
        kernels = [each for each in dr.kernel_history() if each["type"] == dr.KernelType.JIT]
    assert len(kernels) > 8 and all(each["cache_hit"] for each in kernels)


def test_budget_is_kept_to_a_pass():
    clock = []

    def draw(call, samples):
        time.sleep(0.002 * samples)
        clock.append(time.perf_counter())
        return torch.rand(8, 8, 3)

    found = render_passes(draw, Stop(budget=0.3), pixels=64)
    ends = [each - clock[0] for each in clock]
    longest = max(b - a for a, b in zip(ends, ends[1:]))
    assert found.stopped == "budget" and found.samples > 8
    assert found.curve[-1]["samples"] == found.samples
    assert ends[-2] <= 0.3 and ends[-1] <= 0.3 + longest  # what was begun before the time was over, not more


@pytest.mark.parametrize("wrong", [{"target_error": 0.1, "samples": 3}, {"budget": 1, "samples": 1}, {"target_error": 0.0},
                                   {"target_error": 1.0}, {"budget": 0.0}, {"budget": math.nan}, {"samples": 0}])
def test_limits_that_are_none(wrong):
    with pytest.raises(ConfigError):
        Stop(**wrong)


def test_radiance_that_is_not_finite_is_refused():
    with pytest.raises(MapsError, match="NaN"):
        render_passes(lambda call, samples: torch.tensor([math.nan]).expand(4, 4, 3), Stop(samples=4), pixels=16)


# Movies, read back by PyAV and pillow

@pytest.fixture(scope="module")
def frames():
    """Twelve frames of odd size, smooth colours that move."""
    y, x = torch.meshgrid(torch.linspace(0, 1, 63), torch.linspace(0, 1, 65), indexing="ij")
    return [torch.stack((x, y, torch.full_like(x, 0.2 + k / 20)), dim=-1) for k in range(12)]


def decoded(frame):
    """A yuv420p frame as RGB, by the equations of BT.709 with limited range."""
    def plane(k, width):
        return np.frombuffer(frame.planes[k], np.uint8).reshape(-1, frame.planes[k].line_size)[:, :width].astype(float)

    luma = (plane(0, frame.width) - 16) / 219
    blue, red = ((plane(k, frame.width // 2).repeat(2, 0).repeat(2, 1) - 128) / 224 for k in (1, 2))
    kr, kb = 0.2126, 0.0722
    r, b = luma + 2 * (1 - kr) * red, luma + 2 * (1 - kb) * blue
    return np.stack((r, (luma - kr * r - kb * b) / (1 - kr - kb), b), axis=-1)


def test_mp4_holds_the_frames(tmp_path, frames):
    write_mp4(tmp_path / "a.mp4", frames, 24)
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        assert (stream.codec.name, stream.pix_fmt, stream.average_rate) == ("h264", "yuv420p", 24)
        assert (context.colorspace, context.color_range, context.color_primaries, context.color_trc) == (1, 1, 1, 1)  # BT.709
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
    write_gif(tmp_path / "a.gif", iter(frames), 24)
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


def test_durations_keep_in_step():
    for fps, count in ((24, 48), (30, 7), (12.5, 20), (60, 9)):
        made = durations(count, fps)
        if fps < 50:
            assert all(abs(sum(made[:k]) - 1000 * k / fps) <= 5 for k in range(1, count + 1))
        assert min(made) >= 20 and all(each % 10 == 0 for each in made)


def test_movies_refuse_what_is_none(tmp_path, frames):
    for write, name in ((write_mp4, "a.mp4"), (write_gif, "a.gif")):
        with pytest.raises(MapsError):
            write(tmp_path / name, [], 24)
        with pytest.raises(MapsError):
            write(tmp_path / name, [frames[0], frames[1][1:]], 24)
        (tmp_path / "taken").mkdir(exist_ok=True)
        with pytest.raises(OutputError):
            write(tmp_path / "taken", frames, 24)
    assert [each.name for each in tmp_path.iterdir()] == ["taken"]  # nothing half written


# The command

SMALL = {"size": "24", "samples": 4}


def run(out, **options):
    return relight("builtin:leather", out=out, **(SMALL | options))


def pictures(out, preset):
    return [images.read_image(path, MitsvbrdfError) for path in sorted((out / preset).glob("*.exr"))]


def record(out):
    return json.loads((out / "relight.json").read_text())


def test_stills_open_elsewhere(tmp_path, capsys):
    assert relight("builtin:plates", out=tmp_path / "o", size="40x24", target_error=0.05, exposure=1.0) == 0
    linear = images.read_image(tmp_path / "o" / "sphere.exr", MitsvbrdfError).numpy()
    with Image.open(tmp_path / "o" / "sphere.png") as image:
        assert image.size == (40, 24) and image.mode == "RGB"
        assert np.abs(np.asarray(image) / 255 - srgb(2 * linear)).max() <= 0.51 / 255  # exposed by one stop; rounded
    said = capsys.readouterr().out
    frame, = record(tmp_path / "o")["presets"]["sphere"]["frames"]
    assert frame["error"] <= 0.05 and f"{frame['samples']} samples a pixel, estimated error {frame['error']:.4f}" in said
    assert "polyline" in (tmp_path / "o" / "sphere.svg").read_text() or "<path" in (tmp_path / "o" / "sphere.svg").read_text()


class StopAfter(list):
    """Asks for an end once it has been looked at so many times."""

    def __init__(self, looks):
        super().__init__()
        self.looks = looks

    def __bool__(self):
        self.looks -= 1
        return self.looks < 0


def test_resumed_frames_are_those_of_an_uninterrupted_run(tmp_path, monkeypatch, capsys):
    options = {"preset": "sphere,sweep", "frames": 3, "movie": "mp4,gif"}
    assert run(tmp_path / "whole", **options) == 0
    with monkeypatch.context() as patch:
        patch.setattr(sys.modules[relight.__module__], "stop_signals", lambda: contextlib.nullcontext(StopAfter(5 * 4 + 2)))
        assert run(tmp_path / "parts", **options) == 0
    assert "--resume" in capsys.readouterr().out
    begun = record(tmp_path / "parts")["presets"]
    assert len(begun["sphere"]["frames"]) == 3 and (tmp_path / "parts" / "sphere.mp4").is_file()
    assert [frame["stopped"] for frame in begun["sweep"]["frames"]] == ["samples", "interrupted"]
    assert len(pictures(tmp_path / "parts", "sweep")) == 2  # the one at hand as it was
    assert not (tmp_path / "parts" / "sweep.mp4").exists()
    first = (tmp_path / "parts" / "sphere" / "0000.exr").stat().st_mtime_ns
    with pytest.raises(ConfigError, match="size"):
        run(tmp_path / "parts", resume=True, **options | {"size": "25"})
    assert run(tmp_path / "parts", resume=True, **options) == 0
    assert (tmp_path / "parts" / "sphere" / "0000.exr").stat().st_mtime_ns == first  # not rendered again
    for preset in ("sphere", "sweep"):
        made, expected = pictures(tmp_path / "parts", preset), pictures(tmp_path / "whole", preset)
        assert len(made) == len(expected) == 3
        for a, b in zip(made, expected):
            assert torch.allclose(a, b, rtol=1e-5, atol=1e-7)  # threads may add in another order
        assert not torch.allclose(expected[0], expected[1], rtol=0.01)
        for kind in ("mp4", "gif"):
            assert (tmp_path / "parts" / f"{preset}.{kind}").is_file()
    assert not list(tmp_path.rglob(".partial"))


def test_a_killed_run_goes_on_from_its_partial_folder(tmp_path):
    options = {"preset": "sweep", "frames": 2, "movie": "none"}
    run(tmp_path / "whole", **options)
    partial = result_folder.partial_folder(tmp_path / "killed")
    (partial / "sweep").mkdir(parents=True)
    found = record(tmp_path / "whole")
    found["presets"]["sweep"]["frames"].pop()
    (partial / "relight.json").write_text(json.dumps(found))
    marked = torch.full((24, 24, 3), 0.25)
    images.write_exr(partial / "sweep" / "0000.exr", marked)
    run(tmp_path / "killed", resume=True, **options)
    kept, made = pictures(tmp_path / "killed", "sweep")
    assert torch.equal(kept, marked) and torch.allclose(made, pictures(tmp_path / "whole", "sweep")[1], rtol=1e-5, atol=1e-7)


def test_ctrl_c_ends_well(tmp_path, monkeypatch, capsys):
    def pressed(*arguments, **options):
        signal.raise_signal(signal.SIGINT)
        return render_frame(*arguments, **options)

    monkeypatch.setattr(frames_module, "render_frame", pressed)
    assert run(tmp_path / "o", preset="sphere", samples=None, target_error=1e-5) == 0
    frame, = record(tmp_path / "o")["presets"]["sphere"]["frames"]
    assert frame["stopped"] == "interrupted"
    assert (tmp_path / "o" / "sphere.png").is_file() and (tmp_path / "o" / "sphere.svg").is_file()
    assert "interrupted" in capsys.readouterr().out


def test_ctrl_c_while_a_frame_is_written_is_heard(tmp_path, monkeypatch):
    def pressed(*arguments):
        signal.raise_signal(signal.SIGINT)
        return write_exr(*arguments)

    write_exr = images.write_exr
    monkeypatch.setattr(images, "write_exr", pressed)
    run(tmp_path / "o", preset="sweep", frames=2)
    frame, = record(tmp_path / "o")["presets"]["sweep"]["frames"]
    assert frame["stopped"] == "samples"  # it was whole


def test_an_end_before_the_next_frame_loses_none(tmp_path, monkeypatch):
    options = {"preset": "sweep", "frames": 2, "movie": "none"}
    run(tmp_path / "o", **options)
    with monkeypatch.context() as patch:
        patch.setattr(sys.modules[relight.__module__], "stop_signals", lambda: contextlib.nullcontext(StopAfter(0)))
        run(tmp_path / "o", resume=True, **options | {"preset": "sweep,sphere"})
    assert len(pictures(tmp_path / "o", "sweep")) == len(record(tmp_path / "o")["presets"]["sweep"]["frames"]) == 2
    run(tmp_path / "o", resume=True, **options | {"preset": "sweep,sphere"})
    assert len(record(tmp_path / "o")["presets"]["sphere"]["frames"]) == 2


def test_a_run_goes_on_only_with_what_it_had(tmp_path, monkeypatch):
    options = {"preset": "sphere", "out": tmp_path / "o", "environment": str(tmp_path / "sky.exr"), **SMALL}
    save_maps(make_material("leather", 8), tmp_path / "m")
    images.write_exr(tmp_path / "sky.exr", torch.ones(4, 8, 3))
    relight(str(tmp_path / "m"), **options)

    def refused(error, why):
        with pytest.raises(error, match=why):
            relight(str(tmp_path / "m"), resume=True, **options)
        assert not result_folder.partial_folder(tmp_path / "o").exists() and (tmp_path / "o" / "sphere.png").is_file()

    with monkeypatch.context() as patch:  # no mistake of the record
        patch.setattr(frames_module.shutil, "copy2", raises(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))))
        refused(OutputError, "No space left")
    relight(str(tmp_path / "m"), resume=True, **options)
    images.write_exr(tmp_path / "sky.exr", torch.ones(5, 8, 3))
    refused(ConfigError, "another environment_file")
    images.write_exr(tmp_path / "sky.exr", torch.ones(4, 8, 3))
    save_maps(make_material("plates", 8), tmp_path / "m")
    refused(ConfigError, "another material")
    save_maps(make_material("leather", 8), tmp_path / "m")
    (tmp_path / "o" / "sphere.exr").unlink()
    refused(ConfigError, "without sphere.exr")


def raises(error):
    def function(*_):
        raise error
    return function


def test_explain_renders_nothing(tmp_path, capsys):
    assert run(tmp_path / "o", preset="all", explain=True) == 0
    said = capsys.readouterr().out
    assert re.search(r"^sphere leaves out: .+ \(.+\)$", said, re.MULTILINE) and not (tmp_path / "o").exists()


@pytest.mark.parametrize("wrong", [{"target_error": 0.1}, {"size": "2"}, {"size": "100000"}, {"size": "3x4x5"}, {"size": "big"},
                                   {"preset": "cube"}, {"movie": "avi"}, {"exposure": 99.0}, {"frames": 0}, {"tiling": 0},
                                   {"environment": "no-such.exr"}, {"environment": ""}, {"seed": -1}, {"out": None},
                                   {"resume": True}])
def test_wrong_options_are_one_error_and_leave_nothing(tmp_path, wrong):
    with pytest.raises(MitsvbrdfError):
        run(**({"out": tmp_path / "o"} | wrong))
    assert not (tmp_path / "o").exists()


def test_movies_without_pyav_are_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(BackendError, match="pip install av"):
        run(tmp_path / "o", preset="sweep", frames=2)
    assert not (tmp_path / "o").exists()
    assert run(tmp_path / "o", preset="sweep", frames=2, movie="gif") == 0 and (tmp_path / "o" / "sweep.gif").is_file()


def test_budget_is_for_all_frames_together(tmp_path):
    run(tmp_path / "o", preset="sweep", frames=3, movie="none", samples=None, budget=1.5)
    frames = record(tmp_path / "o")["presets"]["sweep"]["frames"]
    assert [frame["stopped"] for frame in frames] == ["budget"] * 3 and all(frame["curve"] for frame in frames)


def test_one_sample_is_too_few_to_estimate_its_error(tmp_path, capsys):
    run(tmp_path / "o", preset="sphere", samples=1)
    assert "1 sample a pixel, too few to estimate the error" in capsys.readouterr().out
    assert record(tmp_path / "o")["presets"]["sphere"]["frames"][0]["error"] is None


# Pictures of renders

def test_error_curve_shows_target_and_frames(tmp_path):
    curve = [{"seconds": 0.5 * 2**k, "samples": 2**k, "error": 0.1 / 2 ** (k / 2)} for k in range(6)]
    error_curve(tmp_path / "a.svg", [curve, curve[1:]], 0.02, "two")
    text = (tmp_path / "a.svg").read_text()
    assert "target 0.02" in text and "2 frames" in text and "seconds</text>" in text and "two" in text
    error_curve(tmp_path / "b.svg", [curve, curve[1:]], 0.02, "two")
    assert (tmp_path / "b.svg").read_bytes() == (tmp_path / "a.svg").read_bytes()
    error_curve(tmp_path / "empty.svg", [[]])
    assert "<svg" in (tmp_path / "empty.svg").read_text()


# Off-axis light: path traced against float64

def test_novel_is_the_analytic_picture_and_has_real_fresnel(mi):
    material = make_material("leather", 32)
    assert check_novel(mi, material).passed
    assert check_novel(mi, material, frame=2, frames=5, seed=50).passed
    constant = check_novel(mi, material, reference=AnalyticRenderer(torch.float64, Needs(fresnel_curve=False)))
    assert not constant.passed and float(constant.bias.abs().max()) > 20  # 60 seen: F0 everywhere is told apart


def test_check_says_what_it_found(tmp_path, capsys):
    save_maps(make_material("inlay", 24), tmp_path)
    assert relight(str(tmp_path), check=True) == 0
    assert "the same but for noise" in capsys.readouterr().out
