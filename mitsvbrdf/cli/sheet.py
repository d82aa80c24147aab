"""``mitsvbrdf sheet``: tags to print and lay around a material."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from ..capture.align.sheet import Paper
from ..io.progress import say, say_written
from .options import Overwrite, check_new_files


def sheet(out: Annotated[Path,
                         arg(aliases=["-o"], help="File to write: .pdf, .svg or .png.")] = Path("sheet.pdf"),
          size: Annotated[float, arg(
              help="Of the frame of tags, in cm; the material shown is 0.64 of it.")] = 18.0,
          paper: Annotated[Paper, arg(help="What the printer holds.")] = "a4",
          overwrite: Overwrite = False) -> int:
    """Write a sheet of AprilTags to print: laid around a material, it tells `mitsvbrdf capture --sheet CM`
    where the phone was.

    Print it at 100 %, cut the middle out, and measure the arrow: its length is CM.
    """
    from ..capture.align.sheet import write_sheet

    check_new_files(out, overwrite=overwrite)
    write_sheet(out, size, paper)
    say_written(out)
    say("print it at 100 %; what to do next stands on it")
    return 0
