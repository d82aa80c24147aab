"""The page of a fit: made from the files in its folder, so that it can be made again at any time.

The module also writes the page of plausible detail, which is for pictures only.
"""

import dataclasses
import os
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from .. import color
from ..capture import Capture
from ..errors import CaptureError, MapsError, OutputError
from ..evaluate.placement import placed
from ..fit.confidence import UNKNOWN, of_texels
from ..fit.diagnose import about_views
from ..fit.result import Fit
from ..io import Report, files, images
from ..io.json import load
from ..material.maps import CHANNELS, TITLES, shown_map
from ..measure.metrics import of_all, photo_rmse
from ..measure.rerender import rerender
from ..render import Renderer
from ..render.analytic import AnalyticRenderer
from ..views import Views, shift_lights
from .checks import fit_report
from .curves import error_and_losses
from .header import header, material_name
from .page import write_page
from .pictures import at_most, magma, picture_uri
from .viewer import viewer_html

LARGEST_MAP = 512  # pixels a side on the page
# a map of up to this many bytes is a PNG, which shows exact texels; every map of 256 px is
EXACT_MAP = 256 * 1024
LARGEST_PHOTO, SMALLEST_PHOTO, PHOTOS_WIDE = 512, 96, 768  # nine photos get 256 px, a hundred 96
# allowed difference of a photo's error from that in fit.json; the same photos agree to float32, 1e-7
SAME_PHOTO = 1e-4


def check_apart(folder: Path, capture: Capture) -> None:
    """Raise OutputError for a folder where :func:`keep_photos` would replace the capture's own files."""
    source = capture.source and os.path.realpath(capture.source)
    if source in (os.path.realpath(folder), os.path.realpath(folder / "photos")):
        raise OutputError("an output folder of its own", f"{folder}, where the capture's own photos would be "
                          "replaced", "choose another folder")


def keep_photos(folder: Path, capture: Capture) -> None:
    """Write ``photos/NN.png``, display values of 8 bits. OutputError: the folder is that of the photos."""
    check_apart(folder, capture)
    def write(name: str, row: int) -> None:
        images.write_png(folder / "photos" / f"{name}.png", capture.stored[row], shown=color.shown)

    images.write_all([partial(write, name, row) for row, name in enumerate(capture.names)])


def write_report(fit: Fit | str | Path, quick: bool = False, held_out: Capture | None = None,
                 report: Report = lambda text, share: None, into: Path | None = None) -> dict:
    """Check a fit's renderers, and write ``report.json`` and ``report.html`` into its folder.

    Args:
        fit: the fit or its folder; its photos are shown if they are in ``photos/`` there.
        quick: check the fit's renderer alone, on small maps and few views, without run times.
        held_out: photos that the fit did not use, to predict and keep; None: those of an earlier page. If the
            capture states no views, add the photos that the fit used: they help to estimate the views.
        into: the folder to write to; photos there are preferred to those of the fit; default: the fit's.

    Returns the content of ``report.json``.

    Raises:
        MapsError: not the folder of a fit.
        OutputError: the folder cannot be written, or another fit was put there meanwhile.
        BackendError: the fit's renderer does not work here.
    """
    found = fit if isinstance(fit, Fit) else Fit.load(fit)
    engine, into = found.engine(), into or found.path
    predicted, error = (_earlier(found) if held_out is None or engine is None
                        else _predicted(found, held_out, engine, into))
    photos = [{"name": name, "held_out": False, "rmse": rmse, "rerendered": f"rerendered/{name}.png",
               "photo": _there(f"photos/{name}.png", into, found.path)}
              for name, rmse in found.record["per_photo"].items()]
    measured = fit_report(found.svbrdf, found.views, engine, names=found.names,
                          transfer=found.record["capture"]["transfer"], quick=quick, report=report)
    if found is not fit and not found.unchanged():
        raise OutputError("the same fit as a moment ago", f"another one in {found.path}", "run it again")
    record = measured | {"photos": photos + predicted, "held_out_rmse": error}
    files.write_json(into / "report.json", record)
    _write_page(found, record, into)
    return record


