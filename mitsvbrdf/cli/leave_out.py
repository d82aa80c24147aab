"""``mitsvbrdf leave-out``: what leaving out saves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from ..errors import ConfigError
from ..system import files
from ..system.progress import print_rich, say, say_written
from .options import Overwrite, check_new_files

if TYPE_CHECKING:
    from rich.table import Table


def leave_out(resolution: Annotated[int, arg(help="Side of the maps in texels.")] = 256,
              repeats: Annotated[int, arg(help="Measured turns of each pair.")] = 9,
              json_file: Annotated[Path | None, arg(name="json", help="Write the figures to this file.")] = None,
              fits: Annotated[bool, arg(help="Measure the parts of fits too: hours, by the number of captures.")] = False,
              fit_resolution: Annotated[int, arg(help="Side of the maps of these fits, in texels.")] = 64,
              fit_repeats: Annotated[int, arg(help="Turns of these fits.")] = 3,
              captures: Annotated[str | None, arg(metavar="A,B,...", help="Real captures to fit too, by name in --data; left "
                                                                         "out: all of them.")] = None,
              data: Annotated[Path | None, arg(help="Folder with captures/; left out: MITSVBRDF_DATA.")] = None,
              md: Annotated[Path | None, arg(help="Write the table to this file, as Markdown.")] = None,
              overwrite: Overwrite = False) -> int:
    """Measure what is left out of a scene that does not need it: image difference, and time with and without.

    Each item is rendered forward and backward through nine co-located views, with it and without it in turn. With --fits
    each part of a fit is left out too, on made photos of several kinds and on real captures.
    """
    from rich.table import Table

    from ..bench import leave_out_fits as of_fits
    from ..verify.leave_out import measure_leave_out
    from ..verify.leave_out_page import leave_out_rows, write_leave_out_markdown

    if min(resolution, fit_resolution) < 8 or min(repeats, fit_repeats) < 1:
        raise ConfigError("--resolution of 8 or more and --repeats of 1 or more", f"{resolution} and {repeats}", "try 64 and 3")
    check_new_files(json_file, md, overwrite=overwrite)
    folders = of_fits.capture_folders(captures, data) if fits else []
    record = measure_leave_out(resolution, repeats, lambda what: say(f"measuring: {what}"))
    if fits:
        record["fits"] = of_fits.measure_fits(of_fits.parts(), list(of_fits.scenes(fit_resolution, folders)), fit_repeats,
                                              lambda what: say(f"fitting: {what}"))
    table = Table(title="Left out: largest relative difference, median seconds forward and backward", title_justify="left")
    for heading in ("what", "where", "difference", "full", "lean", "full / lean"):
        table.add_column(heading, justify="left" if heading in ("what", "where") else "right")
    for what, where, _, difference, _, _, *times in leave_out_rows(record):
        table.add_row(what, where, difference, *times)
    if json_file:
        files.write_json(json_file, record)
    if md:
        write_leave_out_markdown(md, record)
    print_rich(table)
    if fits:
        print_rich(_fit_table(record["fits"]))
    say_written(json_file, md)
    return 0


def _fit_table(record: dict) -> Table:
    """What leaving out parts of fits saves; their errors are in the files."""
    from rich.table import Table

    from ..verify.leave_out_page import fit_rows

    table = Table(title="Left out of a fit: seconds with it over those without", title_justify="left")
    for heading in ("what", "method", "of", "with / without", "verdict"):
        table.add_column(heading)
    for what, method, kind, _, ratio, *_, verdict in fit_rows(record):
        table.add_row(what, method, kind, ratio, verdict)
    return table
