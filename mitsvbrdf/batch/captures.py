"""The captures of a batch: named by folders, patterns, URLs and lists, each with its own options.

Raw photos become a capture before they are fitted.
"""

from __future__ import annotations

import contextlib
import glob
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ..capture.photo import SUFFIXES
from ..color import Transfer
from ..errors import CaptureError, ConfigError, MitsvbrdfError
from .stores import Store, is_url

TOKEN = ".token"  # what a library is known by
CALIBRATIONS = ("capture.json", "camera_pos.txt")
PATTERN = frozenset("*?[")
SIDE = 1024  # pixels a side of the photos that are rectified here


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

    def __init__(self) -> None:
        self.found: dict[str, MitsvbrdfError] = {}  # by its words: all captures of one line share a mistake

    @contextlib.contextmanager
    def gathered(self, where: str = "") -> Iterator[None]:
        """Keep what is raised inside, and add the place where the error does not name it."""
        try:
            yield
        except MitsvbrdfError as error:
            if where and where not in str(error):
                error = type(error)(error.expected, f"{error.got} ({where})", error.fix)
            self.found.setdefault(str(error), error)

    def tell(self) -> None:
        """Raise the only mistake, or one error that names all; nothing where there is none."""
        if len(self.found) == 1:
            raise next(iter(self.found.values()))
        if self.found:
            raise ConfigError("no mistakes", str(len(self.found)), "\n  ".join(["mend them:", *self.found]))


def captures(names: Sequence[str], mistakes: Mistakes) -> list[Entry]:
    """The captures that names stand for, in their order.

    Args:
        names: each a capture (a folder, its JSON file, or a URL), a folder of captures, a pattern of these,
            or a list: a text file with one of these a line, options behind it, ``#`` before a remark; ``-``
            is a list on standard input. A library among captures is passed over.
        mistakes: gathers wrong names and lines; the captures of the others are returned.

    Raises:
        CaptureError: the names stand for no capture at all.
    """
    found = list[Entry]()
    for name in names:
        with mistakes.gathered():
            found += _expanded(name, mistakes)
    if not found and not mistakes.found:
        raise CaptureError("captures to fit", "none", "name folders, patterns like 'shots/*', or a list file")
    return found


def name_of(source: str) -> str:
    """What a capture is called: its folder's name in letters that every file system has."""
    path = source.split("://", 1)[-1].rstrip("/")
    name = os.path.basename(os.path.dirname(path) if path.endswith(".json") else path)
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "._-") else "_" for c in name)
    return kept.strip("._-")[:80] or "capture"


def is_capture(names: Collection[str]) -> bool:
    """Whether a folder with files of these names is a capture and not, say, a fit."""
    photos = any(os.path.splitext(name)[1].lower() in SUFFIXES and name[0] != "." for name in names)
    return any(name in CALIBRATIONS for name in names) or photos and "fit.json" not in names


def is_calibrated(source: str) -> bool:
    """Whether a capture (its folder, its JSON file, or a URL) states its views; raw photos do not."""
    if is_url(source):
        return any(name in CALIBRATIONS for name in Store(source).objects())
    return os.path.isfile(source) or any(os.path.isfile(os.path.join(source, name)) for name in CALIBRATIONS)


@contextlib.contextmanager
def local_capture(source: str) -> Iterator[Path]:
    """A capture as a folder on this machine; the copy of one behind a URL lasts as long as the block."""
    if not is_url(source):
        yield Path(source)
        return
    with tempfile.TemporaryDirectory(prefix="mitsvbrdf-capture-") as folder:
        target = Path(folder) / name_of(source)
        Store(source).fetch("", target)
        yield target


