"""The command line: parse, call, print, exit code.

0 is success, and a fit that Ctrl-C ended early; 1 a check that does not hold; 2 a mistake the caller can mend; 130 Ctrl-C
without a result.
"""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, UseAppendAction, arg

from .. import __version__, files
from ..capture import guess_diffuse
from ..errors import ConfigError, exit_code
from ..fit import fit_svbrdf, left_out, pretrain
from ..fit.checkpoint import load_tensors
from ..fit.confidence import confidence
from ..fit.config import DirectConfig, FitConfig, GanConfig, GuessMethod, HierarchicalConfig, HybridConfig
from ..interrupts import undisturbed
from ..maps import load_maps
from ..profile import profiling
from ..progress import Progress, print_numbers, print_profile, say, say_written
from ..render import RendererName, make_renderer
from ..views import Falloff
from .bench import bench
from .capture import capture
from .compare import compare
from .crosscheck import crosscheck
from .export import export
from .leave_out import leave_out
from .options import (
    FalloffOption,
    Material,
    Out,
    Overwrite,
    Photos,
    TransferOption,
    Variant,
    ViewList,
    ViewSource,
    check_new_checkpoint,
    keep_apart,
    material_of,
    photo_numbers,
    read_photos,
    views_of,
)
from .relight import relight
from .report import report
from .sheet import sheet
from .stability import stability
from .synth import synth
from .view import view

CONFIGS: dict[str, type[FitConfig]] = {"hierarchical": HierarchicalConfig, "hybrid": HybridConfig, "gan": GanConfig,
                                       "direct": DirectConfig}
PREDICTED = 9  # photos left out of a fit that its page shows at once; `report --capture` shows all


def fit_command(method: str) -> Callable:
    """The ``fit`` command with the settings of one method as its options."""
    def fit(
        capture: Positional[Photos],
        out: Out,
        config: FitConfig,
        method: Annotated[Literal["hierarchical", "hybrid", "gan", "direct"],
                          arg(help="How to fit; `fit --method gan --help` shows that method's own options.")]
        = method,  # type: ignore[assignment]
        renderer: Annotated[RendererName, arg(help="What renders the maps and carries the gradients.")] = "mitsuba",
        resolution: Annotated[int, arg(help="Side of the maps in texels; photos are area-averaged down to it.")] = 256,
        views: ViewList = None,
        falloff: Annotated[FalloffOption, arg(help="Light falloff; none is the paper's light. auto: inverse-square, but "
                                                   "none for --method gan.")] = "auto",
        transfer: TransferOption = "auto",
        variant: Variant = "llvm_ad_rgb",
        explain: Annotated[bool, arg(help="Print what this fit would leave out, and why, and end without fitting.")] = False,
        profile: Annotated[bool, arg(help="Print where the time of a step goes: network, renderer, losses, forward and "
                                          "backward.")] = False,
        resume: Annotated[bool, arg(help="Go on from the checkpoint in OUT, same options, more --iterations.")] = False,
        overwrite: Overwrite = False,
    ) -> int:
        """Recover the maps of a material from photos.

        `mitsvbrdf fit photos/ -o out --budget 120` is all it takes. Leave photos out with --views 0,1,2,3,5,6,8 and predict
        them with `mitsvbrdf evaluate out --capture photos/ --views 4,7`: the honest test of a fit. The paper's method is
        --method gan --preset paper-one-stage, shortened by --iterations 500. Known maps are held fixed with
        --fix normal=flat --fix specular=0.04 --fix diffuse=map.exr, and cost nothing then.

        Ctrl-C ends the fit and keeps its best result. OUT then holds report.html, the page to look at, maps/, guess/, photos/,
        rerendered/, sheet.png, curve.svg, scene.xml (for plain Mitsuba), fit.json, report.json and the checkpoint that --resume
        goes on from.
        """
        from ..report.folder import write_fit

        config.check()
        if falloff == "auto":
            falloff = "none" if method == "gan" else "inverse-square"
        chosen = photo_numbers(views)
        photos = read_photos(capture, resolution, None, transfer, falloff)
        shots = photos if chosen is None else photos.pick(chosen)
        engine = make_renderer(renderer, variant)
        keep_apart(capture, out)
        if explain:
            for what, why in left_out(shots, engine, config):
                say(f"left out: {what} ({why})")
            return 0
        earlier = next((p for p in (files.partial_folder(out) / files.CHECKPOINT, out / files.CHECKPOINT) if p.is_file()), None)
        if resume and earlier is None:
            raise ConfigError(f"a checkpoint to resume from in {out}", "none", "run without --resume first")
        before = load_tensors(earlier)[1].get("iteration") if resume else None
        unused = [number for number in photos.index if number not in shots.index][:PREDICTED]
        shown = photos.pick(sorted({*shots.index, *unused})) if unused else None
        with files.output_folder(out, overwrite or resume, resume) as folder:
            collecting = profiling() if profile else contextlib.nullcontext()
            title = f"fit {shots.source.name if shots.source else ''} · {method} · {engine.name}"
            with Progress(title) as progress, collecting:
                result = fit_svbrdf(shots, engine, config, checkpoint=folder / files.CHECKPOINT,
                                    resume=earlier if resume else None, report=progress, live=folder / files.LIVE)
            with undisturbed():
                write_fit(result, shots, folder, command={
                    "renderer": renderer, "resolution": resolution, "views": views, "falloff": shots.views.falloff,
                    "transfer": transfer, "variant": variant}, left_out=shown)
        print_numbers("Re-rendering RMSE", dict(zip(shots.names, result.per_photo)) | {"all": result.rerender_rmse})
        if result.profile:
            print_profile(result.profile)
        if result.stopped == "interrupted":
            say("interrupted: the best result so far was kept; the same command with --resume goes on")
        elif resume and result.trace[-1]["iteration"] == before:
            say(f"nothing was left to do after {before} iterations and {result.trace[-1]['seconds']:.0f} s; "
                "raise --iterations or --budget")
        if shots.views.falloff == "none":
            say("scene.xml has a light that falls off with the distance; this fit's did not")
        sure = confidence(result.deviations).items()
        say("how sure: " + ", ".join(f"{name} ±{c['median_sd']:.3f} ({c['determined_share']:.0%} determined)"
                                     for name, c in sure))
        for warning in result.warnings:
            say(f"warning: {warning}")
        page = "report.html, " if (out / "report.html").is_file() else ""
        say(f"wrote {out}/{page}sheet.png, maps/, rerendered/, scene.xml, fit.json")
        return 0

    # One flat set of options, those of the method; --fix may be repeated.
    fit.__annotations__["config"] = UseAppendAction[OmitArgPrefixes[CONFIGS[method]]]
    return fit


