"""Object stores behind fsspec (``s3://``, ``gs://``): captures read from them, results written to them."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from ...capture.photo import SUFFIXES
from ...errors import BackendError, CaptureError, MitsvbrdfError, OutputError
from ...io.files import stays_inside
from ...io.json import parsed
from .place import ASIDE, RECORD, checked_name, checked_record

CALIBRATIONS = ("capture.json", "camera_pos.txt")
# fsspec's names of this machine's files: the only ones where folders have to be made
LOCAL = ("file", "local")
EXTRAS = {"s3": "pip install 'mitsvbrdf[s3]'", "s3a": "pip install 'mitsvbrdf[s3]'",
          "gs": "pip install gcsfs",
          "gcs": "pip install gcsfs", "abfs": "pip install adlfs", "az": "pip install adlfs"}


class RemotePlace:
    """An object store: no renames there, so that the record, put last, is what makes a result."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.fs, self.root = file_system(url)

    def check(self) -> None:
        """Write, read and delete an object, so that what is wrong with a store is known before anything is
        fitted.
        """
        probe = f"{self.root}/.probe-{os.urandom(8).hex()}"
        with reached(self.url):
            self.fs.pipe_file(probe, b"probe")
            if self.fs.cat_file(probe) != b"probe":
                raise OutputError("a store that gives what was put there", self.url, "use another one")
            self.fs.rm_file(probe)

    def staging(self, attempt: str) -> Path:
        """A temporary folder on this machine."""
        return Path(tempfile.mkdtemp(prefix=f"mitsvbrdf-{attempt}-"))

    def publish(self, staging: Path, folder: str) -> bool:
        """All files, then the record."""
        if self.record(folder) is not None:
            return False
        names = sorted(str(path.relative_to(staging)) for path in staging.rglob("*") if path.is_file())
        with reached(self.url):
            for name in (*(name for name in names if name != RECORD), RECORD):
                self.fs.put_file(str(staging / name), self._at(folder, name))
        return True

    def record(self, folder: str) -> dict | None:
        """The record in the store."""
        try:
            with reached(self.url):
                found = self.fs.cat_file(self._at(folder, RECORD))
            return checked_record(parsed(found))
        except (FileNotFoundError, ValueError):
            return None

    def damage(self, folder: str, record: dict, hashes: bool) -> str:
        """The first object that is missing or another one."""
        with reached(self.url):
            sizes = self._sizes(folder)
            for name, stated in record["files"].items():
                if name not in sizes:
                    return f"{name} is missing"
                if sizes[name] != stated["bytes"] or hashes and self._hash(folder, name) != stated["sha256"]:
                    return f"{name} has changed"
        return ""

    def set_aside(self, folder: str) -> None:
        """Copies under ``NAME.damaged``; without its record the rest is no result any more."""
        with reached(self.url):
            for name in self._sizes(folder):
                self.fs.cp_file(self._at(folder, name), self._at(f"{folder}.damaged", name))
        self.remove(folder)

    def aside(self) -> list[str]:
        """Those with a name that :meth:`set_aside` gives."""
        with reached(self.url):
            return sorted(name for name in _listed(self.fs, self.root)[1] if ASIDE.fullmatch(name))

    def remove(self, folder: str) -> None:
        """Its record first, so that half a result never passes for one."""
        with reached(self.url):
            for path in (self._at(folder, RECORD), self._at(folder)):
                with contextlib.suppress(FileNotFoundError):
                    self.fs.rm(path, recursive=True)

    def _at(self, folder: str, *name: str) -> str:
        """Where a result of this name lies, or a file in it."""
        return "/".join((self.root, checked_name(folder), *name))

    def _sizes(self, folder: str) -> dict[str, int]:
        """The objects of a result and their sizes: one question to the store, however many there are."""
        return {name: info["size"] for name, info in objects(self.fs, self._at(folder)).items()}

    def _hash(self, folder: str, name: str) -> str:
        with self.fs.open(self._at(folder, name), "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


def fetch(url: str, folder: Path) -> None:
    """Copy the files of a capture behind a URL into a folder."""
    fs, root = file_system(url)
    with reached(url):
        for name in objects(fs, root):
            if not stays_inside(name) or "\\" in name:
                raise CaptureError("names inside the capture", f"{name} in {url}", "rename it")
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            fs.get_file(f"{root}/{name}", str(folder / name))


def remote_captures(url: str) -> list[str]:
    """The captures that a URL stands for: itself, those right inside it, or those that match it as a
    pattern.
    """
    fs, root = file_system(url)
    root = root.removesuffix("/capture.json")
    captures: list[str] = []
    with contextlib.suppress(FileNotFoundError), reached(url):
        found = fs.glob(root) if set("*?[") & set(root) else [root]
        captures = [each for folder in sorted(found) for each in _remote_captures_in(fs, folder)]
    if not captures:
        raise CaptureError("captures", f"none at {url}", "check the address")
    return [fs.unstrip_protocol(path) for path in captures]


def remote_contents(url: str) -> list[list]:
    """Name, size and what the store knows of the content of each file of a capture behind a URL."""
    fs, root = file_system(url)
    with reached(url):
        return sorted([name, info["size"],
                       str(info.get("ETag") or info.get("md5Hash") or fs.ukey(f"{root}/{name}"))]
                      for name, info in objects(fs, root).items())


def is_capture(names: Collection[str]) -> bool:
    """Whether a folder with files of these names is a capture and not, say, a fit."""
    return any(name in CALIBRATIONS for name in names) or any(
        os.path.splitext(name)[1].lower() in SUFFIXES and name[0] != "."
        for name in names) and "fit.json" not in names


def _remote_captures_in(fs: Any, folder: str) -> list[str]:
    """The folder itself where it is a capture, else the captures right inside it."""
    files, folders = _listed(fs, folder)
    if is_capture(files):
        return [folder]
    return sorted(f"{folder}/{name}" for name in folders if name[0] != "."
                  and is_capture(_listed(fs, f"{folder}/{name}")[0]))


def _listed(fs: Any, folder: str) -> tuple[list[str], list[str]]:
    """The names of the files right inside a folder, and of the folders."""
    names: dict[str, list[str]] = {"file": [], "directory": []}
    for info in fs.ls(folder, detail=True):
        name = info["name"].rstrip("/").rsplit("/", 1)[-1]
        if info["name"].rstrip("/") != folder:
            names.setdefault(info["type"], []).append(name)
    return names["file"], names["directory"]


def objects(fs: Any, root: str) -> dict[str, dict]:
    """What the store says of each object below a folder, by its name in there; folders that are objects
    themselves left out.
    """
    found = ((path[len(root):].lstrip("/"), info) for path, info in fs.find(root, detail=True).items()
             if path[-1] != "/")
    return {name: info for name, info in found if name}


def file_system(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL and the path in it.

    It keeps no listings of folders: those would hide what other workers have written since.
    """
    scheme = url.split("://", 1)[0]
    options: dict = {"auto_mkdir": True} if scheme in LOCAL else {}
    try:
        import fsspec
        fs, root = fsspec.core.url_to_fs(url, use_listings_cache=False, **options)
    except ImportError as reason:
        raise BackendError("a package for this kind of address", f"{url}: {reason}",
                           EXTRAS.get(scheme, "install it")) from None
    except ValueError as reason:
        raise OutputError("an address that fsspec knows", f"{url}: {reason}", "check it") from None
    return fs, root.rstrip("/")


@contextlib.contextmanager
def reached(url: str) -> Iterator[None]:
    """What a store or its client raises becomes an error of ours; that nothing is at an address stays
    FileNotFoundError.
    """
    try:
        yield
    except (MitsvbrdfError, FileNotFoundError):
        raise
    except Exception as reason:  # each client has its own
        raise OutputError("a store that answers", f"{url}: {type(reason).__name__}: {reason}",
                          "check the address, your credentials and your rights there") from reason
