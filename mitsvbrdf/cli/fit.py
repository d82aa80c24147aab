"""``mitsvbrdf fit``: the maps of a material recovered from photos."""

import argparse
import contextlib
import math
import os
import shutil
from collections.abc import Sequence
from dataclasses import field, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, cast, get_args, get_type_hints

from tyro.conf import OmitArgPrefixes, Positional, Suppress, UseAppendAction, arg

from ..capture import Capture
from ..errors import ConfigError
from ..fit import FitTask, GanConfig, fit_svbrdf
from ..fit.checkpoint import load_tensors
from ..fit.confidence import DETERMINED
from ..fit.config import FitConfig
from ..fit.generator.detail import why_not, with_detail
from ..fit.methods import METHODS, method_name
from ..fit.omitted import explained, used
from ..fit.options import FitOptions
from ..fit.result import Fit
from ..io import results
from ..io.progress import Progress, print_numbers, progress_bar, say
from ..io.provenance import memory_gib
from ..io.signals import deferred_signals
from ..render import Renderer, make_renderer
from .options import Out, Overwrite, Photos, Strict, check_new_files, keep_apart, read_photos

USUAL = FitOptions()
Settings = UseAppendAction[OmitArgPrefixes[FitConfig]]  # one flat set of options; --fix may be repeated
Advanced = Annotated[bool, arg(help="With --help: show all options, also those for research.")]
# Settings of methods that are in the help without --advanced.
SHOWN = ("bsdf", "budget", "iterations", "seed", "fix", "grey_specular", "calibrate", "flash_offset", "exact",
         "noise", "preset", "pretrained")
# (bytes per texel, bytes per texel and photo). HELD: peak of memory (measured with real photos, 2048 and
# 4096 px). WRITTEN: disk space.
HELD, WRITTEN = (200, 12), (200, 20)
PROCESS = 0.7  # GiB of a process that has loaded torch and Mitsuba


def fit(capture: Positional[Photos], out: Out, config: Settings, shared: OmitArgPrefixes[FitOptions] = USUAL,
        method: Annotated[Literal["hierarchical", "hybrid", "gan", "direct"],
                          arg(help="Method. `fit --method gan --help` shows the options of gan.")]
        = "hierarchical",
        explain: Annotated[bool, arg(
            help="Do not fit. Print what the fit would omit, what it may omit, and its networks.")] = False,
        pretrain: Annotated[bool, arg(help=(
            "Run only the first stage of --preset paper-two-stage: train the generator on the first photo. "
            "OUT is then a checkpoint, a file for --pretrained."))] = False,
        resume: Annotated[bool, arg(
            help="Continue the fit in OUT, finished or not. --iterations and --budget may differ. A fit that "
                 "lacked time starts anew if either has at least doubled.")] = False,
        overwrite: Overwrite = False, strict: Strict = False, advanced: Advanced = False) -> int:
    """Recover the maps of a material from photos.

    `mitsvbrdf fit photos/ -o out` is enough. The default method ends by itself. Up to 1024 px it begins no
    step that would end after 120 s (--budget). It shows two numbers: rmse is the re-rendering error so far;
    cost is the quantity that the fit minimises, a mean over all texels: squared errors relative to the noise,
    plus distances from expected values. cost has no unit and can rise in a new round.

    To test a fit honestly, hold photos out with --views 0,1,2,3,5,6,8, and predict them with `mitsvbrdf
    evaluate out --capture photos/ --views 4,7`. The paper's method is --method gan --preset paper-one-stage
    (shorter: --iterations 500). For known maps: --fix normal=flat --fix specular=0.04 --fix diffuse=map.exr.

    Ctrl-C ends the fit and keeps its best result. OUT contains report.html (open it first), maps/,
    uncertainty/, guess/, photos/, rerendered/, sheet.png, scene.xml (for plain Mitsuba), fit.json,
    report.json and the checkpoint for --resume. With --detail gan it also contains detail/ and detail.html.
    """
    if pretrain:
        if explain or resume or shared.detail != "none":
            raise ConfigError("--pretrain alone", "--explain, --resume or --detail beside it", "omit these")
        return _pretrain(capture, out, config, shared, overwrite)
    shared.check(config)
    keep_apart(capture, out)
    if not explain:
        results.check_free(out, overwrite, resume)
    photos = read_photos(capture, shared.resolution, None, shared.transfer, shared.light(config))
    shots = shared.chosen(photos)[0]
    if shots.carries and shots.carries > shots.resolution:
        times = (shots.carries / shots.resolution)**2
        say(f"the photos carry detail of {shots.carries} px a side, the maps will have {shots.resolution}: "
            f"--resolution {shots.carries} keeps it, for up to {times:.0f} times the time and memory")
    engine = make_renderer(shared.renderer, shared.variant)
    if explain:
        return _explain(FitTask(shots, engine, config), shared)
    check_room(shots.resolution, len(shots), out)
    result, before = _fit_into(out, photos, engine, config, shared, resume, overwrite)
    _say_result(result, shots, before)
    if shared.detail != "none":
        _say_detail(result)
    page = "report.html, " if (out / "report.html").is_file() else ""
    also = ("uncertainty/, " if result.deviations else "") + ("detail/, " if result.detail else "")
    say(f"wrote {out}/{page}sheet.png, maps/, {also}rerendered/, scene.xml, fit.json")
    return 0