def guess(capture: Positional[Photos], out: Out, method: GuessMethod = "robust", resolution: int = 256,
          views: ViewList = None, transfer: TransferOption = "auto", overwrite: Overwrite = False) -> int:
    """Make the guessed diffuse map only: OUT/diffuse.exr and .png.

    Methods: min is the paper's per-pixel minimum; mean-blur the older baseline; robust undoes falloff and highlights.
    """
    from ..report.folder import write_linear

    keep_apart(capture, out)
    shots = read_photos(capture, resolution, views, transfer, "inverse-square")
    with files.output_folder(out, overwrite) as folder:
        write_linear(folder / "diffuse", guess_diffuse(shots, method), "srgb")
    say(f"wrote {out}/diffuse.exr, diffuse.png")
    return 0


def render(maps: Positional[Material], out: Out, views: ViewSource = "builtin:grid", renderer: RendererName = "mitsuba",
           falloff: Annotated[FalloffOption, arg(help="auto: as in the fit.")] = "auto",
           transfer: Annotated[TransferOption, arg(help="How the PNGs encode light; auto: as in the fit.")] = "auto",
           flash_offset: Annotated[Literal["fitted", "none"],
                                   arg(help="fitted: the light stands beside the camera as the fit found it.")] = "none",
           diffuse: Annotated[Literal["fitted", "guessed"], arg(help="guessed: show the guessed diffuse map of the fit "
                                                                     "instead of its own (paper IV.B).")] = "fitted",
           variant: Variant = "llvm_ad_rgb", overwrite: Overwrite = False) -> int:
    """Render maps for the views of a capture: OUT/NN.png (display values) and NN.exr (linear)."""
    from ..evaluate import shift_lights
    from ..report.folder import write_linear

    svbrdf, fit = material_of(maps), _fit_of(maps)
    if diffuse == "guessed":
        svbrdf = _with_guessed_diffuse(svbrdf, Path(maps))
    names, lit = views_of(views, fit.falloff if falloff == "auto" else falloff, fit)
    lit = shift_lights(lit, fit.flash_offset if flash_offset == "fitted" else None)
    transfer = (fit.transfer or "gamma2.2") if transfer == "auto" else transfer
    keep_apart(Path(views), out)
    images = make_renderer(renderer, variant).render(svbrdf, lit)
    with files.output_folder(out, overwrite) as folder:
        for name, image in zip(names, images):
            write_linear(folder / name, image, transfer)
    say(f"wrote {len(names)} images to {out}")
    return 0


