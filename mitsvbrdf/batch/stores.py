"""Where files of a batch lie: a folder of this machine, or an object store behind a URL (``s3://``, ``gs://``).

Both know the same few deeds. Names are relative, with ``/`` between their parts.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

from ..errors import BackendError, MitsvbrdfError, OutputError
from ..io.files import file_hash, inside, is_regular, open_regular, remove, stays_inside, write_bytes

# fsspec's names of this machine's files: the only ones where folders have to be made
LOCAL = ("file", "local")
MARK = ".token"  # what a library is known by
EXTRAS = {"s3": "pip install 'mitsvbrdf[s3]'", "s3a": "pip install 'mitsvbrdf[s3]'",
          "gs": "pip install gcsfs", "gcs": "pip install gcsfs",
          "abfs": "pip install adlfs", "az": "pip install adlfs"}


def is_url(address: str) -> bool:
    """Whether an address is behind fsspec and not a path."""
    return "://" in address


def title_of(address: str) -> str:
    """The last part of an address."""
    return os.path.basename(address.rstrip("/") if is_url(address) else os.path.realpath(address))


class Disk:
    """A folder of this machine, or of a file system that several share. No link in it is gone through.

    Args:
        root: of the folder.
    """

    def __init__(self, root: Path) -> None:
        self.root = root

    def path(self, name: str) -> Path:
        """Where a file lies.

        Raises:
            OutputError: behind a link, or outside of the folder.
        """
        found = inside(self.root, name) if name else self.root
        if found is None:
            raise OutputError("a library without links in it", f"{self.root / name}", "move the link away")
        return found

    def read(self, name: str) -> bytes:
        """The content of a file; FileNotFoundError where there is none."""
        with open_regular(self._read_only(name)) as file:
            return file.read()

    def write(self, name: str, data: bytes) -> None:
        """Replace a file in one step."""
        write_bytes(self.path(name), data)

    def _read_only(self, name: str) -> Path:
        """Where a file to read lies: a whole result may be a link to another disk, what is in it may not."""
        top, _, rest = name.partition("/")
        return Disk(self.root / top).path(rest) if rest else self.path(name)

    def listed(self, name: str = "") -> tuple[list[str], list[str]]:
        """The names right inside a folder: of files, and of folders; none where it is missing."""
        try:
            entries = list(os.scandir(self.path(name)))
        except FileNotFoundError:
            return [], []
        return ([entry.name for entry in entries if not entry.is_dir()],
                [entry.name for entry in entries if entry.is_dir()])

    def sizes(self, name: str) -> dict[str, int]:
        """Bytes of each regular file below a folder, by its name in there."""
        folder = self.root / name  # may be a link: it is only read
        found = (Path(here, each) for here, _, names in os.walk(folder) for each in names)
        return {path.relative_to(folder).as_posix(): path.lstat().st_size for path in found if is_regular(path)}

    def hash(self, name: str) -> str:
        """SHA-256 of a file's content, in hex."""
        return file_hash(self._read_only(name))

    def move(self, name: str, other: str) -> None:
        """Rename a folder."""
        os.rename(self.root / name, self.root / other)

    def remove(self, name: str) -> None:
        """Delete a file, or a folder with all in it; of a link the link alone."""
        with contextlib.suppress(FileNotFoundError):
            remove(self.root / name)


