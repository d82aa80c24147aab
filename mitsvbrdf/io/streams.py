"""Standard streams of a command: closed or full ones neither end the work nor take the place of a file."""

from __future__ import annotations

import io
import os
import sys
from typing import Any

from . import files


class Unfailing(io.RawIOBase):
    """A stream to write to that never raises: after the first failure it drops what is written."""

    def __init__(self, raw: Any) -> None:
        self.raw = raw
        self.failure: OSError | None = None

    def write(self, data: Any) -> int | None:
        """Bytes taken; all of them where there is nowhere to put them."""
        if self.failure is None:
            try:
                return self.raw.write(data)
            except OSError as reason:
                self.failure = reason
        return len(data)

    def writable(self) -> bool:
        """It is."""
        return True

    def fileno(self) -> int:
        """The file descriptor below."""
        return self.raw.fileno()

    def isatty(self) -> bool:
        """Whether a terminal shows it."""
        return self.raw.isatty()


def guard_streams() -> None:
    """Let no standard stream of this process fail; call it before any file is opened.

    The number of a closed stream is taken, else the next file would get it and hold what libraries print.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:  # takes the lowest free number; writing to it fails as it would to a closed one
            os.open(os.devnull, os.O_RDONLY)
    if sys.stdin is None:
        sys.stdin = open(0, closefd=False)
    sys.stdout = _guarded(sys.stdout, 1, "replace")
    sys.stderr = _guarded(sys.stderr, 2, "backslashreplace")


def _guarded(stream: Any, number: int, errors: str) -> Any:
    if stream is not None and not isinstance(stream, io.TextIOWrapper):
        return stream  # of an environment of its own
    if stream is None:
        raw: Any = io.FileIO(number, "w", closefd=False)
        return io.TextIOWrapper(io.BufferedWriter(Unfailing(raw)), "utf-8", errors)
    stream.flush()
    raw = getattr(stream.buffer, "raw", stream.buffer)
    return io.TextIOWrapper(io.BufferedWriter(Unfailing(raw)), stream.encoding, errors,
                            line_buffering=stream.line_buffering or stream.write_through)


def told(code: int) -> int:
    """Say where standard output is cut short; returns the exit code for a command that ended with ``code``.

    A reader that has seen enough cuts nothing short. Without a written file, standard output was the result:
    success becomes 2.
    """
    sys.stdout.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    failure = raw.failure if isinstance(raw, Unfailing) else None
    if failure is None or isinstance(failure, BrokenPipeError):
        return code
    reason = failure.strerror or failure
    if files.wrote.is_set():
        print(f"warning: standard output is cut short: {reason}; results are not", file=sys.stderr)
        return code
    print(f"error: expected to write standard output, got {reason}; free space or choose another place",
          file=sys.stderr)
    return code or 2
