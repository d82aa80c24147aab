"""``mitsvbrdf sheet``: a printable sheet of tags around a material."""

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from ..capture.align.sheet import Paper
from ..io.progress import say, say_written
from .options import Overwrite, check_new_files


def sheet(out: Annotated[Path,
                         arg(aliases=["-o"], help="File to write: .pdf, .svg or .png.")] = Path("sheet.pdf"),
          size: Annotated[float, arg(
              help="Size of the frame of tags in cm. The side of the patch is 0.64 times this size.")] = 18.0,
          paper: Annotated[Paper, arg(help="Paper in the printer.")] = "a4",
          overwrite: Overwrite = False) -> int:
    """Write a sheet of AprilTags to print.

    Print it at 100 %, cut the middle out, and lay the sheet around the material. Measure the printed arrow in
    cm. It is as long as the frame of tags. Give its length to `mitsvbrdf capture --sheet CM`.
    """
    from ..capture.align.sheet import write_sheet

    check_new_files(out, overwrite=overwrite)
    write_sheet(out, size, paper)
    say_written(out)
    say("print it at 100 %; it says what to do next")
    return 0
