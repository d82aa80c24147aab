"""Object stores behind fsspec (``s3://``, ``gs://``): captures read from them, results written to them."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from ..errors import BackendError, CaptureError, OutputError
from .place import RECORD

CALIBRATIONS = ("capture.json", "camera_pos.txt")


class RemotePlace:
    """An object store: no renames there, so that the record, put last, is what makes a result."""

    def __init__(self, url: str) -> None:
        self.fs, self.root = file_system(url)

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


def fetch(url: str, folder: Path) -> None:
    """Copy the files of a capture behind a URL into a folder."""
    fs, root = file_system(url)
    for path in fs.find(root):
        name = path[len(root):].lstrip("/")
        if ".." in Path(name).parts:
            raise CaptureError("names inside the capture", f"{name} in {url}", "rename it")
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        fs.get_file(path, str(folder / name))


def remote_captures(url: str) -> list[str]:
    """The captures that a URL stands for: itself, those right inside it, or those that match it as a pattern."""
    fs, root = file_system(url)
    scheme = url.split("://", 1)[0]
    found = fs.glob(root) if set("*?[") & set(root) else [root]
    captures = [each for folder in found for each in _remote_captures_in(fs, folder)]
    if not captures:
        raise CaptureError("captures", f"none at {url}", "check the address")
    return [f"{scheme}://{path.rstrip('/')}" if "://" not in path else path.rstrip("/") for path in captures]


def remote_contents(url: str) -> list[list]:
    """Name, size and what the store knows of the content of each file of a capture behind a URL."""
    fs, root = file_system(url)
    return sorted([path[len(root):].lstrip("/"), info["size"], str(info.get("ETag") or info.get("md5Hash") or fs.ukey(path))]
                  for path, info in fs.find(root, detail=True).items())


def _remote_captures_in(fs: Any, folder: str) -> list[str]:
    names = {path.rstrip("/").rsplit("/", 1)[-1]: path for path in fs.ls(folder, detail=False)}
    if set(CALIBRATIONS) & set(names):
        return [folder]
    inside = [path for path in names.values() if fs.isdir(path)]
    found = [path for path in inside if any(fs.exists(f"{path}/{name}") for name in CALIBRATIONS)]
    return sorted(found) or ([folder] if set(names) - set(inside) else [])


def file_system(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL and the path in it."""
    try:
        import fsspec
        fs, root = fsspec.core.url_to_fs(url)
    except ImportError as reason:
        raise BackendError("a package for this kind of address", f"{url}: {reason}", "install it") from None
    except ValueError as reason:
        raise OutputError("an address that fsspec knows", f"{url}: {reason}", "check it") from None
    return fs, root.rstrip("/")
