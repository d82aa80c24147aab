"""Write files whole or not at all; read and name files without links that lead elsewhere.

A write makes a new file beside its target, and then renames it onto the target. A path that a user gives may
be a symbolic link. Inside a folder of results a link, a pipe or a device is refused.
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

wrote = threading.Event()  # whether this process has written a file
AT_FDCWD, RENAME_EXCHANGE = -100, 2  # of Linux
_CAREFULLY = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC  # no link is followed, no pipe waited for


def write_json(path: Path, value: object) -> None:
    """Indented JSON; NaN and infinity are refused, since JSON has none."""
    write_bytes(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Replace a file's content in one step."""
    with atomic_write(path) as temporary:
        temporary.write_bytes(data)


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A temporary name in the same folder, renamed onto ``path`` when the block ends well, else removed.

    Where ``path`` is a symbolic link, the link's target is replaced. OutputError: the folder cannot be made
    or written to, or something other than a file has this name.
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

    The path need not exist, but its folder must. ``seconds`` is the longest wait for another holder;
    negative: no limit. OutputError: another one has the lock. OSError: no lock can be made there.
    """
    place = _lock_file(path)
    with contextlib.suppress(FileNotFoundError):  # another run may take its lock away meanwhile
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
    """Whether somebody holds :func:`file_lock` on this path."""
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
    """What to raise where another run holds the lock."""
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
    """The content of a regular file, by default also through a link; ValueError above ``most`` bytes."""
    with open_regular(Path(os.path.realpath(path)) if links else path) as file:
        if os.fstat(file.fileno()).st_size > most:
            raise ValueError(f"more than {most >> 20} MiB")
        return file.read()


def open_regular(path: Path) -> io.BufferedReader:
    """A regular file, open as bytes; OSError for none, and for a link, a pipe, a device or a folder."""
    descriptor = os.open(path, os.O_RDONLY | _CAREFULLY)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "no regular file", str(path))
    return open(descriptor, "rb")


def is_regular(path: Path | None) -> bool:
    """Whether this path is a regular file, and no link to one; False for None."""
    try:
        return path is not None and stat.S_ISREG(path.lstat().st_mode)
    except (OSError, ValueError):
        return False


def stays_inside(name: object) -> bool:
    """Whether a name that a file states cannot lead out of the folder it is joined to, links aside."""
    try:
        if not isinstance(name, str) or b"\0" in os.fsencode(name):
            return False
    except UnicodeEncodeError:  # no file can have this name
        return False
    path = Path(name)
    return bool(path.parts) and not path.anchor and ".." not in path.parts


def is_entry(name: object) -> bool:
    """Whether a name that a file states is a direct entry of a folder, and no pattern with wildcards."""
    return stays_inside(name) and Path(str(name)).parts == (name,) and not set("*?[\\") & set(str(name))


def inside(folder: Path, name: str) -> Path | None:
    """The path in a folder of a name that a file states; None if it leaves the folder or crosses a link."""
    if not stays_inside(name):
        return None
    path = Path(folder)
    for part in Path(name).parts:
        path /= part
        if path.is_symlink():
            return None
    return path


def exchange(one: Path, other: Path) -> None:
    """Exchange two folders in one step; where the system or its disk has no such step, by three renames.

    A kill between the first two leaves ``other`` whole as ``.NAME.old``. The next command puts it back.
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
    """Where :func:`exchange` by renames keeps a folder for a moment."""
    return folder.with_name(f".{folder.name}.old")


def linked(path: Path, target: Path) -> None:
    """Give a file a second name; a copy where the disk has no hard links."""
    try:
        os.link(path, target, follow_symlinks=False)
    except OSError:
        shutil.copy2(path, target, follow_symlinks=False)


def remove(path: Path) -> None:
    """Remove a file, or a folder with all in it; of a link, only the link."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def to_disk(path: Path) -> None:
    """Flush a file or folder to the disk; OSError where it is impossible, as for folders of some systems."""
    descriptor = os.open(path, os.O_RDONLY | _CAREFULLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_output(*paths: Path | None) -> None:
    """Raise OutputError now for files that :func:`atomic_write` could not write later; None is skipped.

    Nothing is left behind, and missing folders are not made yet.
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
    """Raise ConfigError for names of files that are not UTF-8: no page and no record can state them."""
    for name in map(str, names):
        try:
            name.encode()
        except UnicodeEncodeError:
            raise ConfigError("names of files in UTF-8", name.encode("utf-8", "backslashreplace").decode(),
                              "rename the file or folder") from None


def _places(path: Path) -> tuple[Path, Path]:
    """The file that a path stands for, links followed, and the temporary name beside it."""
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
