"""Write a fit to a folder: maps, records, pictures, page."""

from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from .. import color
from ..capture import Capture
from ..errors import OutputError
from ..export.mitsuba import write_scene
from ..fit.confidence import of_texels
from ..fit.record import FILE
from ..fit.result import ALIKE, Fit
from ..io import images
from ..io.entry import entry
from ..io.files import write_json
from ..io.images import linear_writes
from ..io.progress import say
from ..io.results import output_folder
from ..material.map_files import DETAIL, save_maps
from ..material.resample import enlarged
from ..measure.rerender import batches
from .fit_page import check_apart, keep_photos, write_report
from .header import material_name
from .overview import write_sheet
from .pictures import at_most

SHEET = 512  # pixels a side of maps and photos for the sheet, at most


@entry()
def write_fit(result: Fit, capture: Capture, out: str | Path, command: dict | None = None,
              held_out: Capture | None = None, pages: bool = True, overwrite: bool = False) -> None:
    """Write a fit into a folder, which appears whole or not at all.

    The folder gets maps, detail, uncertainty, guess, photos, re-renderings, sheet, scene, ``fit.json``, page.

    Args:
        result: what :func:`mitsvbrdf.fit.fit_svbrdf` gave.
        capture: the photos it was fitted to.
        out: the folder; made if it is missing.
        command: options of the command line, kept in ``fit.json``.
        held_out: photos that the fit did not use, for the page to predict; see
            :func:`.fit_page.write_report`.
        pages: whether all of that is written; else maps, detail, uncertainty and ``fit.json`` alone.
        overwrite: whether an existing fit, finished or not, may be replaced.

    Raises:
        OutputError: there is a fit already; ``out`` cannot be written or is in use; or ``out``, or its
            ``photos/``, is the folder of the capture.
    """
    for shots in (capture, held_out) if pages else ():
        if shots is not None:
            check_apart(Path(out), shots)
    with output_folder(Path(out), overwrite) as folder:
        write_fit_files(result, capture, folder, command, held_out, pages)


def write_fit_files(result: Fit, capture: Capture, out: Path, command: dict | None = None,
                    held_out: Capture | None = None, pages: bool = True) -> None:
    """Write a fit, file by file, into a new folder; the arguments are those of :func:`write_fit`."""
    capture = capture.through(result.transfer)
    if pages:
        keep_photos(out, capture)
    stored = {"svbrdf": save_maps(result.svbrdf, out / "maps")}
    if result.detail:
        stored["detail"] = save_maps(result.detail, out / DETAIL)
    for folder, spreads in ((".", result.deviations), (ALIKE, result.deviations_with_look_alikes)):
        for name, spread in spreads.items():  # known at every k-th texel, interpolated between
            images.write_exr(out / "uncertainty" / folder / f"{name}.exr",
                             enlarged(of_texels(spread)[None], result.svbrdf.resolution)[0, ..., None])
    record = result.record | {"command": command or {}}
    write_json(out / FILE, record)
    if pages:
        _write_pages(result, Fit(record, out, {**result.known, **stored}), capture, out, held_out)


def _write_renderings(result: Fit, capture: Capture, out: Path) -> Tensor:
    """Write the re-rendered photos; return them for the sheet, N x S x S x 3 display values."""
    small = list[Tensor]()
    for part in batches(len(capture), result.svbrdf.resolution):
        writes = []
        for row in part:
            image = result.rerendering(row)
            writes += linear_writes(out / f"rerendered/{capture.names[row]}", image, capture.transfer)
            small.append(at_most(image, SHEET, partial(color.to_display, transfer=capture.transfer)))
        images.write_all(writes)
    return torch.stack(small)


def _write_pages(result: Fit, written: Fit, capture: Capture, out: Path, held_out: Capture | None) -> None:
    images.write_all(linear_writes(out / "guess/diffuse", result.guess, "srgb"))
    small = _write_renderings(result, capture, out)
    title = f"{material_name(result)}: {result.method}, {result.svbrdf.bsdf}"
    sure = result.record["confidence"]
    remarks = {name: f"{sure[name]['determined_share']:.0%} determined" if name in sure else
               "held fixed" if name in result.fixed else "deviation unknown" for name in result.svbrdf.maps}
    title = title.encode(errors="replace").decode()  # of a folder whose name is not UTF-8
    write_sheet(out / "sheet.png", result.svbrdf.resized(min(SHEET, result.svbrdf.resolution)),
                torch.stack([at_most(photo, SHEET, color.shown) for photo in capture.stored]), small,
                rmse=result.rerender_rmse, per_photo=result.per_photo, guess=at_most(result.guess, SHEET),
                names=capture.names, title=title, remarks=remarks)
    write_scene(out, result.svbrdf, result.views)
    # held-out photos of an earlier fit do not belong to this one
    (out / "report.json").unlink(missing_ok=True)
    try:
        write_report(written, quick=True, held_out=held_out)
    except OutputError:
        raise
    except Exception as reason:  # whatever it is: the result of a long fit is worth more than its page
        say(f"report.html could not be made ({type(reason).__name__}: {reason}); `mitsvbrdf report` tries "
            "again")
