"""Where the files of a batch are: a local folder, or an object store behind a URL (``s3://``, ``gs://``)."""

import contextlib
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from ..errors import BackendError, MitsvbrdfError, OutputError
from ..io.files import inside, open_regular, remove, stays_inside, write_bytes

LOCAL = "file", "local"  # schemes of fsspec for local files; only these need folders to be made


def is_url(address: str) -> bool:
    """Whether an address is a URL for fsspec and not a path."""
    return "://" in address


class Store:
    """A local folder, or a folder in an object store, behind a URL. Names of files are relative to it, with
    ``/`` between their parts.

    Links in a local folder are not followed. Listings are not cached, since other workers write too.
    MitsvbrdfError: fsspec does not know the URL, or a package is missing.
    """

    def __init__(self, address: str) -> None:
        self.address, self.folder = address, None if is_url(address) else Path(os.path.realpath(address))
        scheme = address.split("://", 1)[0]
        try:
            import fsspec
            if self.folder:
                self.fs, root = fsspec.filesystem("file"), str(self.folder)
            else:
                self.fs, root = fsspec.core.url_to_fs(address, use_listings_cache=False,
                                                      **({"auto_mkdir": True} if scheme in LOCAL else {}))
        except ImportError as reason:
            raise BackendError("a package for this kind of address", f"{address}: {reason}",
                               "install it; for S3: pip install 'mitsvbrdf[s3]'") from None
        except ValueError as reason:
            raise OutputError("an address that fsspec knows", f"{address}: {reason}", "check it") from None
        self.root = root.rstrip("/")

    def path(self, name: str) -> str:
        """The path of a file in its file system. OutputError: behind a link or outside of the folder."""
        if self.folder and name and inside(self.folder, name) is None:
            raise OutputError("a library without links in it", f"{self.folder / name}", "move the link away")
        return f"{self.root}/{name}" if name else self.root

    def open(self, name: str) -> IO[bytes]:
        """A file, open for reading; FileNotFoundError if there is none."""
        path = self.path(name)
        return open_regular(Path(path)) if self.folder else self.fs.open(path, "rb")

    def read(self, name: str) -> bytes:
        """The content of a file; FileNotFoundError if there is none."""
        with self.reached(), self.open(name) as file:
            return file.read()

    def hash(self, name: str) -> str:
        """SHA-256 of a file's content, in hex."""
        with self.reached(), self.open(name) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]

    def write(self, name: str, data: bytes) -> None:
        """Replace a file in one step."""
        if self.folder:
            write_bytes(Path(self.path(name)), data)
            return
        with self.reached():
            self.fs.pipe_file(self.path(name), data)

    def put(self, file: Path, name: str) -> None:
        """Copy a file of this machine into the store."""
        with self.reached():
            self.fs.put_file(str(file), self.path(name))

    def fetch(self, folder: Path) -> None:
        """Copy all files of the store into a folder of this machine."""
        for each in self.objects():
            if not stays_inside(each) or "\\" in each:
                raise OutputError("names inside of their folder", f"{each} in {self.address}", "rename it")
            (folder / each).parent.mkdir(parents=True, exist_ok=True)
            with self.reached():
                self.fs.get_file(self.path(each), str(folder / each))

    def listed(self, name: str = "") -> tuple[list[str], list[str]]:
        """The names of files, and of folders, directly inside a folder; none if the folder is missing."""
        path, names = self.path(name), {"file": list[str](), "directory": list[str]()}
        with self.reached(), contextlib.suppress(FileNotFoundError):
            for info in self.fs.ls(path, detail=True):
                if (other := info["name"].rstrip("/")) != path:
                    names.setdefault(info["type"], []).append(other.rsplit("/", 1)[-1])
        return names["file"], names["directory"]

    def objects(self, name: str = "") -> dict[str, dict]:
        """A dict of all regular files below a folder: relative path to fsspec's description of it."""
        folder = self.path(name)
        with self.reached():
            found = self.fs.find(folder, detail=True)
        named = ((path[len(folder):].lstrip("/"), info) for path, info in found.items() if path[-1] != "/")
        return {each: info for each, info in named if each and info["type"] == "file"}

    def contents(self) -> list[list]:
        """Name, size and content tag (such as an ETag) of each object, sorted by name."""
        return sorted([name, info["size"], str(info.get("ETag") or info.get("md5Hash")
                                               or self.fs.ukey(self.path(name)))]
                      for name, info in self.objects().items())

    def move(self, name: str, other: str) -> None:
        """Rename a folder; an object store moves its objects one by one."""
        if self.folder:
            os.rename(self.folder / name, self.folder / other)
            return
        with self.reached():
            self.fs.mv(self.path(name), self.path(other), recursive=True)

    def remove(self, name: str) -> None:
        """Delete a file, a folder with its content, or a link (not its target)."""
        with contextlib.suppress(FileNotFoundError):
            if self.folder:
                remove(self.folder / name)
                return
            with self.reached():
                self.fs.rm(self.path(name), recursive=True)

    @contextlib.contextmanager
    def reached(self) -> Iterator[None]:
        """Turn errors of an object store inside the block into OutputError; FileNotFoundError stays."""
        try:
            yield
        except (MitsvbrdfError, FileNotFoundError):
            raise
        except Exception as reason:  # each client has its own exceptions
            if self.folder:
                raise
            raise OutputError("a store that answers", f"{self.address}: {type(reason).__name__}: {reason}",
                              "check the address, your credentials and your rights there") from reason
