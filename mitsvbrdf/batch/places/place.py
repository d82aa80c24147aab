"""Where the results of a library lie: a folder that all workers see, or an object store behind fsspec (``s3://``, ``gs://``).

A result is made in a folder of its own beside the library's materials and appears whole: in a folder by one rename, in a store
by its record, :data:`RECORD`, which is written last and without which the rest counts for nothing.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import uuid
from pathlib import Path
from typing import Protocol

from ...errors import OutputError
from ...system.files import file_hash
from ...system.json_files import load

RECORD = "batch.json"  # of a result: which capture and options it is of, and what its files hold
WORK, QUARANTINE = ".work", "quarantine"
ASIDE = re.compile(r".+-[0-9a-f]{8}\.damaged[0-9]*")  # names of results that were set aside


class Place(Protocol):
    """What a library's place offers; a result is named by its folder there."""

    def staging(self, attempt: str) -> Path:
        """An empty local folder to make a result in."""
        ...

    def publish(self, staging: Path, folder: str) -> bool:
        """Let a result appear under its name; False, and nothing changes, where one is there."""
        ...

    def record(self, folder: str) -> dict | None:
        """The record of a result that is there; None where none is, or not a whole one."""
        ...

    def damage(self, folder: str, record: dict, hashes: bool) -> str:
        """What is wrong with a result's files, in words: sizes, with ``hashes`` also content; empty where nothing is."""
        ...

    def set_aside(self, folder: str) -> None:
        """Take a result that is not whole out of the way, without losing it."""
        ...

    def aside(self) -> list[str]:
        """The folders of what was set aside."""
        ...

    def remove(self, folder: str) -> None:
        """Delete a result, or what was set aside."""
        ...


class LocalPlace:
    """A folder, on a file system that all workers share."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def staging(self, attempt: str) -> Path:
        """An empty folder inside the library, so that publishing is a rename."""
        folder = self.root / WORK / attempt
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        _begun(folder).touch()
        return folder

    def publish(self, staging: Path, folder: str) -> bool:
        """One rename, after all files are on the disk; a whole result is never replaced.

        Raises:
            OutputError: a newer batch took the staging folder away meanwhile; what is there now may lack files.
        """
        for path in (*staging.rglob("*"), staging):
            _to_disk(path)
        try:
            _begun(staging).unlink()
        except FileNotFoundError:
            raise OutputError("the folder that the result was made in", f"{staging}, taken away meanwhile",
                              "a newer batch fits this capture") from None
        try:
            os.rename(staging, self.root / folder)
        except OSError as reason:
            if self.record(folder) is not None:
                return False
            if reason.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                raise
            self.set_aside(folder)  # something that is no result has its name
            os.rename(staging, self.root / folder)
        with contextlib.suppress(OSError):  # it is there; some file systems cannot do this to a folder
            _to_disk(self.root)
        return True

    def record(self, folder: str) -> dict | None:
        """The record in the folder."""
        try:
            found = load(self.root / folder / RECORD)
            kinds = {"identity": str, "attempt": str, "row": dict, "files": dict}
            return found if all(isinstance(found[name], kind) for name, kind in kinds.items()) else None
        except (OSError, ValueError, KeyError):
            return None

    def damage(self, folder: str, record: dict, hashes: bool) -> str:
        """The first file that is missing or another one."""
        for name, stated in record["files"].items():
            path = self.root / folder / name
            try:
                same = path.lstat().st_size == stated["bytes"] and not path.is_symlink()
                if not same or hashes and file_hash(path) != stated["sha256"]:
                    return f"{name} has changed"
            except OSError:
                return f"{name} is missing"
        return ""

    def set_aside(self, folder: str) -> None:
        """A rename to ``NAME.damaged``, numbered where there is one."""
        path, count = self.root / folder, 0
        while os.path.lexists(aside := path.with_name(f"{path.name}.damaged{count or ''}")):
            count += 1
        with contextlib.suppress(FileNotFoundError):
            os.rename(path, aside)

    def aside(self) -> list[str]:
        """Those with a name that :meth:`set_aside` gives."""
        return sorted(path.name for path in self.root.iterdir() if ASIDE.fullmatch(path.name))

    def remove(self, folder: str) -> None:
        """Its record first, so that half a result never passes for one."""
        path = self.root / folder
        if path.is_dir() and not path.is_symlink():
            (path / RECORD).unlink(missing_ok=True)
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _begun(staging: Path) -> Path:
    """Stands beside a staging folder for as long as it is the one that was made."""
    return staging.with_name(f"{staging.name}.begun")


def clear_work(home: Path) -> None:
    """Take away all that was being made; renamed first, so that a worker that outlived its batch has nothing to publish."""
    with contextlib.suppress(FileNotFoundError):
        os.rename(home / WORK, home / f"{WORK}-{uuid.uuid4().hex[:8]}")
    for old in home.glob(f"{WORK}-*"):
        shutil.rmtree(old, ignore_errors=True)


def _to_disk(path: Path) -> None:
    """Have a file or folder written, not only promised."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
