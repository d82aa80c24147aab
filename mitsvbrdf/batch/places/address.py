"""What an address stands for: a folder, or an object store where it is a URL."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...errors import OutputError
from ...io.files import atomic_write, write_bytes
from ..manifest import FILE
from .place import WORK, LocalPlace, Place

OWN = (WORK, ".lock", ".token")  # of a library's home, what is of no use elsewhere


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
    """The folder of a library's manifest, page and quarantine: itself, or for one behind a URL a cache on
    this machine.
    """
    if not is_url(library):
        return Path(library)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    home = cache / "mitsvbrdf" / "libraries" / hashlib.sha256(library.rstrip("/").encode()).hexdigest()[:16]
    home.parent.mkdir(parents=True, exist_ok=True)
    return home


def check_address(library: str) -> None:
    """Be sure that results can be written to a URL, before any is made.

    Raises:
        MitsvbrdfError: they cannot, or a package is missing.
    """
    if is_url(library):
        from .remote import RemotePlace
        with _there(library):
            RemotePlace(library).check()


def upload(home: Path, library: str) -> None:
    """Put page, manifest and quarantine of a library behind a URL beside its results."""
    if not is_url(library):
        return
    from .remote import file_system, reached
    fs, root = file_system(library)
    with _there(library), reached(library):
        for path in home.rglob("*"):
            name = str(path.relative_to(home))
            if path.is_file() and not name.startswith(OWN):
                fs.put_file(str(path), f"{root}/{name}")
    write_bytes(_common(home), _version(fs, f"{root}/{FILE}").encode())


def download(home: Path, library: str) -> None:
    """Bring the manifest of a library behind a URL to this machine, where another one wrote it last.

    Args:
        home: of the manifest here, which nobody uses meanwhile.
        library: the URL, or a path: then nothing is done.
    """
    if not is_url(library):
        return
    from .remote import file_system, reached
    fs, root = file_system(library)
    with reached(library):
        version = _version(fs, f"{root}/{FILE}")
        known = _common(home).read_text() if _common(home).exists() and (home / FILE).exists() else ""
        if version and version != known:
            with atomic_write(home / FILE) as temporary:
                fs.get_file(f"{root}/{FILE}", str(temporary))
            write_bytes(_common(home), version.encode())


def _common(home: Path) -> Path:
    """The file that says which manifest the home of a library behind a URL and the store had in common
    last.
    """
    return home.with_suffix(".common")


def _version(fs: Any, path: str) -> str:
    """Changes whenever the object does; empty where there is none."""
    try:
        return str(fs.ukey(path))
    except FileNotFoundError:
        return ""


@contextlib.contextmanager
def _there(url: str) -> Iterator[None]:
    """A bucket that is missing becomes an error of ours."""
    try:
        yield
    except FileNotFoundError as reason:
        raise OutputError("a store that is there", f"{url}: {reason}",
                          "make the bucket, or check the address") from None


@contextlib.contextmanager
def local_capture(source: str) -> Iterator[Path]:
    """A capture as a folder on this machine; one behind a URL is copied there for as long as the block
    lasts.
    """
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