def check_photos(found: Fit, capture: Capture) -> None:
    """Raise CaptureError unless calibration, number, size and errors of the photos are those of the fit."""
    told, way_out = found.record["capture"], "give the capture that was fitted"
    if capture.calibrated != told["calibrated"]:
        wanted, got = ("without", "one") if capture.calibrated else ("with", "none")
        raise CaptureError(f"a capture {wanted} calibration, as that of this fit",
                           f"{capture.source}, which has {got}", way_out)
    if len(found.names) != len(capture) or (side := len(found.rerendering(0))) != capture.resolution:
        raise CaptureError(f"{len(found.names)} photos of {side} px",
                           f"{len(capture)} of {capture.resolution} px in {capture.source}", way_out)
    for row, (name, stated) in enumerate(zip(found.names, found.per_photo)):
        one = capture.pick([capture.index[row]])
        error = photo_rmse(found.rerendering(row)[None], one.stored, told["transfer"], one.measured)[0]
        if abs(error - stated) > SAME_PHOTO:
            raise CaptureError("the photos of this fit", f"{capture.source}, whose photo {name} is another "
                               f"(error {error:.4f} instead of {stated:.4f})", way_out)


def _there(name: str, *folders: Path) -> str | None:
    return name if any((folder / name).is_file() for folder in folders) else None


def _predicted(found: Fit, capture: Capture, engine: Renderer, into: Path) -> tuple[list[dict], float]:
    capture = placed(capture, found)
    capture = capture.pick([number for number in capture.index if number not in found.seen])
    keep_photos(into, capture)
    material, each = found.svbrdf.resized(capture.resolution), list[float]()
    lit = shift_lights(capture.views, found.flash_offset)
    for row, (number, name) in enumerate(zip(capture.index, capture.names)):
        image, error, _ = rerender(engine, material, lit.pick([row]), capture.pick([number]))
        each.append(error)
        images.write_png(into / "predicted" / f"{name}.png", image[0],
                         shown=partial(color.to_display, transfer=capture.transfer))
    return [*map(_held_out, capture.names, each)], of_all(each, capture.measured)


def _held_out(name: str, rmse: float) -> dict:
    return {"name": name, "held_out": True, "rmse": rmse, "photo": f"photos/{name}.png",
            "rerendered": f"predicted/{name}.png"}


def _earlier(found: Fit) -> tuple[list[dict], float | None]:
    """Held-out photos that an earlier page of this folder had."""
    try:
        record = load(found.path / "report.json")
        photos = [_held_out(f"{int(photo['name']):02d}", photo["rmse"] + 0.0) for photo in record["photos"]
                  if photo["held_out"] is True]
        error = record["held_out_rmse"] + 0.0 if photos else None
    except (OSError, ValueError, KeyError, TypeError):
        return [], None
    there = all(_there(photo[part], found.path) for photo in photos for part in ("photo", "rerendered"))
    return (photos, error) if there else ([], None)


def _write_page(found: Fit, record: dict, into: Path) -> None:
    fit = found.record
    side = int(max(SMALLEST_PHOTO, min(LARGEST_PHOTO, PHOTOS_WIDE / len(record["photos"])**0.5)))
    write_page(into / "report.html", "report/report.html", fit=fit, record=record, fixed=found.fixed,
               title=f"{material_name(found)}: recovered material",
               maps=_maps(found), front=header(found, record["quick"]), metres=found.side_metres,
               viewer=viewer_html(found.svbrdf),
               photos=[_photo(photo, side, into, found.path) for photo in record["photos"]],
               curves=error_and_losses(fit["trace"]),
               ramp=picture_uri(magma(torch.linspace(0, 1, 256).expand(8, 256))), unknown=UNKNOWN,
               titles=TITLES, detail=write_detail_page(found, into), scalar=_scalar,
               from_where=about_views(fit.get("calibration") or {}))


