"""``mitsvbrdf evaluate``: maps measured against known maps or photos."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..calibrate.refine import Priors
from ..errors import ConfigError
from ..evaluate.photos import evaluate_photos
from ..evaluate.placement import placed
from ..io import files
from ..io.progress import print_numbers, say, say_written
from ..measure.burn_in import burn_in, local_burn_in
from ..render import RendererName, make_renderer
from ..views import photo_numbers
from . import options


def evaluate(maps: Positional[options.Material], reference: options.Reference = None,
             encoding: options.MapEncoding = (), normal: options.MapNormal = "auto",
             capture: Annotated[Path | None, arg(metavar="CAPTURE", help="Photos to compare with.")] = None,
             views: options.ViewList = None,
             resolution: Annotated[int | None, arg(
                 help="Side of the photos. Default: that of the maps.")] = None,
             renderer: RendererName = "mitsuba", transfer: options.FittedTransfer = "auto",
             falloff: Annotated[options.FalloffOption, arg(
                 help="Falloff of light. auto: as in the fit.")] = "auto",
             refine_views: options.RefineViews = False, json_file: options.JsonFile = None,
             variant: options.Variant = "llvm_ad_rgb", overwrite: options.Overwrite = False,
             strict: options.Strict = False) -> int:
    """Measure the error of maps against known maps (--reference) or photos (--capture).

    Map RMSE follows common practice: diffuse and specular gamma-encoded, roughness as stored, and the normal
    as (n + 1) / 2. Re-rendering RMSE is in display values clipped to [0, 1], over all pixels. A photo that
    the fit saw is rendered with the final view of the fit, so its error is the one the fit printed. A
    held-out photo is rendered with its calibrated view and the flash offset of the fit. A further line gives
    the error of all photos in such views. Burn-in is the share of a map's variance that follows the
    highlights of the fit's photos (without a fit.json: of the given photos).

    No fit knows the calibration errors of held-out photos. --refine-views also refines the camera, flash and
    exposure of each photo within priors, measures again, and prints the changes.
    """
    options.check_side(resolution)
    if (reference is None) == (capture is None):
        raise ConfigError("either --reference or --capture", "both" if reference else "neither", "give one")
    if reference and (refine_views or views or resolution or (transfer, falloff) != ("auto", "auto")):
        raise ConfigError("--capture beside --refine-views, --views, --resolution, --transfer or --falloff",
                          "--reference", "give the photos, or leave the option out")
    options.check_new_files(json_file, overwrite=overwrite, photos=capture, read=[maps, reference])
    svbrdf = options.material_of(maps) if reference else options.material_of(maps, 256, encoding, normal)
    found: dict[str, Any]
    if reference is not None:
        found = options.errors_against(reference, svbrdf.resolution, encoding, normal)(svbrdf)
        print_numbers("Map RMSE", found)
    elif capture is not None:
        fit = options.fit_of_maps(maps)
        chosen = photo_numbers(views)
        photos = options.read_photos(capture, resolution or svbrdf.resolution, None, transfer,
                                     fit.falloff if falloff == "auto" else falloff)
        shots = placed(photos, fit, None if transfer == "auto" else transfer)
        for note in shots.notes[len(photos.notes):]:
            say(note)
        found = evaluate_photos(svbrdf, fit, shots, make_renderer(renderer, variant),
                                Priors() if refine_views else None, chosen)
        shots = shots if chosen is None else shots.pick(chosen)
        seen = "" if found["rmse_seen"] is None else " (seen)"
        labels = {name: name + (" (held out)" if name in found["held_out"] else seen) for name in shots.names}
        _print_errors(found["views"], found, labels)
        if found["fitted_views"]:
            totals = ", ".join(f"{name} {error:.4f}" for name, error in _totals(found["calibrated"]).items())
            say(f"with {found['calibrated']['views']}: {totals}")
        if found["refined"]:
            _print_errors("views refined beside these maps", found["refined"], labels)
            for name, view in found["refined"]["views"].items():
                say(f"photo {name}: {_moved(view['change'])}")
        else:
            del found["refined"]  # not asked for
        seen_from = fit.known_views or shots.views
        del photos, shots  # frees memory for the burn-in
        found["burn_in"] = burn_in(svbrdf, seen_from)
        found["local_burn_in"] = local_burn_in(svbrdf, seen_from)
        print_numbers("Burn-in (0 is best)", found["burn_in"])
        print_numbers("Local burn-in (around 0 is best)", found["local_burn_in"])
    if json_file:
        files.write_json(json_file, found)
        say_written(json_file)
    return 0


def _print_errors(views: str, errors: dict, labels: Mapping[str, str]) -> None:
    each = {labels[name]: error for name, error in errors["per_photo"].items()}
    print_numbers(f"Re-rendering RMSE, {views}", each | _totals(errors))


def _totals(errors: dict) -> dict[str, float]:
    """The error over all photos. With both seen and held-out photos: the error of each group instead."""
    apart = {"seen": errors["rmse_seen"], "held out": errors["rmse_held_out"]}
    return {"all": errors["rerender_rmse"]} if None in apart.values() else apart


def _moved(change: dict[str, float]) -> str:
    camera, flash = (", ".join(f"{change[f'{what}_{axis}']:+.3f}" for axis in "xyz")
                     for what in ("camera", "flash"))
    light = math.exp(change["log_exposure"])
    return f"camera ({camera}), flash beside it ({flash}) patch sides, light x {light:.3f}"