def check_room(side: int, photos: int, out: Path) -> None:
    """Raise ConfigError if memory or disk space does not suffice. The error names a size that fits."""
    place = Path(os.path.realpath(out))
    there = next(folder for folder in (place, *place.parents) if folder.is_dir())
    rooms = (("memory", memory_gib()[1] - PROCESS, HELD, PROCESS),
             (f"space on the disk of {out}", shutil.disk_usage(there).free / 2**30, WRITTEN, 0.0))
    for what, free, (own, more), beside in rooms:
        each = own + more * photos
        if (needed := each * side**2 / 2**30) > free:
            fits = math.isqrt(int(max(free, 0.0) * 2**30 / each)) // 64 * 64
            way_out = f"--resolution {fits} fits" if fits else "free some"
            raise ConfigError(f"{needed + beside:.1f} GiB of {what} for {side} px",
                              f"{free + beside:.1f} GiB", way_out)


def _pretrain(picture: Path, out: Path, config: FitConfig, options: FitOptions, overwrite: bool) -> int:
    """Run the first stage of the paper's two-stage training, and write its checkpoint to ``out``."""
    from ..fit import pretrain

    if not isinstance(config, GanConfig):
        raise ConfigError("--method gan beside --pretrain", f"--method {method_name(config)}",
                          "add --method gan --preset paper-two-stage")
    options.check(config)
    check_new_files(out, overwrite=overwrite, read=[picture])
    shots = options.chosen(read_photos(picture, options.resolution, None, options.transfer,
                                       options.light(config)))[0]
    engine = make_renderer(options.renderer, options.variant)
    with Progress(f"pretrain · {engine.name}") as progress:
        stopped = pretrain(shots, engine, config, out, progress)
    if stopped in ("interrupted", "unstable"):
        say(f"warning: the first stage ended early ({stopped}): its weights are trained less than asked for")
    say(f"wrote {out}")
    return 0


def _explain(task: FitTask, options: FitOptions) -> int:
    known, later = explained(task)
    for what, why in known:
        say(f"omitted: {what} ({why})")
    for what, when in later:
        say(f"may be omitted: {what} ({when})")
    if options.detail == "none":
        say("omitted: plausible detail (not asked for)")
    if networks := used(task):
        say("used: " + ", ".join(f"{what} ({how})" for what, how in networks))
    return 0


def _fit_into(out: Path, photos: Capture, engine: Renderer, config: FitConfig, options: FitOptions,
              resume: bool, overwrite: bool) -> tuple[Fit, dict | None]:
    """Fit, add detail, write the result. Return it, and the note (JSON) of a checkpoint that was resumed."""
    from ..report.folder import write_fit_files
    from ..report.live import LivePage

    earlier = results.checkpoints(out) if resume else []
    if resume and not earlier:
        raise ConfigError(f"a checkpoint to resume from in {out}", "none", "run without --resume first")
    shots, shown = options.chosen(photos)
    title = f"fit {shots.name} · {method_name(config)} · {engine.name}"
    with contextlib.ExitStack() as last, results.output_folder(out, overwrite, resume) as folder:
        page = LivePage(folder, out)
        say(f"live page: {page.path}")

        before = load_tensors(earlier[0])[1] if resume else None
        with Progress(title) as progress:
            result = fit_svbrdf(shots, engine, config, checkpoint=folder / results.CHECKPOINT,
                                resume=earlier[0] if resume else None, report=progress, live=page)
        if detail := options.detail_config(config):
            with progress_bar("plausible detail") as finish_report:
                result = with_detail(result, shots, engine, detail, finish_report)
        last.enter_context(deferred_signals())  # no Ctrl-C until all files are in place
        write_fit_files(result, shots, folder, command=options.record(shots), held_out=shown)
        page.end()
    return result, before


def _say_detail(result: Fit) -> None:
    if result.detail_record:
        say(f"detail/ after {result.detail_record['seconds']:.0f} s: one plausible draw, for pictures; "
            f"re-rendering RMSE {result.detail_record['rerender_rmse']:.4f}")
    elif why := why_not(result):
        say(f"plausible detail omitted: {why}")
    else:
        say("interrupted: the maps were kept, without plausible detail; --resume makes it")