def evaluate(maps: Positional[Material],
             reference: Annotated[str | None, arg(help="Known maps: a folder or builtin:NAME.")] = None,
             capture: Annotated[Path | None, arg(metavar="CAPTURE", help="Photos to compare re-renderings with.")] = None,
             views: ViewList = None,
             resolution: Annotated[int | None, arg(help="Side of the photos; left out: that of the maps.")] = None,
             renderer: RendererName = "mitsuba", transfer: TransferOption = "auto",
             falloff: Annotated[FalloffOption, arg(help="auto: as in the fit.")] = "auto",
             flash_offset: Annotated[Literal["fitted", "none"],
                                     arg(help="fitted: use the flash offset that the fit found.")] = "fitted",
             refine_views: Annotated[bool, arg(help="Measure again with camera, flash and exposure of each photo refined; the "
                                                    "maps stay as they are.")] = False,
             json_file: Annotated[Path | None, arg(name="json", help="Write the figures to this file.")] = None,
             variant: Variant = "llvm_ad_rgb") -> int:
    """Measure maps: against known maps (--reference) or against photos (--capture).

    Map RMSE is counted as in the field: diffuse and specular gamma-encoded, roughness as stored, normal as (n + 1) / 2.
    Re-rendering RMSE is in display values clipped to [0, 1], over all pixels and photos. Burn-in is the share of a map's
    variance that lies as the highlights of the fit's photos do (without a fit.json: of the photos given).

    Photos left out of a fit have their own errors of calibration, which no fit can know. --refine-views also measures with the
    camera, flash and exposure of each photo moved to where they explain it best, within priors, and prints how far that was.
    """
    from ..evaluate import evaluate_capture, evaluate_maps, placed
    from ..evaluate.burn_in import burn_in
    from ..fit.calibration import Priors
    from ..metrics import map_rmse

    if (reference is None) == (capture is None):
        raise ConfigError("either --reference or --capture", "both" if reference else "neither", "give one of them")
    if refine_views and capture is None:
        raise ConfigError("--capture beside --refine-views", "--reference", "give the photos whose views to refine")
    files.check_output(json_file)
    svbrdf = material_of(maps)
    if reference is not None:
        found = map_rmse(svbrdf, material_of(reference)) if reference.startswith("builtin:") else evaluate_maps(
            svbrdf, reference)
        print_numbers("Map RMSE", found)
    else:
        fit = _fit_of(maps)
        offset = fit.flash_offset if flash_offset == "fitted" else None
        if offset:
            say(f"with the flash offset of the fit, ({offset[0]:.3f}, {offset[1]:.3f}) patch sides; "
                "--flash-offset none leaves it out")
        transfer = fit.transfer or "auto" if transfer == "auto" else transfer
        chosen = photo_numbers(views)
        photos = read_photos(capture, resolution or svbrdf.resolution, None, transfer,
                             fit.falloff if falloff == "auto" else falloff)
        shots = placed(photos, fit)
        for note in shots.notes[len(photos.notes):]:
            say(note)
        shots = shots if chosen is None else shots.pick(chosen)
        found = evaluate_capture(svbrdf, shots, make_renderer(renderer, variant), offset, Priors() if refine_views else None)
        labels = [fit.label(shots, number) for number in shots.index]
        for title, errors in (("", found), (" with refined views", found.get("refined"))):
            if errors:
                print_numbers("Re-rendering RMSE" + title,
                              dict(zip(labels, errors["per_photo"].values())) | {"all": errors["rerender_rmse"]})
        for name, view in found.get("refined", {}).get("views", {}).items():
            say(f"photo {name}: {_moved(view['change'])}")
        found["burn_in"] = burn_in(svbrdf, fit.views or shots.views)
        print_numbers("Burn-in (0 is best)", found["burn_in"])
    if json_file:
        files.write_json(json_file, found)
        say_written(json_file)
    return 0


