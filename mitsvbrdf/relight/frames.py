"""Render frames of presets into a folder and record each, so that a later run continues; MP4 and GIF."""

import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from torch import Tensor

from ..errors import BackendError, ConfigError, MapsError, MitsvbrdfError
from ..io import Report, files, images
from ..io.entry import entry
from ..io.json import load
from ..io.provenance import machine, versions
from .passes import INTERRUPTED, render_frame, shown
from .stage import Stage

SCHEMA_VERSION = 1
RECORD = "relight.json"
BESIDE = ("png", "mp4", "gif")  # files of a preset, beside its frames


@dataclass
class Record:
    """The content of ``relight.json``."""

    settings: dict  # all that the pictures depend on, as JSON values; the same in a resumed run
    # preset -> omitted, and frames: dicts of frame (number), file, samples, seconds, error and stopped
    presets: dict[str, dict]

    def of(self, preset: str) -> dict[int, dict]:
        """A dict of the finished frames of a preset: number to entry."""
        frames = self.presets.get(preset, {}).get("frames", [])
        return {frame["frame"]: frame for frame in frames if frame["stopped"] != INTERRUPTED}

    def write(self, folder: Path) -> None:
        """Replace the record in the folder."""
        files.write_json(folder / RECORD, {"schema_version": SCHEMA_VERSION, "settings": self.settings,
                                           "presets": self.presets,
                                           "versions": versions(), "machine": machine()})


def kept_names(presets: Iterable[str]) -> tuple[str, ...]:
    """Names of files and folders of a run from which another run can continue."""
    return (RECORD,
            *(name + ending for name in presets for ending in ("", ".exr", *(f".{kind}" for kind in BESIDE))))


def begin(settings: Mapping) -> Record:
    """A record with these settings and no frame."""
    return Record(json.loads(json.dumps(settings)), {})


def go_on(settings: Mapping, out: Path, folder: Path) -> Record:
    """The record of an earlier run with the same settings; its files are copied to ``folder``.

    After a killed run its files are still in ``folder``, where results are made; else they are in ``out``.
    ConfigError: there is no earlier run, it had other settings, or it names files outside of its folder.
    """
    place = next((place for place in (folder, out) if files.is_regular(place / RECORD)), None)
    if place is None:
        raise ConfigError(f"a {RECORD} to continue from in {out}", "none", "run without --resume first")
    record, names = _found(place, settings)
    for name in names if place != folder else ():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(place / name, folder / name)
    return record


def _found(place: Path, settings: Mapping) -> tuple[Record, list[str]]:
    """The record in a folder, and the files named in it; ConfigError unless it has these settings."""
    try:
        found = load(place / RECORD, links=False)
        record, new = Record(found["settings"], found["presets"]), begin(settings).settings
        other = [name for name in record.settings | new if record.settings.get(name) != new.get(name)]
        for name, preset in record.presets.items():
            preset["frames"] = list(record.of(name).values())
        frames = [frame["file"] for preset in record.presets.values() for frame in preset["frames"]]
        lost = [str(name) for name in frames if not files.is_regular(files.inside(place, name))]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as reason:
        raise ConfigError(f"a {RECORD} of this command", f"{place}: {reason!r}",
                          "--overwrite starts anew") from None
    if other:
        raise ConfigError("the settings of the earlier run", f"another {', '.join(other)}",
                          "give the same, or --overwrite to start anew")
    if lost:
        raise ConfigError(f"the frames that {RECORD} names", f"{place} without {', '.join(lost)}",
                          "--overwrite starts anew")
    beside = [f"{name}.{kind}" for name in record.presets for kind in BESIDE]
    return record, [*frames, *(name for name in beside if files.is_regular(files.inside(place, name)))]


