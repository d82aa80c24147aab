"""``mitsvbrdf fit``: the maps of a material recovered from photos."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_type_hints

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from ..capture import Capture
from ..errors import ConfigError
from ..fit import FitTask, fit_svbrdf
from ..fit.checkpoint import load_tensors
from ..fit.confidence import DETERMINED, confidence
from ..fit.config import FitConfig
from ..fit.generator.detail import why_not, with_detail
from ..fit.methods import METHODS, method_name
from ..fit.omitted import decided_later, known_before, used
from ..fit.options import FitOptions
from ..fit.result import Fit
from ..io import results
from ..io.profile import profiling
from ..io.progress import Progress, print_numbers, print_profile, progress_bar, say
from ..io.signals import deferred_signals
from ..render import Renderer, make_renderer
from .options import Out, Overwrite, Photos, Strict, keep_apart, read_photos

USUAL = FitOptions()
THREE_WAYS = "--calibrate", "--exact"  # on, off or left to the fit


def fit(capture: Positional[Photos], out: Out, config: FitConfig, shared: OmitArgPrefixes[FitOptions] = USUAL,
        method: Annotated[Literal["hierarchical", "hybrid", "gan", "direct"],
                          arg(help="How to fit; `fit --method gan --help` shows that method's own options.")] = "hierarchical",
        explain: Annotated[bool, arg(help="Print what this fit would omit, and why, what it decides as "
                                          "it "
                                                  "runs, and the networks it uses, and end without fitting.")] = False,
        profile: Annotated[bool, arg(help="Print where the time of a step goes: network, renderer, losses, "
                                          "forward and "
                                          "backward.")] = False,
        resume: Annotated[bool, arg(
            help="Go on from the checkpoint in OUT, same options, more --iterations.")] = False,
        overwrite: Overwrite = False, strict: Strict = False) -> int:
    """Recover the maps of a material from photos.

    `mitsvbrdf fit photos/ -o out` is all it takes: the default method ends by itself, after 120 s at the
    latest if --budget says nothing else. It shows rmse, the re-rendering error so far, and cost, which it
    lowers: squared errors over the noise plus distances from what is expected, the mean of all texels. Cost
    has no unit, and a new round may raise it.

    Leave photos out with --views 0,1,2,3,5,6,8 and predict them with `mitsvbrdf evaluate out --capture
    photos/ --views 4,7`: the honest test of a fit. The paper's method is --method gan --preset
    paper-one-stage, shortened by --iterations 500. Known maps are held fixed with --fix normal=flat --fix
    specular=0.04 --fix diffuse=map.exr, and cost nothing then.

    Ctrl-C ends the fit and keeps its best result. OUT then holds report.html, the page to look at, maps/,
    uncertainty/, guess/, photos/, rerendered/, sheet.png, curve.svg, scene.xml (for plain Mitsuba), fit.json,
    report.json and the checkpoint that --resume goes on from; with --detail gan also detail/ and its page,
    detail.html.
    """
    shared.check(config)
    keep_apart(capture, out)
    if not explain:
        results.check_free(out, overwrite or resume, resume)
    photos = read_photos(capture, shared.resolution, None, shared.transfer, shared.light(config))
    shots = shared.chosen(photos)[0]
    engine = make_renderer(shared.renderer, shared.variant)
    if explain:
        return _explain(FitTask(shots, engine, config), shared)
    result, before = _fit_into(out, photos, engine, config, shared, profile, resume, overwrite)
    _say_result(result, shots, before)
    if shared.detail != "none":
        _say_detail(result)
    page = "report.html, " if (out / "report.html").is_file() else ""
    also = ("uncertainty/, " if result.deviations else "") + ("detail/, " if result.detail else "")
    say(f"wrote {out}/{page}sheet.png, maps/, {also}rerendered/, scene.xml, fit.json")
    return 0


def _explain(task: FitTask, options: FitOptions) -> int:
    """Say what the fit omits and uses."""
    for what, why in known_before(task):
        say(f"omitted: {what} ({why})")
    for what, when in decided_later(task):
        say(f"may be omitted: {what} ({when})")
    if options.detail == "none":
        say("omitted: plausible detail (not asked for)")
    if networks := used(task):
        say("used: " + ", ".join(f"{what} ({how})" for what, how in networks))
    return 0


def _fit_into(out: Path, photos: Capture, engine: Renderer, config: FitConfig, options: FitOptions,
              profile: bool, resume: bool, overwrite: bool) -> tuple[Fit, int | None]:
    """Fit, add plausible detail where asked to, and write the result; also tells the iteration of the checkpoint gone on
    from.
    """
    from ..report.folder import write_fit_files
    from ..report.live import LivePage

    earlier = results.checkpoints(out) if resume else []
    if resume and not earlier:
        raise ConfigError(f"a checkpoint to resume from in {out}", "none", "run without --resume first")
    shots, shown = options.chosen(photos)
    title = f"fit {shots.source.name if shots.source else ''} · {method_name(config)} · {engine.name}"
    with contextlib.ExitStack() as last, results.output_folder(out, overwrite or resume,
                                                                     resume) as folder:
        page = LivePage(folder, out)
        say(f"live page: {page.path}")

        def fitted(checkpoint: Path | None) -> Fit:
            with Progress(title) as progress, profiling() if profile else contextlib.nullcontext():
                return fit_svbrdf(shots, engine, config, checkpoint=folder / results.CHECKPOINT,
                                  resume=checkpoint, report=progress, live=page)

        result, before = _from_first_of(earlier, fitted) if resume else (fitted(None), None)
        if settings := options.detail_config(config):
            with progress_bar("plausible detail") as finish_report:
                result = with_detail(result, shots, engine, settings, finish_report)
        last.enter_context(deferred_signals())  # until all is in place
        write_fit_files(result, shots, folder, command=options.record(shots), left_out=shown)
        page.end()
    return result, before


def _from_first_of(checkpoints: Sequence[Path], fitted: Callable[[Path], Fit]) -> tuple[Fit,
                                                                                              int | None]:
    """Go on from the first checkpoint that is of this fit: what is left of another one does not hide a
    finished fit.
    """
    wrong: list[ConfigError] = []
    for path in checkpoints:
        try:
            before = load_tensors(path)[1].get("iteration")
            result = fitted(path)
        except ConfigError as reason:
            wrong.append(reason)
            continue
        if wrong:
            say(f"went on from {path}; what was left unfinished was another fit: {wrong[0].got}")
        return result, before
    raise wrong[0]


def _say_detail(result: Fit) -> None:
    if result.detail_record:
        say(f"detail/ after {result.detail_record['seconds']:.0f} s: one plausible draw, for pictures; re-rendering "
            "RMSE "
            f"{result.detail_record['rerender_rmse']:.4f}")
    elif why := why_not(result):
        say(f"plausible detail omitted: {why}")
    else:
        say("interrupted: the maps were kept, without plausible detail; the same command with --resume makes it")


def _say_result(result: Fit, shots: Capture, before: int | None) -> None:
    """Errors, how it ended, how sure it is, and its warnings; ``before`` is the iteration gone on from."""
    moved = result.calibrated_rmse is not None
    print_numbers(f"Re-rendering RMSE{', views as fitted' if moved else ''}",
                  dict(zip(shots.names, result.per_photo)) | {"all": result.rerender_rmse})
    if moved:
        say(f"with the calibrated views and the flash offset found: {result.calibrated_rmse:.4f}")
    if result.profile:
        print_profile(result.profile)
    if result.stopped == "interrupted":
        say("interrupted: the best result so far was kept; the same command with --resume goes on")
    elif before is not None and result.trace[-1]["iteration"] == before:
        say(f"nothing was left to do after {before} iterations and {result.trace[-1]['seconds']:.0f} s; "
            "raise --iterations or --budget")
    elif result.stopped == "settled":
        say(f"settled after {result.trace[-1]['seconds']:.0f} s: it ended by itself, before its limit")
    if shots.views.falloff == "none":
        say("scene.xml has a light that falls off with the distance; this fit's did not")
    sure = confidence(result.deviations).items()
    say("how sure: " + ", ".join(f"{name} ±{c['median_sd']:.3f} ({c['determined_share']:.0%} determined)"
                                 for name, c in sure))
    say("±: median standard deviation of a texel, maps counted from 0 to 1, colours as linear^(1/2.2), "
        "normals as (n + 1) / 2; "
        f"determined: texels below ±{DETERMINED:g} by their own photos alone; the others follow texels that "
        "look alike")
    for warning in result.warnings:
        say(f"warning: {warning}")


def fit_command(arguments: Sequence[str], function: Callable[..., Any] = fit,
                usual: FitConfig | None = None) -> Callable[..., Any]:
    """A function of a ``config`` with the settings of the method that the arguments name as its options.

    Args:
        arguments: of the command line.
        function: what is called.
        usual: settings that the arguments change; left out, or of another method, that method's defaults.
    """
    def command(*values: Any, **options: Any) -> Any:
        return function(*values, **options)

    # One flat set of options, those of the method, with the defaults of the preset named; --fix may be
    # repeated.
    names = METHODS if usual is None else dict.fromkeys([method_name(usual), *METHODS])
    kind = METHODS[_named(arguments, "--method", names)].config
    presets = get_args(get_type_hints(kind).get("preset"))
    default = kind(preset=_named(arguments, "--preset",
                                 presets)) if presets else kind()  # type: ignore[call-arg]
    if isinstance(usual, kind) and "--preset" not in " ".join(arguments):
        default = usual
    signature = inspect.signature(function)
    chosen = [p.replace(default=default) if p.name == "config" else p for p in signature.parameters.values()]
    command.__doc__ = function.__doc__
    command.__signature__ = signature.replace(parameters=chosen)  # type: ignore[attr-defined]
    config = UseAppendAction[OmitArgPrefixes[kind]]  # type: ignore[misc, valid-type]
    command.__annotations__ = get_type_hints(function, include_extras=True) | {"config": config}
    return command


def with_flags(arguments: list[str]) -> list[str]:
    """Arguments with --calibrate, --exact and their --no- as True and False: unsaid is a third, which no flag
    of tyro's has.
    """
    if _named(arguments, "--method", METHODS) != "hierarchical":
        return arguments
    found = []
    for here, after in zip(arguments, [*arguments[1:], ""]):
        alone = here in THREE_WAYS and after not in ("True", "False", "None")
        denied = here.replace("--no-", "--", 1)
        found += ([here, "True"] if alone else [denied, "False"] if denied != here and denied in THREE_WAYS
                  else [here])
    return found


def _named(arguments: Sequence[str], option: str, names: Collection[str]) -> str:
    """Which of the names the arguments give for an option; the first where they give none."""
    named = next(iter(names))
    for here, after in zip(arguments, [*arguments[1:], ""]):
        name = (after if here == option else here.removeprefix(f"{option}=") if here.startswith(f"{option}=")
                else "")
        named = name if name in names else named
    return named  # the last one counts, as for every option