def pretrain_command(picture: Positional[Photos], out: Out, config: UseAppendAction[OmitArgPrefixes[GanConfig]],
                     resolution: int = 256, renderer: RendererName = "mitsuba", falloff: Falloff = "none",
                     variant: Variant = "llvm_ad_rgb", overwrite: Overwrite = False) -> int:
    """First stage of the paper's two-stage training: the generator learns from one picture with global features.

    CAPTURE's first photo is used; a folder with one plain photo will do. OUT is a .safetensors file, for
    `fit --method gan --preset paper-two-stage --pretrained OUT`.
    """
    config.check()
    check_new_checkpoint(out, overwrite)
    shots = read_photos(picture, resolution, None, "auto", falloff)
    engine = make_renderer(renderer, variant)
    with Progress(f"pretrain · {engine.name}") as progress:
        pretrain(shots, engine, config, out, progress)
    say(f"wrote {out}")
    return 0


def doctor(variant: Variant = "llvm_ad_rgb", json: bool = False) -> int:
    """Show what is installed, prove libLLVM in a child process, and say what is missing and how to get it."""
    from ..doctor import doctor as examine

    return examine(variant=variant, json=json)


def demo(out: Out = Path("demo"), budget: float = 75.0, overwrite: Overwrite = True) -> int:
    """Photograph a made material, recover it, and compare with the truth; about two minutes."""
    from ..evaluate import evaluate_maps
    from ..maps import save_maps
    from ..procedural import make_material

    truth, photos, result = out / "material", out / "capture", out / "fit"
    if result.exists():
        say(f"replacing the earlier demo in {out}")
    with files.output_folder(truth, overwrite) as folder:
        save_maps(make_material("inlay", 256), folder)
    synth(str(truth), photos, noise=0.003, overwrite=overwrite)
    fit_command("hierarchical")(photos, result, HierarchicalConfig(budget=budget), overwrite=overwrite)
    print_numbers("Map RMSE", evaluate_maps(load_maps(result), truth))
    say(f"look at {result}/report.html")
    return 0


def _fit_of(maps: str):
    from ..evaluate import Fit, fit_of

    return Fit() if maps.startswith("builtin:") else fit_of(maps)


def _moved(change: dict[str, float]) -> str:
    camera, flash = (", ".join(f"{change[f'{what}_{axis}']:+.3f}" for axis in "xyz") for what in ("camera", "flash"))
    return f"camera ({camera}), flash beside it ({flash}) patch sides, light x {math.exp(change['log_exposure']):.3f}"


def _with_guessed_diffuse(svbrdf, maps: Path):
    from ..errors import MapsError
    from ..maps import SVBRDF

    folder = maps.parent if maps.name == "maps" else maps
    guessed = files.read_image(folder / "guess" / "diffuse.exr", MapsError)
    name = "diffuse" if svbrdf.bsdf == "roughconductor" else "base_color"
    return SVBRDF(svbrdf.bsdf, dict(svbrdf.maps) | {name: guessed})


def _method_of(arguments: list[str]) -> str:
    method = next(iter(CONFIGS))
    for here, after in zip(arguments, [*arguments[1:], ""]):
        name = after if here == "--method" else here.removeprefix("--method=") if here.startswith("--method=") else None
        method = name if name in CONFIGS else method
    return method  # the last one counts, as for every option


def _flags(arguments: list[str]) -> list[str]:
    """Arguments with --calibrate alone and --no-calibrate as True and False: unsaid is a third, which no flag of tyro's has."""
    found = []
    for here, after in zip(arguments, [*arguments[1:], ""]):
        alone = here == "--calibrate" and after not in ("True", "False", "None")
        found += ["--calibrate", "True"] if alone else ["--calibrate", "False"] if here == "--no-calibrate" else [here]
    return found


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    method = _method_of(arguments)
    commands = {"capture": capture, "fit": fit_command(method), "view": view, "guess": guess, "render": render,
                "evaluate": evaluate, "compare": compare, "crosscheck": crosscheck, "leave-out": leave_out,
                "stability": stability, "bench": bench, "synth": synth, "pretrain": pretrain_command,
                "doctor": doctor, "export": export, "relight": relight, "report": report,
                "sheet": sheet, "demo": demo}
    if arguments == ["--version"]:
        say(f"mitsvbrdf {__version__}")
        return 0
    arguments = _flags(arguments) if method == "hierarchical" else arguments
    return exit_code(
        lambda: tyro.extras.subcommand_cli_from_dict(
            commands, prog="mitsvbrdf", args=arguments, config=(FlagCreatePairsOff,),
            description="Recover the maps of a material (diffuse, specular, roughness, normal) from a few flash photos, "
                        "fitted through Mitsuba 3, without any training data."),
        "interrupted; what is unfinished goes on with --resume" if arguments[:1] in (["fit"], ["relight"]) else "interrupted")
