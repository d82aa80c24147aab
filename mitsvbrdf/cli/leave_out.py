"""``mitsvbrdf leave-out``: what leaving out saves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from ..errors import ConfigError
from ..io import files
from ..io.progress import say, say_written
from .measuring import measure, outlook
from .options import Overwrite, check_new_files


def leave_out(
    resolution: Annotated[int, arg(help="Side of the maps in texels.")] = 256,
    repeats: Annotated[int, arg(help="Measured turns of each pair.")] = 9,
    json_file: Annotated[Path, arg(name="json", help="The file of all records; one that is there is gone on "
                                                     "with.")]
        = Path("out/leave-out.json"),
    fits: Annotated[bool, arg(help="Measure the parts of fits too: about an hour, half of it with two "
                                   "workers.")] = False,
    fit_resolution: Annotated[int, arg(help="Side of the maps of these fits, in texels.")] = 64,
    fit_repeats: Annotated[int, arg(help="Turns of each pair of these fits.")] = 3,
    parts: Annotated[str | None, arg(metavar="A,B,...", help="Parts of fits; left out: all.")] = None,
    captures: Annotated[str | None, arg(metavar="A,B,...", help="Real captures to fit too, by name in "
                                                                "--data, each half as "
                                        "long again; what the program leaves out of them by itself is not "
                                        "put in. Left out: "
                                        "none.")] = None,
    data: Annotated[Path | None, arg(help="Folder with captures/; left out: MITSVBRDF_DATA.")] = None,
    workers: Annotated[int | None,
                       arg(help="Do so many pairs of fits at a time, on the workers of `mitsvbrdf batch`. "
                                "Needs Ray.")] = None,
    page_only: Annotated[bool, arg(help="Measure nothing: only show the file and make --md of it.")] = False,
    md: Annotated[Path | None, arg(help="Write the page to this file, as Markdown.")] = None,
    anew: Annotated[bool, arg(help="Forget the records that are there.")] = False,
    overwrite: Annotated[Overwrite, arg(help="Replace a page that is there; records stay.")] = False,
) -> int:
    """Measure what is left out of a scene that does not need it: image difference, and time with and without.

    Each item is rendered forward and backward through nine co-located views, with it and without it in turn.
    With --fits each part of a fit is left out too, on made photos of several kinds and on real captures.

    Each measurement is kept as soon as it is there: Ctrl-C loses one, and the same command goes on. Nothing
    else should run meanwhile.
    """
    from ..batch.settings import BatchSettings
    from ..bench.leave_out.page import print_leave_out, write_leave_out_page
    from ..bench.leave_out.plan import SHAPING, LeaveOutPlan, capture_folders
    from ..bench.store import Store, read_benchmark

    check_new_files(md, overwrite=overwrite, read=[json_file])
    files.check_output(json_file)
    if not fits and (parts, captures, workers) != (None, None, None):
        raise ConfigError("--fits beside --parts, --captures and --workers", "no --fits", "add --fits")
    BatchSettings(workers=workers).check()
    if page_only:
        record, failed = read_benchmark(json_file), False
    else:
        named = None if parts is None else [name.strip() for name in parts.split(",") if name.strip()]
        plan = LeaveOutPlan(fits, resolution, repeats, fit_resolution, fit_repeats, named,
                            capture_folders(captures, data))
        pairs, settings, _ = plan.jobs()
        store = Store(json_file, settings, anew, SHAPING)
        if fits:
            say(f"pairs of fits, after the renders: {outlook(pairs, store, workers)}")
        lost = [measure(plan, plan.renders(), store)]
        if fits and lost[0] is not None:
            lost.append(measure(plan, pairs, store, workers))
        if None in lost:
            return 130
        record, failed = store.content, any(lost)
    print_leave_out(record)
    if md:
        write_leave_out_page(md, record)
        say_written(md)
    return int(failed)
