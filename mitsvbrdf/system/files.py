"""Reading and writing images and JSON; every write goes beside its target and is then renamed onto it."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

from ..errors import OutputError


def write_json(path: Path, value: object) -> None:
    """Indented JSON; NaN and infinity are refused, since JSON has none."""
    write_bytes(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Replace a file's content in one step."""
    with beside(path) as temporary:
        temporary.write_bytes(data)


@contextlib.contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A temporary name in the same folder, renamed onto ``path`` when the block ends well, else removed.

    A symbolic link stays one: what it points to is replaced.

    Raises:
        OutputError: when the folder cannot be made or written to, or something other than a file has this name.
    """
    path, temporary = _places(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except OSError as reason:
        forbidden = reason.errno in (errno.EACCES, errno.EPERM, errno.EROFS)
        raise OutputError(f"to write {path}", reason.strerror or str(reason),
                          f"{'check your rights' if forbidden else 'free space'} or choose another place") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_output(*paths: Path | None) -> None:
    """Raise OutputError now for files that :func:`beside` could not write once the work is done; None stands for no file.

    Nothing is left behind, and folders that are missing are not made yet.
    """
    for path in filter(None, paths):
        target, temporary = _places(path)
        try:
            probe = next(folder for folder in target.parents if os.path.lexists(folder)) / temporary.name
            probe.touch()
            probe.unlink()
        except OSError as reason:
            raise OutputError(f"to write {path}", reason.strerror or str(reason), "choose another place") from None


def _places(path: Path) -> tuple[Path, Path]:
    """The file that a path stands for, links followed, and the temporary name beside it."""
    target = Path(os.path.realpath(path))
    if os.path.lexists(target) and not target.is_file():  # a rename would replace a device or a pipe by a file
        raise OutputError("a file to write", f"{path}, which is {'a folder' if target.is_dir() else 'no regular file'}",
                          "give another name")
    return target, target.with_name(f".{target.stem}-{uuid.uuid4().hex[:8]}{target.suffix}")