@entry()
def render_stages(mi: ModuleType, stages: Sequence[Stage], record: Record, folder: Path, *,
                  seed: int = 0, exposure: float = 0.0, report: Report = lambda text, share: None,
                  done: Callable[[Stage], object], interrupted: Sequence = ()) -> bool:
    """Render the frames that the record lacks, in order. Frames are EXR files; a still also has a PNG.

    The record gets an entry for each frame, and is written after each. ``exposure`` affects only the PNG and
    the estimated error. ``done`` is called after each preset, and after an interrupted one if it has a
    frame. If ``interrupted`` becomes non-empty, rendering stops; the current frame is kept as it is. Returns
    whether all frames are done. MapsError: radiance that is not finite.
    """
    total = sum(stage.frames for stage in stages)
    before = 0
    for stage in stages:
        have = record.of(stage.name)
        kept = record.presets.setdefault(stage.name, {"frames": []})
        kept["omitted"] = [{"what": what, "why": why} for what, why in stage.omitted]
        missing = [k for k in range(stage.frames) if k not in have]
        scene = mi.load_dict(stage.scene) if missing else None
        held = mi.traverse(scene) if missing else None
        for number in missing:
            if interrupted:
                break
            stage.move(held, number)
            title = stage.name if stage.frames == 1 else f"{stage.name} {number + 1}/{stage.frames}"
            at = before + number
            try:
                rendered = render_frame(mi, scene, stage.samples, seed=seed, name=f"{stage.name} {number}",
                                        exposure=exposure,
                                        report=lambda text, share: report(
                                            f"{title}: {text}", (at + share) / total),  # noqa: B023
                                        interrupted=interrupted)
            except MapsError as error:
                raise MapsError(error.expected, f"{error.got} in {title}", error.fix) from None
            images.write_exr(folder / frame_file(stage, number), rendered.image)
            if stage.frames == 1:
                images.write_png(folder / f"{stage.name}.png", shown(rendered.image, exposure))
            told = {name: value for name, value in vars(rendered).items() if name != "image"}
            kept["frames"].append({"frame": number, "file": frame_file(stage, number), **told})
            record.write(folder)
            if rendered.stopped == INTERRUPTED:
                break
        before += stage.frames
        if kept["frames"]:
            done(stage)
        if len(record.of(stage.name)) < stage.frames:
            break
    record.write(folder)
    return all(len(record.of(stage.name)) == stage.frames for stage in stages)


def frame_file(stage: Stage, number: int) -> str:
    """The EXR of a frame, relative to the folder."""
    return f"{stage.name}.exr" if stage.frames == 1 else f"{stage.name}/{number:04d}.exr"


def display_frames(stage: Stage, folder: Path, exposure: float = 0.0) -> Iterator[Tensor]:
    """The frames of a preset as display values, one after the other."""
    for number in range(stage.frames):
        yield shown(images.read_image(folder / frame_file(stage, number), MitsvbrdfError), exposure)


FPS = 24
CRF = "14"  # errors that an eye does not see; 18 is usually called visually lossless
BT709 = 1  # as matrix, primaries and transfer in ITU-T H.264, tables E-3 to E-5
PALETTE_SIZE = 256  # of a GIF's palette


def write_mp4(path: Path, frames: Iterable[Tensor]) -> None:
    """An MP4 that every player and browser shows: H.264, yuv420p, tagged as BT.709, limited range.

    Frames are display values, clipped to [0, 1]. yuv420p has half as many chroma samples as luma samples on
    each axis, so an odd size gets one more column or row, a copy of its neighbour; no pixel is lost.
    BackendError: PyAV is not installed.
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
    """A GIF that loops, with a palette for each frame and error diffusion; arguments as :func:`write_mp4`."""
    from PIL import Image

    pictures = [Image.fromarray(_eight_bits(frame)) for frame in frames]
    # GIF counts in hundredths of a second: each frame lasts until the rounded start of the next.
    ends = [round(100 * k / FPS) for k in range(len(pictures) + 1)]
    first, *others = (picture.quantize(palette=picture.quantize(PALETTE_SIZE)) for picture in pictures)
    with files.atomic_write(Path(path)) as temporary:
        first.save(temporary, format="GIF", save_all=True, append_images=others, loop=0, optimize=False,
                   disposal=1, duration=[10 * (end - begin) for begin, end in zip(ends, ends[1:])])


def _eight_bits(frame: Tensor) -> np.ndarray:
    return np.rint(frame.clamp(0, 1).double().numpy() * 255).astype(np.uint8)


def av_module() -> ModuleType:
    """PyAV; BackendError if it is not installed."""
    try:
        import av
    except ImportError:
        raise BackendError("PyAV, which writes movies", "none",
                           'pip install "mitsvbrdf[movie]", or ask for --movie gif') from None
    return av