def _maps(found: Fit) -> list[dict]:
    """A dict for each map: name, title, picture, and a picture of its standard deviation or None."""
    maps = []
    for name in CHANNELS[found.svbrdf.bsdf]:
        spread = found.deviations.get(name)
        sure = None if spread is None else at_most(of_texels(spread)[..., None] / UNKNOWN, LARGEST_MAP)
        maps.append({"name": name, "title": TITLES[name], "picture": _map_uri(name, found.svbrdf[name]),
                     "spread": None if sure is None else picture_uri(magma(sure[..., 0]))})
    there = (found.path / "guess" / "diffuse.exr").is_file()
    if there and "diffuse" not in found.fixed:  # else the guess is that map
        maps.append({"name": None, "title": "Guessed diffuse", "spread": None,
                     "picture": _map_uri("diffuse", found.guess)})
    return maps


def _map_uri(name: str, value: Tensor) -> str:
    return picture_uri(at_most(value, LARGEST_MAP, partial(shown_map, name)), EXACT_MAP)


def _photo(photo: dict, side: int, *folders: Path) -> dict:
    """Pictures of a photo, its re-rendering, and four times their difference, as far as files exist."""
    def read(name: str) -> Tensor:
        folder = next((each for each in folders if (each / name).is_file()), folders[-1])
        return images.read_image(folder / name, MapsError)

    rendered = read(photo["rerendered"])
    pictures = {"rerendered": picture_uri(at_most(rendered, side)), "photo": None, "difference": None}
    if photo["photo"]:
        seen = read(photo["photo"])
        if seen.shape != rendered.shape:
            raise MapsError(f"{photo['photo']} as large as {photo['rerendered']}",
                            f"{tuple(seen.shape[:2])} beside {tuple(rendered.shape[:2])} in {folders[-1]}",
                            "add --capture with the photos of the fit")
        pictures |= {"photo": picture_uri(at_most(seen, side)),
                     "difference": picture_uri(at_most(seen.sub_(rendered).abs_().mul_(4), side))}
    return photo | {"pictures": pictures, "side": min(side, rendered.shape[0])}


def _scalar(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_scalar, value)) or "–"
    return "–" if value is None else str(value)


DETAIL_PAGE = "detail.html"


def write_detail_page(found: Fit, into: Path) -> str | None:
    """Write ``detail.html``, the page of plausible detail; return its name, or None for a fit without it."""
    if found.detail is None:
        return None
    assert found.transfer is not None  # a fit's record has it
    view, settings = unseen_view(found.views), found.record["detail"]
    engine, transfer = found.engine() or AnalyticRenderer(), found.transfer
    with torch.no_grad():
        relit = [(title, picture_uri(at_most(color.to_display(engine.render(svbrdf, view)[0], transfer),
                                             LARGEST_MAP)))
                 for title, svbrdf in (("maps/", found.svbrdf), ("detail/", found.detail))]
    maps = [(TITLES[name], picture_uri(at_most(shown_map(name, found.detail[name]), LARGEST_MAP)))
            for name in CHANNELS[found.detail.bsdf]]
    write_page(into / DETAIL_PAGE, "report/detail.html", title=f"{material_name(found)}: plausible detail",
               detail=settings, maps=maps, relit=relit, solved_rmse=found.rerender_rmse,
               viewer=viewer_html(found.detail))
    return DETAIL_PAGE


def unseen_view(views: Views) -> Views:
    """The mean view of two photos: of all pairs, the one whose camera is farthest from its nearest camera."""
    pairs = torch.combinations(torch.arange(len(views)), with_replacement=True)
    camera, light, intensity = (x[pairs].mean(dim=1) for x in (views.camera, views.light, views.intensity))
    farthest = int(torch.cdist(camera, views.camera).amin(dim=1).argmax())
    between = dataclasses.replace(views, camera=camera, light=light, intensity=intensity)
    return between.pick([farthest])
