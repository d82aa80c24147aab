"""Where the results of a library lie: a folder that all workers see, or an object store behind fsspec
(``s3://``, ``gs://``).

A result is made in a folder of its own beside the library's materials and appears whole: in a folder by one
rename, in a store by its record, :data:`RECORD`, which is written last and without which the rest counts for
nothing.
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
from ...io.files import file_hash, inside, is_entry, is_regular, stays_inside, to_disk
from ...io.json import load, shape_error

RECORD = "batch.json"  # of a result: which capture and options it is of, and what its files hold
WORK, QUARANTINE = ".work", "quarantine"
ASIDE = re.compile(r".+-[0-9a-f]{8}\.damaged[0-9]*")  # names of results that were set aside


NOTHING = type(None)
# What is counted on in a record's row, where it is stated, and in the record.
ROW = dict.fromkeys(("error", "left_out_error", "burn_in", "seconds", "peak_bytes", "photos", "resolution"),
                    (int, float, NOTHING)) | {
    "warnings": (list,), "preview": (str, NOTHING), "report": (str, NOTHING), "date": (str, NOTHING)}
SHAPE = {"identity": str, "attempt": str, "row": dict, "files": {str: {"bytes": int, "sha256": str}}}
ATTEMPT = re.compile(r"(.*-)?[0-9]{1,9}")


def checked_name(folder: str) -> str:
    """The name of a result.

    Raises:
        OutputError: it leads elsewhere, or stands for several as a pattern.
    """
    if not is_entry(folder):
        raise OutputError("the name of a result", repr(folder), "leave this library alone, or make its "
                                                                "manifest anew")
    return folder


def checked_record(found: dict) -> dict | None:
    """A record; None where it is not one, or names files that are not inside its folder."""
    if shape_error(found, SHAPE) or not ATTEMPT.fullmatch(found["attempt"]) or not all(map(stays_inside,
                                                                                      found["files"])):
        return None
    return None if shape_error(found["row"], {name: ROW[name] for name in found["row"] if name in ROW}) else found


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
        """What is wrong with a result's files, in words: sizes, with ``hashes`` also content; empty where
        nothing is.
        """
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
        folder = inside(self.root, f"{WORK}/{attempt}")
        if folder is None:
            raise OutputError(f"a folder {WORK} in the library", f"a link in {self.root}", "move it away")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        _begun(folder).touch()
        return folder

    def publish(self, staging: Path, folder: str) -> bool:
        """One rename, after all files are on the disk; a whole result is never replaced.

        Raises:
            OutputError: a newer batch took the staging folder away meanwhile; what is there now may lack
                files.
        """
        target = self._at(folder)
        for path in (*staging.rglob("*"), staging):
            to_disk(path)
        try:
            _begun(staging).unlink()
        except FileNotFoundError:
            raise OutputError("the folder that the result was made in", f"{staging}, taken away meanwhile",
                              "a newer batch fits this capture") from None
        try:
            os.rename(staging, target)
        except OSError as reason:
            if self.record(folder) is not None:
                return False
            if reason.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                raise
            self.set_aside(folder)  # something that is no result has its name
            os.rename(staging, target)
        with contextlib.suppress(OSError):  # it is there; some file systems cannot do this to a folder
            to_disk(self.root)
        return True

    def record(self, folder: str) -> dict | None:
        """The record in the folder."""
        try:
            return checked_record(load(self._at(folder) / RECORD, links=False))
        except (OSError, ValueError):
            return None

    def damage(self, folder: str, record: dict, hashes: bool) -> str:
        """The first file that is missing or another one."""
        for name, stated in record["files"].items():
            path = inside(self._at(folder), name)
            try:
                same = path is not None and path.lstat().st_size == stated["bytes"] and is_regular(path)
                if path is None or not same or hashes and file_hash(path) != stated["sha256"]:
                    return f"{name} has changed"
            except OSError:
                return f"{name} is missing"
        return ""

    def set_aside(self, folder: str) -> None:
        """A rename to ``NAME.damaged``, numbered where there is one."""
        path, count = self._at(folder), 0
        while os.path.lexists(aside := path.with_name(f"{path.name}.damaged{count or ''}")):
            count += 1
        with contextlib.suppress(FileNotFoundError):
            os.rename(path, aside)

    def aside(self) -> list[str]:
        """Those with a name that :meth:`set_aside` gives."""
        return sorted(path.name for path in self.root.iterdir() if ASIDE.fullmatch(path.name))

    def remove(self, folder: str) -> None:
        """Its record first, so that half a result never passes for one; of a link the link alone."""
        path = self._at(folder)
        if path.is_dir() and not path.is_symlink():
            (path / RECORD).unlink(missing_ok=True)
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)

    def _at(self, folder: str) -> Path:
        """Where a result of this name lies."""
        return self.root / checked_name(folder)


def _begun(staging: Path) -> Path:
    """Stands beside a staging folder for as long as it is the one that was made."""
    return staging.with_name(f"{staging.name}.begun")


def clear_work(home: Path) -> None:
    """Take away all that was being made; renamed first, so that a worker that outlived its batch has nothing
    to publish.
    """
    with contextlib.suppress(FileNotFoundError):
        os.rename(home / WORK, home / f"{WORK}-{uuid.uuid4().hex[:8]}")
    for old in home.glob(f"{WORK}-*"):
        if old.is_symlink():
            old.unlink()
        shutil.rmtree(old, ignore_errors=True)
