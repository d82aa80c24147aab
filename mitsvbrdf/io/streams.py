"""Standard streams of a command: a closed or full one neither ends the work nor sends output into a file."""

import io
import os
import sys
from typing import Any

from . import files


class Unfailing(io.FileIO):
    """A stream to write to that never raises: after the first failure it drops what is written."""

    failure: OSError | None = None

    def write(self, data: Any, /) -> int:
        """Write, and return the number of bytes taken; after a failure all of them, which are dropped."""
        if self.failure is None:
            try:
                return super().write(data)
            except OSError as reason:
                self.failure = reason
        return len(data)


def guard_streams() -> None:
    """Let no standard stream of this process fail; call it before any file is opened.

    A closed stream's number is occupied. Else the next file would get the number, and what libraries print.
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
    """Say where standard output is cut short; returns the exit code for a command that ended with ``code``.

    A closed pipe does not count: the reader has seen enough. If no file was written, standard output was the
    result, and success becomes 2.
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
