"""``mitsvbrdf relight``: the material under other light, path traced."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from ..errors import ConfigError
from ..io import results
from ..io.files import file_hash
from ..io.progress import progress_bar, say
from ..io.signals import stop_signals
from . import options

if TYPE_CHECKING:
    from ..relight.frames import Record
    from ..relight.stage import Stage

PICTURE_SIDES = (8, 8192)  # smallest and largest, pixels
MOVIES = ("mp4", "gif")


def relight(
    maps: Positional[options.Material], encoding: options.MapEncoding = (),
    normal: options.MapNormal = "auto",
    preset: Annotated[str, arg(
        metavar="PRESET,...", help="sphere, shaderball, novel, sweep, turntable; or all.")] = "sphere",
    environment: Annotated[str | None, arg(
        help="studio, sunsky, none, or an .exr or .hdr file. Default: the preset's.")] = None,
    size: Annotated[str, arg(metavar="N or WxH", help="Size of the pictures in pixels.")] = "512",
    frames: Annotated[int | None, arg(
        help="Frames of each movie; 1 makes a still. Default: the preset's.")] = None,
    tiling: Annotated[int, arg(help="Repetitions of the maps along each side.")] = 1,
    exposure: Annotated[float, arg(
        help="Brightness of PNG and movies in stops. EXR files stay linear.")] = 0.0,
    samples: Annotated[int | None, arg(help="Samples a pixel. Default: the preset's.")] = None,
    movie: Annotated[str, arg(
        metavar="mp4,gif|none", help="Movies to make of the frames. Each frame also stays as EXR.")] = "mp4",
    out: Annotated[Path | None, arg(
        aliases=["-o"], help="Folder to write. Default: relight inside MAPS.")] = None,
    seed: int = 0, variant: options.Variant = "llvm_ad_rgb",
    explain: Annotated[bool, arg(help="Do not render. Print what is omitted, and why.")] = False,
    resume: Annotated[bool, arg(
        help="Render the missing frames of an earlier run with the same options.")] = False,
    overwrite: options.Overwrite = False, strict: options.Strict = False,
) -> int:
    """Show a material under other light, path traced with Mitsuba.

    Stills are EXR and PNG files, movies MP4 or GIF. relight.json holds the estimated error of each frame.

    Ctrl-C keeps finished frames, and the current one (fewer samples). --resume continues the same command.
    """
    from ..fit.checkpoint import digest
    from ..fit.config import check_seed
    from ..relight.frames import av_module, begin, go_on, kept_names, render_stages
    from ..relight.stage import PRESETS, make_stage
    from ..render.exclusive import using_mitsuba

    check_seed(seed)
    if not -20 <= exposure <= 20:
        raise ConfigError("--exposure of -20 to 20 stops", str(exposure), "0 leaves the picture as it is")
    pixels = _size(size)
    chosen = list(PRESETS) if preset == "all" else options.chosen("--preset", preset, PRESETS)
    kinds = [] if movie == "none" else options.chosen("--movie", movie, MOVIES)
    out = out or (Path() if explain else options.folder_inside(maps, "relight"))
    svbrdf, fit = options.material_of(maps, 256, encoding, normal), options.fit_of_maps(maps)
    with using_mitsuba(variant) as mi:
        stages = [make_stage(mi, svbrdf, each, environment=environment, size=pixels, frames=frames,
                             samples=samples, tiling=tiling, views=fit.known_views) for each in chosen]
        if explain:
            for stage in stages:
                for what, why in stage.omitted:
                    say(f"{stage.name} omits: {what} ({why})")
            return 0
        if "mp4" in kinds and any(stage.frames > 1 for stage in stages):
            av_module()
        options.keep_apart_from_maps(maps, out)
        views = fit.known_views
        lit = (views.camera, views.light, views.intensity) if views else ()
        sky = file_hash(Path(environment)) if environment and os.path.isfile(environment) else None
        settings = {"maps": maps if maps.startswith("builtin:") else os.path.realpath(maps),
                    "material": digest(*svbrdf.maps.values(), *lit), "environment": environment,
                    "environment_file": sky, "size": pixels, "frames": frames, "tiling": tiling,
                    "exposure": exposure, "samples": samples, "seed": seed, "variant": variant}
        with results.output_folder(out, overwrite, resume, kept_names(PRESETS)) as folder:
            record = go_on(settings, out, folder) if resume else begin(settings)

            def done(stage: Stage) -> None:
                _finish(stage, record, folder, kinds, exposure)

            with stop_signals() as stopping, progress_bar(f"relight {options.name_of(maps)}") as report:
                whole = render_stages(mi, stages, record, folder, seed=seed, exposure=exposure,
                                      report=report, done=done, interrupted=stopping)
        if not whole:
            say("interrupted: the frames so far are kept; the same command with --resume goes on")
        say(f"wrote {out}/relight.json and what it names")
        return 0


def _finish(stage: Stage, record: Record, folder: Path, kinds: list[str], exposure: float) -> None:
    """Write the movies of a preset if all its frames are there, and print a line about the preset."""
    from ..relight.frames import display_frames, write_gif, write_mp4

    frames = record.presets[stage.name]["frames"]
    if len(record.of(stage.name)) == stage.frames > 1:
        for kind, write in (("mp4", write_mp4), ("gif", write_gif)):
            if kind in kinds:
                write(folder / f"{stage.name}.{kind}", display_frames(stage, folder, exposure))
    say(_summary(stage.name, frames))


def _summary(name: str, frames: list[dict]) -> str:
    samples, errors = [f["samples"] for f in frames], [f["error"] for f in frames if f["error"] is not None]
    low, high, several = min(samples), max(samples), len(frames) > 1
    parts = [f"{len(frames)} frames"] if several else []
    parts += [f"{sum(f['seconds'] for f in frames):.1f} s",
              f"{low if low == high else f'{low} to {high}'} sample{'s' * (high > 1)} a pixel",
              f"estimated error {max(errors):.4f}{' at most' * several}" if errors
              else "too few to estimate the error"]
    return f"{name}: {', '.join(parts)}"


def _size(text: str) -> tuple[int, int]:
    try:
        sides = [int(part) for part in text.lower().split("x")]
    except ValueError:
        sides = []
    low, high = PICTURE_SIDES
    if len(sides) not in (1, 2) or not all(low <= side <= high for side in sides):
        raise ConfigError(f"--size N or WxH with sides of {low} to {high} pixels", repr(text),
                          "try 512 or 640x360")
    return sides[0], sides[-1]
