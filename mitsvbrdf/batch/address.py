"""What an address stands for: a folder, or an object store where it is a URL."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from .place import WORK, LocalPlace, Place


def is_url(address: str) -> bool:
    """Whether an address is behind fsspec and not a path."""
    return "://" in address


def place_of(library: str) -> Place:
    """The place that a path or URL stands for."""
    if not is_url(library):
        return LocalPlace(Path(library))
    from .remote import RemotePlace
    return RemotePlace(library)


def home_of(library: str) -> Path:
    """The folder of a library's manifest, page and quarantine: itself, or for one behind a URL a cache on this machine."""
    if not is_url(library):
        return Path(library)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    home = cache / "mitsvbrdf" / "libraries" / hashlib.sha256(library.rstrip("/").encode()).hexdigest()[:16]
    home.parent.mkdir(parents=True, exist_ok=True)
    return home


def upload(home: Path, library: str) -> None:
    """Put page, manifest and quarantine of a library behind a URL beside its results."""
    if not is_url(library):
        return
    from .remote import file_system
    fs, root = file_system(library)
    for path in home.rglob("*"):
        name = str(path.relative_to(home))
        if path.is_file() and not name.startswith((WORK, ".lock")):
            fs.put_file(str(path), f"{root}/{name}")


@contextlib.contextmanager
def local_capture(source: str) -> Iterator[Path]:
    """A capture as a folder on this machine; one behind a URL is copied there for as long as the block lasts."""
    if not is_url(source):
        yield Path(source)
        return
    from .remote import fetch

    with tempfile.TemporaryDirectory(prefix="mitsvbrdf-capture-") as folder:
        target = Path(folder) / title_of(source)
        target.mkdir()
        fetch(source, target)
        yield target


def title_of(address: str) -> str:
    """The last part of an address."""
    return os.path.basename(address.rstrip("/") if is_url(address) else os.path.realpath(address))
