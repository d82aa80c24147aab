"""Standard streams of a command: if one is closed or full, work goes on, and no file gets its output."""

import io
import os
import sys
from typing import Any

from . import files


class Unfailing(io.FileIO):
    """An output stream that never raises: after the first failure it drops all further output."""

    failure: OSError | None = None

    def write(self, data: Any, /) -> int:
        """Write, and return the number of bytes written; after a failure, of bytes dropped."""
        if self.failure is None:
            try:
                return super().write(data)
            except OSError as reason:
                self.failure = reason
        return len(data)


def guard_streams() -> None:
    """Make the standard streams of this process never fail. Call it before any file is opened.

    A closed stream's number is occupied: else a file opened later would get it, and what libraries print.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:  # takes the lowest free number; writing fails, as to a closed stream
            os.open(os.devnull, os.O_RDONLY)
    for name, number, errors in (("stdout", 1, "replace"), ("stderr", 2, "backslashreplace")):
        given = getattr(sys, name)
        buffer = io.BufferedWriter(Unfailing(number, "w", closefd=False))
        lines = given is not None and (given.line_buffering or given.write_through)
        setattr(sys, name, io.TextIOWrapper(buffer, given.encoding if given else "utf-8", errors,
                                            line_buffering=lines))


def told(code: int) -> int:
    """Print a message if standard output was cut short; return the exit code. ``code``: that of the command.

    A closed pipe does not count: its reader needs no more. If no file was written, standard output was the
    result, and the exit code is 2 instead of 0.
    """
    sys.stdout.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    failure = getattr(raw, "failure", None)
    if failure is None or isinstance(failure, BrokenPipeError):
        return code
    reason = failure.strerror or failure
    if files.wrote.is_set():
        print(f"warning: standard output is cut short: {reason}; written files are whole", file=sys.stderr)
        return code
    print(f"error: expected to write standard output, got {reason}; free space or choose another place",
          file=sys.stderr)
    return code or 2
