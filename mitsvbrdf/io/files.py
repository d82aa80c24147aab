"""Write files whole or not at all; read files, and resolve names, so that no link leads elsewhere.

A write makes a new file beside its target, and then renames it to the target. A path given by a user may
be a symbolic link. Inside a result folder, links, pipes and devices are not accepted.
"""

import contextlib
import ctypes
import errno
import hashlib
import io
import json
import os
import shutil
import stat
import threading
import uuid
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from ..errors import ConfigError, OutputError

wrote = threading.Event()  # set once this process has written a file
AT_FDCWD, RENAME_EXCHANGE = -100, 2  # constants of Linux
_CAREFULLY = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC  # follows no link, waits for no pipe


def write_json(path: Path, value: object) -> None:
    """Write indented JSON. ValueError: NaN or infinity, which JSON does not have."""
    write_bytes(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Replace a file's content in one step."""
    with atomic_write(path) as temporary:
        temporary.write_bytes(data)


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; rename it to ``path`` if the block succeeds, else remove it.

    If ``path`` is a symbolic link, the link's target is replaced. OutputError: the folder or file cannot be
    made or written, or ``path`` exists and is no file.
    """
    path, temporary = _places(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
        wrote.set()
    except OSError as reason:
        forbidden = reason.errno in (errno.EACCES, errno.EPERM, errno.EROFS)
        way_out = f"{'check your rights' if forbidden else 'free space'} or choose another place"
        raise OutputError(f"to write {path}", reason.strerror or str(reason), way_out) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def file_lock(path: Path, seconds: float = -1) -> Iterator[None]:
    """Lock a file or folder for this process and thread, with a file ``.NAME.lock`` beside it.

    The path need not exist, but its folder must. ``seconds``: how long to wait for the lock;
    negative: no limit. OutputError: another run still has the lock. OSError: no lock file can be made.
    """
    place = _lock_file(path)
    with contextlib.suppress(FileNotFoundError):  # another run may remove its lock file meanwhile
        if not stat.S_ISREG(place.lstat().st_mode):
            raise OSError(errno.EEXIST, "there is no file, but a link, a pipe or a folder", str(place))
    lock = FileLock(place, timeout=seconds, poll_interval=0.02)
    try:
        lock.acquire()
    except Timeout:
        raise taken(path) from None
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            place.unlink()
        lock.release()


def in_use(path: Path) -> bool:
    """Whether a :func:`file_lock` on this path is held now."""
    try:
        if is_regular(_lock_file(path)):
            with file_lock(path, 0):
                pass
        return False
    except OutputError:
        return True
    except OSError:
        return False


def taken(path: Path) -> OutputError:
    """The error to raise if another run has the lock."""
    return OutputError("a place of its own for each run", f"{path}, in use by another run",
                       "wait for it, or choose another place")


def _lock_file(path: Path) -> Path:
    path = Path(os.path.realpath(path))
    return path.with_name(f".{path.name}.lock")


def file_hash(path: Path) -> str:
    """SHA-256 of a regular file's content, in hex."""
    with open_regular(Path(os.path.realpath(path))) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_regular(path: Path, most: int, links: bool = True) -> bytes:
    """The content of a regular file, by default also through a link. ValueError: more than ``most`` bytes."""
    with open_regular(Path(os.path.realpath(path)) if links else path) as file:
        if os.fstat(file.fileno()).st_size > most:
            raise ValueError(f"more than {most >> 20} MiB")
        return file.read()


def open_regular(path: Path) -> io.BufferedReader:
    """Open a regular file to read bytes. OSError: missing, or a link, a pipe, a device or a folder."""
    descriptor = os.open(path, os.O_RDONLY | _CAREFULLY)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "no regular file", str(path))
    return open(descriptor, "rb")


def is_regular(path: Path | None) -> bool:
    """Whether this path is a regular file and not a link; False for None."""
    try:
        return path is not None and stat.S_ISREG(path.lstat().st_mode)
    except (OSError, ValueError):
        return False


