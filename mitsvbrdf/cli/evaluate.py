"""``mitsvbrdf evaluate``: maps measured against known maps or photos."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from ..errors import ConfigError
from ..render import RendererName, make_renderer
from ..system import files
from ..system.progress import print_numbers, say, say_written
from .options import (
    FalloffOption,
    Material,
    TransferOption,
    Variant,
    ViewList,
    fit_of_maps,
    material_of,
    photo_numbers,
    read_photos,
)


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
    from ..calibrate.refine import Priors
    from ..evaluate import evaluate_capture, evaluate_maps, placed
    from ..measure.burn_in import burn_in
    from ..measure.metrics import map_rmse

    if (reference is None) == (capture is None):
        raise ConfigError("either --reference or --capture", "both" if reference else "neither", "give one of them")
    if refine_views and capture is None:
        raise ConfigError("--capture beside --refine-views", "--reference", "give the photos whose views to refine")
    files.check_output(json_file)
    svbrdf = material_of(maps)
    found: dict[str, Any]
    if reference is not None:
        found = map_rmse(svbrdf, material_of(reference)) if reference.startswith("builtin:") else evaluate_maps(
            svbrdf, reference)
        print_numbers("Map RMSE", found)
    elif capture is not None:
        fit = fit_of_maps(maps)
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


def _moved(change: dict[str, float]) -> str:
    camera, flash = (", ".join(f"{change[f'{what}_{axis}']:+.3f}" for axis in "xyz") for what in ("camera", "flash"))
    return f"camera ({camera}), flash beside it ({flash}) patch sides, light x {math.exp(change['log_exposure']):.3f}"
