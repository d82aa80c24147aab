"""A file that several processes change, each in its turn: read, changed and replaced under a lock."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

from ..errors import OutputError
from .files import check_output


@contextlib.contextmanager
def held(path: Path) -> Iterator[None]:
    """Let no other process that asks for the same have a file until the block is done; waits for its turn.

    The lock is on the file itself, so nothing lies beside it. One that is missing is there, and empty, inside
    the block; what is empty at the end is taken away again. The block may replace the file. On Windows
    nothing is held.

    Raises:
        OutputError: the file can neither be opened nor made, or is none.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    check_output(path)  # to open a pipe would wait for its reader
    path = Path(os.path.realpath(path))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = _newest(path, fcntl.flock, fcntl.LOCK_EX)
    except OSError as reason:
        raise OutputError(f"to write {path}", reason.strerror or str(reason),
                          "choose another place") from None
    with lock:
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                if not path.stat().st_size:
                    path.unlink()


def _newest(path: Path, flock: Callable[[IO[bytes], int], None], how: int) -> IO[bytes]:
    """The file that has this name, open and locked; while we waited another one may have taken its place."""
    while True:
        lock = path.open("ab")
        flock(lock, how)
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(lock.fileno()), path.stat()):
                return lock
        lock.close()