class Bucket:
    """An object store behind fsspec.

    It keeps no listings of folders: those would hide what other workers have written since.

    Args:
        url: of a folder in the store, or a pattern of folders.

    Raises:
        MitsvbrdfError: fsspec does not know the address, or a package is missing.
    """

    def __init__(self, url: str) -> None:
        self.url, scheme = url, url.split("://", 1)[0]
        options: dict = {"auto_mkdir": True} if scheme in LOCAL else {}
        try:
            import fsspec
            self.fs, root = fsspec.core.url_to_fs(url, use_listings_cache=False, **options)
        except ImportError as reason:
            raise BackendError("a package for this kind of address", f"{url}: {reason}",
                               EXTRAS.get(scheme, "install it")) from None
        except ValueError as reason:
            raise OutputError("an address that fsspec knows", f"{url}: {reason}", "check it") from None
        self.root = root.rstrip("/")

    def path(self, name: str) -> str:
        """Where a file lies, as the store names it."""
        return f"{self.root}/{name}" if name else self.root

    def url_of(self, path: str) -> str:
        """The URL of what the store names so."""
        return self.fs.unstrip_protocol(path)

    def check(self) -> None:
        """Write, read and delete an object, so that a fault of the store is known before anything is fitted.

        Raises:
            OutputError: the store is missing, or gives back something else.
        """
        probe = f".probe-{os.urandom(8).hex()}"
        try:
            self.write(probe, b"probe")
            if self.read(probe) != b"probe":
                raise OutputError("a store that gives what was put there", self.url, "use another one")
            self.remove(probe)
        except FileNotFoundError as reason:
            raise OutputError("a store that is there", f"{self.url}: {reason}",
                              "make the bucket, or check the address") from None

    def read(self, name: str) -> bytes:
        """The content of an object; FileNotFoundError where there is none."""
        with reached(self.url):
            return self.fs.cat_file(self.path(name))

    def write(self, name: str, data: bytes) -> None:
        """Replace an object."""
        with reached(self.url):
            self.fs.pipe_file(self.path(name), data)

    def put(self, file: Path, name: str) -> None:
        """Copy a file of this machine into the store."""
        with reached(self.url):
            self.fs.put_file(str(file), self.path(name))

    def fetch(self, name: str, file: Path) -> None:
        """Copy an object to this machine."""
        file.parent.mkdir(parents=True, exist_ok=True)
        with reached(self.url):
            self.fs.get_file(self.path(name), str(file))

    def matches(self) -> list[str]:
        """The folders that the URL stands for as a pattern, as the store names them; itself where it is none."""
        return sorted(self.fs.glob(self.root)) if set("*?[") & set(self.root) else [self.root]

    def listed(self, name: str = "") -> tuple[list[str], list[str]]:
        """The names of the objects right inside a folder, and of the folders."""
        return self.listed_at(self.path(name))

    def listed_at(self, path: str) -> tuple[list[str], list[str]]:
        """The same of a folder as the store names it."""
        names: dict[str, list[str]] = {"file": [], "directory": []}
        with reached(self.url), contextlib.suppress(FileNotFoundError):
            for info in self.fs.ls(path, detail=True):
                if (other := info["name"].rstrip("/")) != path:
                    names.setdefault(info["type"], []).append(other.rsplit("/", 1)[-1])
        return names["file"], names["directory"]

    def objects(self, name: str = "") -> dict[str, dict]:
        """What the store says of each object below a folder, by its name in there."""
        folder = self.path(name)
        with reached(self.url):
            found = self.fs.find(folder, detail=True)
        named = ((path[len(folder):].lstrip("/"), info) for path, info in found.items() if path[-1] != "/")
        return {each: info for each, info in named if each}  # a folder may be an object itself

    def contents(self) -> list[list]:
        """Name, size and what the store knows of the content of each object, by name."""
        return sorted([name, info["size"], str(info.get("ETag") or info.get("md5Hash")
                                               or self.fs.ukey(self.path(name)))]
                      for name, info in self.objects().items())

    def sizes(self, name: str) -> dict[str, int]:
        """Bytes of each object below a folder: one question to the store, however many there are."""
        return {each: info["size"] for each, info in self.objects(name).items()}

    def hash(self, name: str) -> str:
        """SHA-256 of an object's content, in hex."""
        with reached(self.url), self.fs.open(self.path(name), "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def move(self, name: str, other: str) -> None:
        """Rename a folder, object by object."""
        with reached(self.url):
            for each in self.sizes(name):
                self.fs.cp_file(self.path(f"{name}/{each}"), self.path(f"{other}/{each}"))
        self.remove(name)

    def remove(self, name: str) -> None:
        """Delete an object, or all below a folder."""
        with reached(self.url), contextlib.suppress(FileNotFoundError):
            self.fs.rm(self.path(name), recursive=True)


Store = Disk | Bucket  # with the same deeds


def copied(store: Bucket, name: str, folder: Path) -> None:
    """Copy a folder of an object store to this machine."""
    for each in store.sizes(name):
        if stays_inside(each) and "\\" not in each:
            store.fetch(f"{name}/{each}", folder / each)


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
