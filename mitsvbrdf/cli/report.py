"""``mitsvbrdf report``: make the page of a fit again, from the folder of the fit."""

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..errors import MapsError
from ..io import results
from ..io.progress import print_numbers, progress_bar, say, say_written
from .options import Strict, keep_apart


def report(out: Positional[Annotated[Path, arg(metavar="OUT", help="The folder of a fit.")]],
           capture: Annotated[Path | None, arg(metavar="CAPTURE", help=(
               "Folder of the photos. The page shows the photos of the fit and predicts the others."))
           ] = None,
           quick: Annotated[bool, arg(
               help="Check only the renderer of the fit, on small maps, without timing.")] = False,
           strict: Strict = False) -> int:
    """Write OUT/report.html, a page about the fit that opens from disk, and OUT/report.json, its numbers.

    `fit` writes them too, with fewer checks. This command compares every renderer with float64, for the
    fitted maps and the views of the fit.
    """
    from ..capture import read_capture
    from ..fit.result import Fit
    from ..report.fit_page import check_photos, keep_photos, write_report
    from ..report.page import figure

    found = Fit.load(out)
    if not (out / "rerendered").is_dir():
        raise MapsError("a fit with its pictures", f"{out}, which has no rerendered/",
                        "fit it again; a batch writes them with --pages all")
    held_out = None
    if capture is not None:
        keep_apart(capture, out)
        about = found.record["capture"]
        shots = read_capture(capture, resolution=about["resolution"], transfer=found.transfer,
                             falloff=found.falloff)
        used = shots.pick(found.seen)
        check_photos(found, used)
        others = [number for number in shots.index if number not in found.seen]
        held_out = shots if others else None
    with results.output_folder(out, overwrite=False, add=True) as folder:
        if capture is not None:
            keep_photos(folder, used)
        with progress_bar(f"report {out.name}") as tell:
            record = write_report(out, quick, held_out, tell, folder)
    if record["held_out_rmse"] is not None:
        missed = {photo["name"]: photo["rmse"] for photo in record["photos"] if photo["held_out"]}
        print_numbers("Re-rendering RMSE, held out", missed | {"all": record["held_out_rmse"]})
    if record["crosscheck"]:
        for found_wrong in record["crosscheck"]["violations"]:
            say(f"exceeded: {found_wrong['renderer']}: {found_wrong['what']} {found_wrong['value']:.3g} > "
                f"{figure(found_wrong['tolerance'])}")
    say_written(out / "report.html", out / "report.json")
    return 0