def stays_inside(name: object) -> bool:
    """Whether a name read from a file stays in the folder it is joined to; links are not checked."""
    try:
        if not isinstance(name, str) or b"\0" in os.fsencode(name):
            return False
    except UnicodeEncodeError:  # no file can have this name
        return False
    path = Path(name)
    return bool(path.parts) and not path.anchor and ".." not in path.parts


def is_entry(name: object) -> bool:
    """Whether a name read from a file can be a direct entry of a folder, and has no wildcards."""
    return stays_inside(name) and Path(str(name)).parts == (name,) and not set("*?[\\") & set(str(name))


def inside(folder: Path, name: str) -> Path | None:
    """A folder joined with a name read from a file; None if this leaves the folder or crosses a link."""
    if not stays_inside(name):
        return None
    path = Path(folder)
    for part in Path(name).parts:
        path /= part
        if path.is_symlink():
            return None
    return path


def exchange(one: Path, other: Path) -> None:
    """Exchange two folders in one step, or by three renames if the system or its disk has no such step.

    A kill after the first rename leaves ``other`` whole as ``.NAME.old``. The next command restores it.
    """
    try:
        renamed = ctypes.CDLL(None, use_errno=True).renameat2(
            AT_FDCWD, os.fsencode(one), AT_FDCWD, os.fsencode(other), RENAME_EXCHANGE)
        failure = ctypes.get_errno() if renamed else 0
    except (AttributeError, OSError, TypeError):  # another system, or an old C library
        failure = errno.ENOSYS
    if failure in (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP):
        spare = spare_name(other)
        os.rename(other, spare)
        try:
            os.rename(one, other)
        except BaseException:
            os.rename(spare, other)
            raise
        os.rename(spare, one)
    elif failure:
        raise OSError(failure, os.strerror(failure), str(other))


def spare_name(folder: Path) -> Path:
    """The temporary path of a folder while :func:`exchange` renames."""
    return folder.with_name(f".{folder.name}.old")


def linked(path: Path, target: Path) -> None:
    """Make a hard link to a file, or a copy if the disk has no hard links."""
    try:
        os.link(path, target, follow_symlinks=False)
    except OSError:
        shutil.copy2(path, target, follow_symlinks=False)


def remove(path: Path) -> None:
    """Remove a file, a folder with its content, or a link but not its target."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def to_disk(path: Path) -> None:
    """Flush a file or folder to the disk. OSError: impossible; some systems cannot flush folders."""
    descriptor = os.open(path, os.O_RDONLY | _CAREFULLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_output(*paths: Path | None) -> None:
    """Raise OutputError now if :func:`atomic_write` could not write these files later; None is skipped.

    The check leaves no file behind, and makes no folder.
    """
    for path in filter(None, paths):
        target, temporary = _places(path)
        try:
            probe = next(folder for folder in target.parents if os.path.lexists(folder)) / temporary.name
            probe.touch()
            probe.unlink()
        except OSError as reason:
            raise OutputError(f"to write {path}", reason.strerror or str(reason),
                              "choose another place") from None


def check_names(*names: str | Path) -> None:
    """Raise ConfigError if a file name is not UTF-8: pages and JSON files could not contain it."""
    for name in map(str, names):
        try:
            name.encode()
        except UnicodeEncodeError:
            raise ConfigError("names of files in UTF-8", name.encode("utf-8", "backslashreplace").decode(),
                              "rename the file or folder") from None


def _places(path: Path) -> tuple[Path, Path]:
    """The path after following links, and a temporary path beside it. OutputError: it is no regular file."""
    try:
        target = Path(os.path.realpath(path))
    except FileNotFoundError:
        raise OutputError(f"a current folder to write {path} in", "one that was deleted",
                          "change to an existing folder, or give an absolute path") from None
    check_names(target)
    if os.path.lexists(target) and not target.is_file():  # a rename would replace a device or a pipe
        what = "a folder" if target.is_dir() else "no regular file"
        raise OutputError("a file to write", f"{path}, which is {what}", "give another name")
    return target, target.with_name(f".{target.stem}-{uuid.uuid4().hex[:8]}{target.suffix}")
