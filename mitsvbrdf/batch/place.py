"""Where the results of a library lie: a folder that all workers see, or an object store behind fsspec (``s3://``, ``gs://``).

A result is made in a folder of its own beside the library's materials and appears whole: in a folder by one rename, in a store
by its record, :data:`RECORD`, which is written last and without which the rest counts for nothing.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

from ..errors import BackendError, CaptureError, OutputError
from .identity import file_hash

RECORD = "batch.json"  # of a result: which capture and options it is of, and what its files hold
WORK, QUARANTINE = ".work", "quarantine"


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
        """What is wrong with a result's files, in words: their sizes, with ``hashes`` their content too; empty where nothing is."""
        ...

    def set_aside(self, folder: str) -> None:
        """Take a result that is not whole out of the way, without losing it."""
        ...

    def remove(self, folder: str) -> None:
        """Delete a result."""
        ...


def place_of(library: str) -> Place:
    """The place that a path or URL stands for."""
    return RemotePlace(library) if "://" in library else LocalPlace(Path(library))


def home_of(library: str) -> Path:
    """The folder of a library's manifest, page and quarantine: itself, or for one behind a URL a cache on this machine."""
    if "://" not in library:
        return Path(library)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    home = cache / "mitsvbrdf" / "libraries" / hashlib.sha256(library.rstrip("/").encode()).hexdigest()[:16]
    home.parent.mkdir(parents=True, exist_ok=True)
    return home


def upload(home: Path, library: str) -> None:
    """Put page, manifest and quarantine of a library behind a URL beside its results."""
    if "://" not in library:
        return
    fs, root = _file_system(library)
    for path in home.rglob("*"):
        name = str(path.relative_to(home))
        if path.is_file() and not name.startswith((WORK, ".lock")):
            fs.put_file(str(path), f"{root}/{name}")


