"""The library of a batch: a folder, or an object store, in which each result appears whole or not at all.

A result is one folder, NAME-1a2b3c4d, named by its capture and the beginning of its identity. It is made
elsewhere and appears by one rename, in a store by its record, which is written last. ``pending/`` and
``failed/`` hold what is asked for and not done.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from filelock import FileLock, Timeout

from ..errors import OutputError
from ..io.files import file_hash, is_entry, is_regular, stays_inside, to_disk, write_json
from ..io.json import parsed
from .captures import TOKEN, is_capture
from .records import SHORT, Failure, File, Material, Pending, Result
from .stores import Store, is_url

RECORD = "batch.json"  # of a result: which capture and options it is of, and what its files hold
REASON, LOG = "reason.json", "log.txt"  # of a failed capture
FAILED, PENDING = "failed", "pending"
PAGES = "library.json", "library.js", "index.html"
LOCK, WORK = ".lock", ".work"  # what holds a library, and what is being made
RESULT = re.compile(rf".+-[0-9a-f]{{{SHORT}}}")
ASIDE = re.compile(RESULT.pattern + r"\.damaged[0-9]*")
NO_SPACE = errno.ENOSPC, errno.EDQUOT
Kind = TypeVar("Kind", bound=Material)


class ResultStore:
    """A library.

    Args:
        address: its folder, or its URL.
    """

    def __init__(self, address: str) -> None:
        self.address = address.rstrip("/") if is_url(address) else os.path.realpath(address)
        self.title = self.address.rsplit("/", 1)[-1]
        self.store = Store(self.address)

    # ---- what lies there ----

    def names(self) -> list[str]:
        """The folders that have the name of a result."""
        return sorted(name for name in self.store.listed()[1] if RESULT.fullmatch(name) and is_entry(name))

    def result(self, folder: str) -> Result | None:
        """The record of a result; None where there is none, or not a whole one."""
        found = self._read(f"{folder}/{RECORD}", Result)
        whole = found and found.folder == folder and all(map(stays_inside, found.files))
        return found if whole else None

    def failures(self) -> dict[str, Failure]:
        """The materials that failed, by the name of their folder."""
        folders = self.store.listed(self.store.path(FAILED))[1]
        return self._all(Failure, ((name, f"{FAILED}/{name}/{REASON}") for name in folders))

    def pending(self) -> dict[str, Pending]:
        """The materials that are asked for and neither done nor failed, by the name of their folder."""
        files = self.store.listed(self.store.path(PENDING))[0]
        return self._all(Pending, ((name.removesuffix(".json"), f"{PENDING}/{name}") for name in files))

    def damage(self, result: Result, hashes: bool) -> str:
        """What is wrong with the files of a result, in words; empty where nothing is.

        Args:
            result: its record.
            hashes: whether contents are compared, not only sizes.
        """
        there = self.store.objects(result.folder)
        for name, stated in result.files.items():
            if name not in there:
                return f"{name} is missing"
            if there[name]["size"] != stated.bytes or hashes and (
                    self.store.hash(f"{result.folder}/{name}") != stated.sha256):
                return f"{name} has changed"
        return ""

    def aside(self) -> list[str]:
        """The folders of what was set aside."""
        there = sum(self.store.listed(), [])
        return sorted(name for name in there if ASIDE.fullmatch(name) and is_entry(name))

    # ---- what changes ----

    def want(self, material: Pending) -> None:
        """Note that a material is asked for."""
        self._write(f"{PENDING}/{material.folder}.json", material)

    def settle(self, folder: str, failure: Failure | None = None, log: str = "") -> None:
        """Note that nobody waits for a material any more: it is done, or failed and then keeps its reason."""
        self.store.remove(f"{FAILED}/{folder}")
        if failure:  # first the reason: who dies here finds it waiting, too
            if log.strip():
                self.store.write(f"{FAILED}/{folder}/{LOG}", log.encode(errors="replace"))
            self._write(f"{FAILED}/{folder}/{REASON}", failure)
        self.store.remove(f"{PENDING}/{folder}.json")

    def restate(self, result: Result) -> None:
        """Say something else of a result that lies there: its tags, where its capture lies, its date."""
        self._write(f"{result.folder}/{RECORD}", result)

    @contextlib.contextmanager
    def building(self, attempt: str) -> Iterator[Path]:
        """An empty folder of this machine to make a result in; what is left in it after the block is lost."""
        if self.store.folder is None:
            with tempfile.TemporaryDirectory(prefix="mitsvbrdf-") as name:
                yield Path(name)
            return
        folder = Path(self.store.path(f"{WORK}/{attempt}"))
        folder.mkdir(parents=True)
        _begun(folder).touch()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)
            _begun(folder).unlink(missing_ok=True)

    def publish(self, made: Path, result: Result) -> bool:
        """Let a result appear under its name; False, and nothing changes, where a whole one is there.

        In a folder one rename does it, after all files are on the disk. In a store the record is put last,
        without which the rest counts for nothing.

        Args:
            made: its files, in a folder of :meth:`building`.
            result: its record; ``files`` is counted here.

        Raises:
            OutputError: a newer batch took the folder away meanwhile; what is there now may lack files.
        """
        if self.result(result.folder) is not None:
            return False
        names = sorted(path.relative_to(made).as_posix() for path in made.rglob("*") if is_regular(path))
        stated = {name: File((made / name).stat().st_size, file_hash(made / name)) for name in names}
        write_json(made / RECORD, msgspec.to_builtins(msgspec.structs.replace(result, files=stated)))
        if self.store.folder is None:
            for name in (*names, RECORD):
                self.store.put(made / name, f"{result.folder}/{name}")
            return True
        for path in (*made.rglob("*"), made):
            to_disk(path)
        try:
            _begun(made).unlink()
        except FileNotFoundError:
            raise OutputError("the folder that the result was made in", f"{made}, taken away meanwhile",
                              "a newer batch fits this capture") from None
        target = self.store.folder / result.folder
        try:
            os.rename(made, target)
        except OSError as reason:
            if self.result(result.folder) is not None:
                return False
            if reason.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                raise
            self.set_aside(result.folder)  # what is no result has its name
            os.rename(made, target)
        with contextlib.suppress(OSError):  # it is there; some file systems cannot do this to a folder
            to_disk(self.store.folder)
        return True

    def set_aside(self, folder: str) -> None:
        """Take what is no whole result out of the way, without losing it: to ``NAME.damaged``, numbered."""
        there, count = sum(self.store.listed(), []), 0
        while (other := f"{folder}.damaged{count or ''}") in there:
            count += 1
        with contextlib.suppress(FileNotFoundError):
            self.store.move(folder, other)

    def remove(self, folder: str) -> None:
        """Delete a result, or what was set aside; its record first, so that no half passes for a result."""
        with contextlib.suppress(OutputError, NotADirectoryError):  # it is a link, or a file
            self.store.path(f"{folder}/{RECORD}")
            self.store.remove(f"{folder}/{RECORD}")
        self.store.remove(folder)

    def clear_work(self) -> None:
        """Take away all that is being made, and empty folders.

        It is renamed first, so that a worker that outlived its batch has nothing to publish.
        """
        if self.store.folder is None:
            return
        for name in (FAILED, PENDING):
            with contextlib.suppress(OSError):  # it holds something, or is none
                (self.store.folder / name).rmdir()
        with contextlib.suppress(FileNotFoundError):
            self.store.move(WORK, f"{WORK}-{secrets.token_hex(4)}")
        for old in self.store.folder.glob(f"{WORK}-*"):
            self.store.remove(old.name)

    def take_away(self) -> None:
        """Delete a library in which nothing has ended."""
        for name in (PENDING, WORK, FAILED, TOKEN, *PAGES, LOCK):
            self.store.remove(name)
        if self.store.folder:
            with contextlib.suppress(OSError):
                self.store.folder.rmdir()

    # ---- whose it is ----

    @contextlib.contextmanager
    def claimed(self) -> Iterator[str]:
        """Hold the library for this process alone; gives the token that all nodes must see in it.

        Raises:
            OutputError: another batch has it, the folder is no library, or it cannot be written.
        """
        if self.store.folder is None:
            self.store.check()
            cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mitsvbrdf/libraries"
            lock = cache / f"{hashlib.sha256(self.address.encode()).hexdigest()[:16]}{LOCK}"
        else:
            lock = self.store.folder / LOCK
        try:
            if self.store.folder:
                self._check_own()
            lock.parent.mkdir(parents=True, exist_ok=True)
            if lock.exists() and not is_regular(lock):
                raise OutputError("a library without links in it", str(lock), "move it away")
            with FileLock(lock, timeout=0):
                if TOKEN not in self.store.listed()[0]:
                    self.store.write(TOKEN, secrets.token_hex(16).encode())
                yield self.store.read(TOKEN).decode()
        except Timeout:
            raise OutputError("one batch at a time in a library", f"{self.address}, in use by another one",
                              "wait for it, or choose another library") from None
        except PermissionError as reason:
            raise OutputError(f"a place to write at {self.address}", reason.strerror or str(reason),
                              "check your rights, or choose another place") from None

    def is_library(self) -> bool:
        """Whether a batch has made this place its own: by its mark, or where that is lost by a result."""
        return TOKEN in self.store.listed()[0] or any(self.result(name) for name in self.names())

    def _check_own(self) -> None:
        """Raise OutputError where the folder is neither new nor a library, or has links to write through."""
        root = Path(self.address)
        if root.exists() and not root.is_dir():
            raise OutputError("a new folder or a library", f"the file {root}", "choose another place")
        files, folders = self.store.listed()
        others = [name for name in (*files, *folders) if not name.startswith((LOCK, TOKEN, WORK))]
        if others and not self.is_library():
            what = "holds photos" if is_capture(files) else f"holds {sorted(others)[0]} and is no library"
            raise OutputError("a new folder or a library", f"{root}, which {what}", "choose another place")
        for path in (*root.glob("*"), *root.glob(f"{FAILED}/*"), *root.glob(".*")):
            if path.is_symlink():
                raise OutputError("a library without links in it", f"{path}, a link", "move it away")

    # ---- records ----

    def _read(self, name: str, kind: type[Kind]) -> Kind | None:
        """A record; None where there is none, or another thing."""
        try:
            found = parsed(self.store.read(name))
            row = found.get("row")
            if isinstance(row, dict) and "left_out_error" in row:  # of version 1.0.0
                row["held_out_error"] = row.pop("left_out_error")
            record = msgspec.convert(found, kind)
            json.dumps(msgspec.to_builtins(record), ensure_ascii=False).encode()  # no half characters
            return record
        except (OSError, ValueError, OutputError):
            return None

    def _all(self, kind: type[Kind], places: Any) -> dict[str, Kind]:
        found = {name: self._read(place, kind) for name, place in places}
        return {name: each for name, each in found.items()
                if each and each.folder == name and is_entry(name)}

    def _write(self, name: str, record: Material) -> None:
        self.store.write(name, (json.dumps(msgspec.to_builtins(record), indent=1) + "\n").encode())


def _begun(folder: Path) -> Path:
    """Stands beside a folder of :meth:`ResultStore.building` for as long as it is the one that was made."""
    return folder.with_name(f"{folder.name}.begun")
