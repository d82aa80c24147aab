"""The library of a batch: a folder, or an object store, in which each result appears whole or not at all.

A result is one folder, NAME-1a2b3c4d: the name of its capture, and the beginning of its identity, a hash of
photos and options. ``failed/`` has a folder for each capture that failed, with the reason.
"""

import contextlib
import errno
import json
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
from filelock import FileLock, Timeout

from ..errors import OutputError
from ..io.files import file_hash, is_entry, is_regular, stays_inside, to_disk, write_json
from ..io.json import parsed
from .captures import TOKEN, is_capture
from .records import SHORT, File, Material
from .stores import Store, is_url

RECORD = "batch.json"  # in a result: its capture and options, size and hash of its files
REASON, LOG = "reason.json", "log.txt"  # in the folder of a failed capture
FAILED = "failed"
PAGES = "library.json", "library.js", "index.html"
LOCK, WORK = ".lock", ".work"  # the lock of a library, and the folder of unfinished results
MARK = ".begun"  # a file in a folder of :meth:`ResultStore.building`, until that is published or removed
RESULT = re.compile(rf".+-[0-9a-f]{{{SHORT}}}")
NO_SPACE = errno.ENOSPC, errno.EDQUOT


class ResultStore:
    """A library in a folder, or in an object store behind a URL."""

    def __init__(self, address: str) -> None:
        self.address = address.rstrip("/") if is_url(address) else os.path.realpath(address)
        self.title = self.address.rsplit("/", 1)[-1]
        self.store = Store(self.address)

    # ---- what is there ----

    def names(self) -> list[str]:
        """The folders that have the name of a result (a name, a hyphen, 8 hex digits), sorted."""
        return sorted(name for name in self.store.listed()[1] if RESULT.fullmatch(name) and is_entry(name))

    def result(self, folder: str) -> Material | None:
        """The record of a result; None if there is no record, or it is incomplete."""
        found = self._read(f"{folder}/{RECORD}", folder, "done")
        return found if found and found.files and all(map(stays_inside, found.files)) else None

    def materials(self) -> dict[str, Material]:
        """A dict: folder to record. If a folder has a result and a failure, the result counts."""
        folders = self.store.listed(FAILED)[1]
        failed = (self._read(f"{FAILED}/{name}/{REASON}", name, "failed") for name in folders)
        return {each.folder: each for each in (*failed, *map(self.result, self.names())) if each}

    def damage(self, result: Material, hashes: bool) -> str:
        """The first fault in the files of a result; empty if none. ``hashes``: contents are compared too."""
        there = self.store.objects(result.folder)
        for name, stated in result.files.items():
            if name not in there:
                return f"{name} is missing"
            if there[name]["size"] != stated.bytes or hashes and (
                    self.store.hash(f"{result.folder}/{name}") != stated.sha256):
                return f"{name} has changed"
        return ""

    # ---- what changes ----

    def fail(self, failure: Material, log: str) -> None:
        """Write why a material failed, and what its fit printed."""
        self.forget(failure.folder)
        if log.strip():
            self.store.write(f"{FAILED}/{failure.folder}/{LOG}", log.encode(errors="replace"))
        self._write(f"{FAILED}/{failure.folder}/{REASON}", failure)

    def forget(self, folder: str) -> None:
        """Remove the record that a material failed."""
        self.store.remove(f"{FAILED}/{folder}")

    def restate(self, result: Material) -> None:
        """Write the record of an existing result again, with other tags, another source or another date."""
        self._write(f"{result.folder}/{RECORD}", result)

    @contextlib.contextmanager
    def building(self, attempt: str) -> Iterator[Path]:
        """An empty local folder in which a result is made. After the block, what is left there is deleted."""
        if self.store.folder is None:
            with tempfile.TemporaryDirectory(prefix="mitsvbrdf-") as name:
                yield Path(name)
            return
        folder = Path(self.store.path(f"{WORK}/{attempt}"))
        folder.mkdir(parents=True)
        (folder / MARK).touch()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def publish(self, made: Path, result: Material) -> bool:
        """Publish a result that was made in a folder of :meth:`building`. If a complete result of its name
        exists already, change nothing and return False.

        In a local library one rename publishes it, after all files are on the disk. In an object store the
        record is written last; without it no file counts. OutputError: a newer batch has removed ``made``.
        """
        if self.result(result.folder) is not None:
            return False
        names = sorted(path.relative_to(made).as_posix() for path in made.rglob("*")
                       if is_regular(path) and path.name != MARK)
        stated = {name: File((made / name).stat().st_size, file_hash(made / name)) for name in names}
        write_json(made / RECORD, msgspec.to_builtins(result.but(state="done", files=stated)))
        if self.store.folder is None:
            for name in (*names, RECORD):
                self.store.put(made / name, f"{result.folder}/{name}")
            return True
        for path in (*made.rglob("*"), made):
            to_disk(path)
        try:
            (made / MARK).unlink()
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
            self.set_aside(result.folder)  # a folder that is no result has this name
            os.rename(made, target)
        with contextlib.suppress(OSError):  # the result is there; some file systems cannot sync a folder
            to_disk(self.store.folder)
        return True

    def set_aside(self, folder: str) -> None:
        """Rename a folder that is not a complete result: its name becomes free, and no file is lost."""
        with contextlib.suppress(FileNotFoundError):
            self.store.move(folder, f"{folder}.damaged.{secrets.token_hex(4)}")

    def clear_work(self) -> None:
        """Remove all unfinished results, and ``failed/`` if it is empty.

        Their folder is renamed first: then a worker that still runs after its batch can publish nothing.
        """
        if self.store.folder is None:
            return
        with contextlib.suppress(OSError):  # the folder is not empty, or does not exist
            (self.store.folder / FAILED).rmdir()
        with contextlib.suppress(FileNotFoundError):
            self.store.move(WORK, f"{WORK}-{secrets.token_hex(4)}")
        for old in self.store.folder.glob(f"{WORK}-*"):
            self.store.remove(old.name)

    # ---- lock and token ----

    @contextlib.contextmanager
    def claimed(self) -> Iterator[str]:
        """Lock the library for this process; yield the token that all nodes must see in the library.

        A library in an object store has no lock. OutputError: another batch has locked the library, the
        folder is no library, or it cannot be written.
        """
        try:
            with contextlib.ExitStack() as held:
                if self.store.folder:
                    self._check_own()
                    self.store.folder.mkdir(parents=True, exist_ok=True)
                    held.enter_context(FileLock(self.store.folder / LOCK, timeout=0))
                if TOKEN not in self.store.listed()[0]:
                    self.store.write(TOKEN, secrets.token_hex(16).encode())
                yield self.store.read(TOKEN).decode()
        except Timeout:
            raise OutputError("one batch at a time in a library", f"{self.address}, in use by another one",
                              "wait for it, or choose another library") from None
        except (PermissionError, FileNotFoundError) as reason:
            raise OutputError(f"a place to write at {self.address}", str(reason),
                              "make the bucket, check your rights, or choose another place") from None

    def is_library(self) -> bool:
        """Whether this place is a library of a batch: it has the token or, if that is lost, a result."""
        return TOKEN in self.store.listed()[0] or any(self.result(name) for name in self.names())

    def _check_own(self) -> None:
        """Raise OutputError if the folder is neither new nor a library, or if it contains links."""
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

    def _read(self, name: str, folder: str, state: str) -> Material | None:
        try:
            record = msgspec.convert(parsed(self.store.read(name)) | {"state": state}, Material)
            json.dumps(msgspec.to_builtins(record), ensure_ascii=False).encode()  # no lone surrogates
        except (OSError, ValueError, OutputError):
            return None
        return record if record.folder == folder and is_entry(folder) else None

    def _write(self, name: str, record: Material) -> None:
        self.store.write(name, (json.dumps(msgspec.to_builtins(record), indent=1) + "\n").encode())