def _say_result(result: Fit, shots: Capture, before: dict | None) -> None:
    """Print errors, how the fit ended, uncertainty and warnings; ``before``: see :func:`_fit_into`."""
    moved, seconds = result.calibrated_rmse is not None, result.trace[-1]["seconds"]
    print_numbers(f"Re-rendering RMSE{', views as fitted' if moved else ''}",
                  dict(zip(shots.names, result.per_photo)) | {"all": result.rerender_rmse})
    if moved:
        say(f"with the calibrated views and the flash offset found: {result.calibrated_rmse:.4f}")
    if result.stopped == "interrupted":
        say("interrupted: the best result so far was kept; the same command with --resume goes on")
    elif result.stopped == "settled":
        say(f"settled after {seconds:.0f} s: it ended by itself")
    elif before and result.stopped != "unstable" and before["trace"][0] == result.trace[0] and (
            before["iteration"] == result.trace[-1]["iteration"]):
        lacked = " to twice its value: the fit lacked time" if before["lacked"] else ""
        say(f"nothing was left to do after {before['iteration']} iterations and {seconds:.0f} s; raise "
            f"--iterations or --budget{lacked}")
    if shots.views.falloff == "none":
        say("scene.xml has a light that falls off with the distance; the light of this fit did not")
    sure = result.record["confidence"]
    told = [f"{name} {_deviation(found['median_sd'])} ({found['determined_share']:.0%} determined)"
            for name, found in sure.items()]
    say(f"how sure: {', '.join(told) or 'unknown without Mitsuba'}")
    if result.deviations_with_look_alikes:
        say("with look-alikes: " + ", ".join(f"{name} {_deviation(each['with_look_alikes'])}"
                                             for name, each in sure.items()))
    if power := result.record["calibration"]["log_power_sd"]:
        say(f"not counted: the light power, known to a factor of {math.exp(power):.1f}; diffuse and specular "
            "scale with it")
    say("±: median deviation by a texel's own photos, maps counted from 0 to 1, colours as linear^(1/2.2), "
        f"normals as (n + 1) / 2; determined: texels below ±{DETERMINED:g}; the others follow texels that "
        "look alike")
    for warning in result.warnings:
        say(f"warning: {warning}")


def _deviation(median: float) -> str:
    """As text. DETERMINED is a lower bound: the deviation of texels whose photos contradict their maps."""
    return f"±{median:.3f}" if abs(median - DETERMINED) > 1e-6 else f"at least ±{median:.3f}"


def settings(arguments: Sequence[str], usual: FitConfig | None = None) -> FitConfig:
    """The settings of the method and the preset named in the arguments. Each field is an option.

    Args:
        arguments: of the command line. --help without --advanced shows only the fields in SHOWN.
        usual: returned if no preset and no other method is named. Else: the defaults.
    """
    asked = _asked(arguments)
    kind = METHODS[asked.method or (method_name(usual) if usual else next(iter(METHODS)))]
    if isinstance(usual, kind) and not asked.preset:
        return usual
    presets = get_args(get_type_hints(kind).get("preset"))
    found = kind(**({"preset": asked.preset} if asked.preset in presets else {}))
    return _usual_only(found) if asked.help and not asked.advanced else found


def _usual_only(config: FitConfig) -> FitConfig:
    kind, hide = type(config), cast(Any, Suppress)
    hints = get_type_hints(kind, include_extras=True)
    hidden = [(each.name, hide[hints[each.name]], field(default=each.default)) for each in fields(kind)
              if each.name not in SHOWN]
    shown = make_dataclass(kind.__name__, hidden, bases=(kind,), frozen=True,
                           namespace={"__doc__": kind.__doc__, "__module__": kind.__module__})
    return shown(**vars(config))


def with_flags(arguments: Sequence[str]) -> list[str]:
    """Rewrite --exact as --exact True, and --no-exact as --exact False. Without both, the fit decides.

    A flag that the method does not have stays as typed, so that the error of the parser names it.
    """
    found: list[str] = []
    hints = get_type_hints(type(settings(arguments)))
    known = {f"--{name}" for name, hint in hints.items() if hint == bool | None}
    for here, after in zip(arguments, [*arguments[1:], ""]):
        name = here.replace("--no-", "--", 1)
        alone = name in known and after not in ("True", "False", "None")
        found += [name, str(here == name)] if alone else [here]
    return found


def _asked(arguments: Sequence[str]) -> argparse.Namespace:
    """Read the arguments that decide which options exist. The main parser reports wrong values."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--method")
    parser.add_argument("--preset")
    parser.add_argument("--advanced", action="store_true")
    parser.add_argument("--help", "-h", action="store_true")
    try:
        found, _ = parser.parse_known_args(arguments)
    except argparse.ArgumentError:  # an option without its value
        found = parser.parse_args([])
    found.method = found.method if found.method in METHODS else None
    return found
