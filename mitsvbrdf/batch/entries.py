"""What a batch is asked to fit: folders of captures, patterns and lists, each entry a capture and its own
options.
"""

from __future__ import annotations

import contextlib
import glob
import io
import os
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ..errors import CaptureError, ConfigError, MitsvbrdfError
from .manifest import FILE
from .places.address import is_url
from .places.remote import is_capture, remote_captures

PATTERN = frozenset("*?[")


class Entry(NamedTuple):
    """A capture to fit.

    Args:
        source: its absolute path, or its URL.
        own: options that its line in a list gives, in words.
        where: the list and its line, for errors; empty for what the command line names.
    """

    source: str
    own: tuple[str, ...] = ()
    where: str = ""


class Mistakes:
    """Gathers mistakes, so that all are told at once."""

    TOLD = 20  # of more, only the number

    def __init__(self) -> None:
        self.found: dict[str, MitsvbrdfError] = {}  # by what it says: the lines of one pattern have the same

    @contextlib.contextmanager
    def gathered(self, where: str = "") -> Iterator[None]:
        """What is raised inside is kept, with its place where it does not name that itself."""
        try:
            yield
        except MitsvbrdfError as error:
            if where and where not in str(error):
                error = type(error)(error.expected, f"{error.got} ({where})", error.fix)
            self.found.setdefault(str(error), error)

    def tell(self) -> None:
        """Raise the mistake that there was, or one error that names all; nothing where there was none."""
        if len(self.found) == 1:
            raise next(iter(self.found.values()))
        if self.found:
            more = len(self.found) - self.TOLD
            lines = [*list(self.found)[:self.TOLD], *([f"and {more} more"] if more > 0 else [])]
            raise ConfigError("no mistakes", str(len(self.found)), "\n  ".join(["mend them:", *lines]))


def entries(names: Sequence[str], mistakes: Mistakes | None = None) -> list[Entry]:
    """The captures that names stand for, in their order.

    Args:
        names: each a capture (a folder, its JSON file, or a URL), a folder of captures, a pattern of these, a
            list file with one of these a line, options behind it, ``#`` before a remark; or ``-``, a list on
            standard input. A library among captures is passed over.
        mistakes: gathers those in names and lines, and the captures of the others are returned; left out:
            they are raised.

    Raises:
        CaptureError: a name that stands for no capture, with its line where it is in a list.
    """
    all_mistakes, found = mistakes or Mistakes(), list[Entry]()
    for name in names:
        with all_mistakes.gathered():
            found += _expanded(name, all_mistakes)
    if mistakes is None:
        all_mistakes.tell()
    if not found and not all_mistakes.found:
        raise CaptureError("captures to fit", "none", "name folders, patterns like 'shots/*', or a list file")
    return found


def name_of_source(source: str) -> str:
    """What a capture is called: its folder's name in letters that every file system has."""
    path = source.split("://", 1)[-1].rstrip("/")
    name = os.path.basename(os.path.dirname(path) if path.endswith(".json") else path)
    return "".join(letter if letter.isascii() and (letter.isalnum() or letter in "._-") else "_"
                   for letter in name
                   ).strip("._-")[:80] or "capture"


def _expanded(name: str, mistakes: Mistakes, own: tuple[str, ...] = (), where: str = "") -> Iterator[Entry]:
    """The captures of one name; mistakes in the lines of a list are gathered, others are raised."""
    if is_url(name):
        yield from (Entry(url, own, where) for url in remote_captures(name))
        return
    path = Path(os.path.expanduser(name))
    if PATTERN & set(name) and not path.exists():
        matches = sorted(glob.glob(str(path)))
        if not matches:
            raise _wrong("captures that match", f"none like {name}", where)
        for match in matches:
            if os.path.isdir(match) or name.endswith(".json") or not where and not match.endswith(".json"):
                yield from _expanded(match, mistakes, own, where)
    elif path.is_dir():
        yield from (Entry(os.path.realpath(folder), own, where) for folder in _captures_in(path, where))
    elif path.suffix.lower() == ".json" and path.is_file():
        yield Entry(os.path.realpath(path), own, where)
    elif not where and name == "-":
        yield from _listed(_lines("standard input", sys.stdin.buffer.read), "standard input", Path(),
                           mistakes)
    elif not where and path.is_file():
        yield from _listed(_lines(name, path.read_bytes), name, path.parent, mistakes)
    else:
        raise _wrong("a folder of photos or a list file", f"nothing at {name}", where)


def _captures_in(folder: Path, where: str) -> list[Path]:
    """The folder itself where it is a capture, else the captures right inside it; none of a library's."""
    if (folder / FILE).is_file():
        return []
    if _is_capture(folder):
        return [folder]
    inside = sorted(each for each in folder.iterdir() if each.is_dir() and each.name[0] != "."
                    and _is_capture(each))
    if not inside:
        raise _wrong("a capture, or a folder of captures", f"{folder}, which has no photos", where)
    return inside


def _is_capture(folder: Path) -> bool:
    try:
        return is_capture(os.listdir(folder))
    except PermissionError:
        return True  # registering says so, and goes on with the others


def _lines(name: str, read: Callable[[], bytes]) -> list[str]:
    try:
        return read().decode("utf-8-sig").splitlines()  # some editors begin a file with a mark
    except (OSError, ValueError) as reason:
        raise CaptureError("a list of captures, one a line", f"{name}: {reason}",
                           "write it as UTF-8 text") from None


def _listed(lines: Iterable[str], name: str, base: Path, mistakes: Mistakes) -> Iterator[Entry]:
    """The entries of a list; a relative path starts where the list lies."""
    for number, line in enumerate(lines, 1):
        where = f"line {number} of {name}"
        with mistakes.gathered(where):
            if words := _words(line, where):
                source = words[0] if is_url(words[0]) else str(base / os.path.expanduser(words[0]))
                yield from _expanded(source, mistakes, tuple(words[1:]), where)


def _words(line: str, where: str) -> list[str]:
    """Split as a shell does; ``#`` begins a remark where a word begins, and is a letter inside of one."""
    stream = io.StringIO(line)
    lexer = shlex.shlex(stream, posix=True)
    lexer.whitespace_split, lexer.commenters = True, ""
    words = []
    while (rest := line[stream.tell():].lstrip()) and rest[0] != "#":
        try:
            words.append(lexer.get_token() or "")
        except ValueError as reason:
            raise ConfigError("a capture and its options", f"{where}: {reason}", "close the quotes") from None
    return words


def _wrong(expected: str, got: str, where: str) -> CaptureError:
    return CaptureError(expected, f"{got} ({where})" if where else got, "check the name")