class LocalPlace:
    """A folder, on a file system that all workers share."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def staging(self, attempt: str) -> Path:
        """An empty folder inside the library, so that publishing is a rename."""
        folder = self.root / WORK / attempt
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    def publish(self, staging: Path, folder: str) -> bool:
        """One rename, after all files are on the disk; a folder that is not empty is never replaced."""
        for path in (*staging.rglob("*"), staging):
            _to_disk(path)
        try:
            os.rename(staging, self.root / folder)
        except OSError:
            if self.record(folder) is None:
                raise
            return False
        _to_disk(self.root)
        return True

    def record(self, folder: str) -> dict | None:
        """The record in the folder."""
        try:
            found = json.loads((self.root / folder / RECORD).read_text())
        except (OSError, ValueError):
            return None
        return found if isinstance(found, dict) else None

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

    def remove(self, folder: str) -> None:
        """Its record first, so that half a result never passes for one."""
        (self.root / folder / RECORD).unlink(missing_ok=True)
        shutil.rmtree(self.root / folder, ignore_errors=True)


class RemotePlace:
    """An object store: no renames there, so that the record, put last, is what makes a result."""

    def __init__(self, url: str) -> None:
        self.fs, self.root = _file_system(url)

    def staging(self, attempt: str) -> Path:
        """A temporary folder on this machine."""
        return Path(tempfile.mkdtemp(prefix=f"mitsvbrdf-{attempt}-"))

    def publish(self, staging: Path, folder: str) -> bool:
        """All files, then the record."""
        new = self.record(folder) is None
        if new:
            names = sorted(str(path.relative_to(staging)) for path in staging.rglob("*") if path.is_file())
            for name in (*(name for name in names if name != RECORD), RECORD):
                self.fs.put_file(str(staging / name), f"{self.root}/{folder}/{name}")
        shutil.rmtree(staging, ignore_errors=True)
        return new

    def record(self, folder: str) -> dict | None:
        """The record in the store."""
        try:
            found = json.loads(self.fs.cat_file(f"{self.root}/{folder}/{RECORD}"))
        except (FileNotFoundError, ValueError):
            return None
        return found if isinstance(found, dict) else None

    def damage(self, folder: str, record: dict, hashes: bool) -> str:
        """The first object that is missing or another one."""
        for name, stated in record["files"].items():
            path = f"{self.root}/{folder}/{name}"
            try:
                if self.fs.size(path) != stated["bytes"]:
                    return f"{name} has changed"
                if hashes and hashlib.sha256(self.fs.cat_file(path)).hexdigest() != stated["sha256"]:
                    return f"{name} has changed"
            except FileNotFoundError:
                return f"{name} is missing"
        return ""

    def set_aside(self, folder: str) -> None:
        """Copies under ``NAME.damaged``; without its record the rest is no result any more."""
        self.fs.copy(f"{self.root}/{folder}", f"{self.root}/{folder}.damaged", recursive=True)
        self.remove(folder)

    def remove(self, folder: str) -> None:
        """Its record first, so that half a result never passes for one."""
        with contextlib.suppress(FileNotFoundError):
            self.fs.rm(f"{self.root}/{folder}/{RECORD}")
            self.fs.rm(f"{self.root}/{folder}", recursive=True)


@contextlib.contextmanager
def local_capture(source: str) -> Iterator[Path]:
    """A capture as a folder on this machine; one behind a URL is copied there for as long as the block lasts."""
    if "://" not in source:
        yield Path(source)
        return
    fs, root = _file_system(source)
    with tempfile.TemporaryDirectory(prefix="mitsvbrdf-capture-") as folder:
        target = Path(folder) / root.rstrip("/").rsplit("/", 1)[-1]
        target.mkdir()
        for path in fs.find(root):
            name = path[len(root):].lstrip("/")
            if ".." in Path(name).parts:
                raise CaptureError("names inside the capture", f"{name} in {source}", "rename it")
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            fs.get_file(path, str(target / name))
        yield target


def remote_captures(url: str) -> list[str]:
    """The captures that a URL stands for: itself, those right inside it, or those that match it as a pattern."""
    fs, root = _file_system(url)
    scheme = url.split("://", 1)[0]
    found = fs.glob(root) if set("*?[") & set(root) else [root]
    captures = [each for folder in found for each in _remote_captures_in(fs, folder)]
    if not captures:
        raise CaptureError("captures", f"none at {url}", "check the address")
    return [f"{scheme}://{path.rstrip('/')}" if "://" not in path else path.rstrip("/") for path in captures]


def remote_contents(url: str) -> list[list]:
    """Name, size and what the store knows of the content of each file of a capture behind a URL."""
    fs, root = _file_system(url)
    return sorted([path[len(root):].lstrip("/"), info.get("size"), str(info.get("ETag") or info.get("md5Hash") or fs.ukey(path))]
                  for path, info in fs.find(root, detail=True).items())


def _remote_captures_in(fs: Any, folder: str) -> list[str]:
    names = {path.rstrip("/").rsplit("/", 1)[-1]: path for path in fs.ls(folder, detail=False)}
    if {"capture.json", "camera_pos.txt"} & set(names):
        return [folder]
    inside = [path for path in names.values() if fs.isdir(path)]
    found = [path for path in inside if any(fs.exists(f"{path}/{name}") for name in ("capture.json", "camera_pos.txt"))]
    return sorted(found) or ([folder] if set(names) - set(inside) else [])


def _file_system(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL and the path in it."""
    try:
        import fsspec
        fs, root = fsspec.core.url_to_fs(url)
    except ImportError as reason:
        raise BackendError("a package for this kind of address", f"{url}: {reason}", "pip install 's3fs' or what it names") from None
    except ValueError as reason:
        raise OutputError("an address that fsspec knows", f"{url}: {reason}", "check it") from None
    return fs, root.rstrip("/")


def _to_disk(path: Path) -> None:
    """Have a file or folder written, not only promised."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