def rectified(folder: Path, out: Path, sheet: float | None, transfer: Transfer | None) -> Path:
    """The capture to fit: raw photos become one in ``out``, any other stays as it is.

    Args:
        folder: of the capture, or its JSON file.
        out: takes the new capture and its page.
        sheet: size of the printed sheet around the material in cm; None where there is none.
        transfer: how the photos encode light; None where they say it.

    Raises:
        CaptureError: the raw photos make no capture.
    """
    from ..capture import write_capture
    from ..capture.align.from_sheet import refuse_tags
    from ..capture.photo import Photo, photos_in
    from ..capture.rig import LEAST_PHOTOS, OnePlace
    from ..capture.stages import capture_keys, make_capture
    from ..report.capture_page import write_quality

    if is_calibrated(str(folder)):
        return folder
    photos = [Photo.open(path) for path in photos_in(folder)]
    if sheet is None:
        refuse_tags(photos, "give that, for example `--sheet 18`, to the command or on the line of a list")
        if len(photos) < LEAST_PHOTOS:
            return folder
    try:
        made = make_capture(photos, sheet, transfer=transfer, resolution=SIDE)
    except OnePlace:  # the photos are rectified already, without views: the fit estimates these
        return folder
    write_capture(made.capture, out, capture_keys(made))
    write_quality(made, out)
    return out


def _expanded(name: str, mistakes: Mistakes, own: tuple[str, ...] = (), where: str = "") -> Iterator[Entry]:
    """The captures of one name; mistakes in the lines of a list are gathered, others are raised."""
    if is_url(name):
        yield from (Entry(url, own, where) for url in _behind(name))
        return
    path = Path(os.path.expanduser(name))
    if PATTERN & set(name) and not path.exists():
        matches = sorted(glob.glob(str(path)))
        if not matches:
            raise CaptureError("captures that match", f"none like {name}", "check the name")
        for match in matches:
            if os.path.isdir(match) or name.endswith(".json") or not where and not match.endswith(".json"):
                yield from _expanded(match, mistakes, own, where)
    elif path.is_dir():
        yield from (Entry(os.path.realpath(folder), own, where) for folder in _captures_in(path))
    elif path.suffix.lower() == ".json" and path.is_file():
        yield Entry(os.path.realpath(path), own, where)
    elif not where and (name == "-" or path.is_file()):
        yield from _listed(name, mistakes)
    else:
        raise CaptureError("a folder of photos or a list file", f"nothing at {name}", "check the name")


def _captures_in(folder: Path) -> list[Path]:
    """The folder itself where it is a capture, else the captures right inside it; none of a library."""
    if (folder / TOKEN).is_file():
        return []
    if _folder_is_capture(folder):
        return [folder]
    inside = sorted(each for each in folder.iterdir() if each.is_dir() and each.name[0] != "."
                    and _folder_is_capture(each))
    if not inside:
        raise CaptureError("a capture, or a folder of captures", f"{folder}, which has no photos",
                           "check the name")
    return inside


def _folder_is_capture(folder: Path) -> bool:
    try:
        return is_capture(os.listdir(folder))
    except PermissionError:
        return True  # the batch then says so of this capture, and goes on with the others


def _behind(url: str) -> list[str]:
    """The captures that a URL stands for: itself, or those right inside it."""
    store = Store(url.removesuffix("/capture.json"))
    with contextlib.suppress(FileNotFoundError), store.reached():
        names, folders = store.listed()
        inside = (f"{store.address.rstrip('/')}/{name}" for name in sorted(folders) if name[0] != ".")
        found = [store.address] if is_capture(names) else [each for each in inside
                                                           if is_capture(Store(each).listed()[0])]
        if found:
            return found
    raise CaptureError("captures", f"none at {url}", "check the address")


def _listed(name: str, mistakes: Mistakes) -> Iterator[Entry]:
    """The entries of a list; a relative path starts where the list lies. ``-`` is standard input."""
    path, called = Path(os.path.expanduser(name)), "standard input" if name == "-" else name
    try:
        text = (sys.stdin.buffer.read() if name == "-" else path.read_bytes()).decode("utf-8-sig")
    except (OSError, ValueError) as reason:
        raise CaptureError("a list of captures, one a line", f"{called}: {reason}",
                           "write it as UTF-8 text") from None
    for number, line in enumerate(text.splitlines(), 1):
        where = f"line {number} of {called}"
        with mistakes.gathered(where):
            if words := _words(line):
                source = words[0] if is_url(words[0]) else str(path.parent / os.path.expanduser(words[0]))
                yield from _expanded(source, mistakes, tuple(words[1:]), where)


def _words(line: str) -> list[str]:
    """Split as a shell does; a ``#`` at the beginning of a word begins a remark."""
    try:
        return shlex.split(re.sub(r"(^|\s)#.*", "", line))
    except ValueError as reason:
        raise ConfigError("a capture and its options", str(reason), "close the quotes") from None
