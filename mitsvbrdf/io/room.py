"""Check, before a command begins, that its work fits into the memory of this machine and onto the disk."""

import math
import os
import shutil
from pathlib import Path

from ..errors import ConfigError
from .provenance import memory_gib

PROCESS = 0.7  # GiB of a process that has loaded torch and Mitsuba


def check_room(side: int, held: float, out: Path | None = None, written: float = 0.0) -> None:
    """Raise ConfigError, which names the size that would fit, where memory or disk do not suffice.

    Args:
        side: texels or pixels along a side of what the command works on.
        held: bytes of memory that each texel or pixel needs, as measured.
        out: where the command writes; None: it writes nothing large.
        written: bytes that the command writes for each texel or pixel.
    """
    memory = memory_gib()[1]
    rooms = [("memory", memory - PROCESS, held, PROCESS)]
    if out is not None:
        place = Path(os.path.realpath(out))
        there = next(folder for folder in (place, *place.parents) if folder.is_dir())
        rooms.append((f"space on the disk of {out}", shutil.disk_usage(there).free / 2**30, written, 0.0))
    for what, free, each, beside in rooms:
        if (needed := each * side**2 / 2**30) > free:
            fits = math.isqrt(int(max(free, 0.0) * 2**30 / each)) // 64 * 64
            way_out = f"--resolution {fits} fits" if fits else "free some"
            raise ConfigError(f"{needed + beside:.1f} GiB of {what} for {side} px",
                              f"{free + beside:.1f} GiB", way_out)
