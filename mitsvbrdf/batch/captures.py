"""Find the captures of a batch in folders, URLs and lists; each may have options of its own."""

import contextlib
import os
import re
import shlex
import tempfile
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ..capture.photo import SUFFIXES
from ..color import Transfer
from ..errors import CaptureError, ConfigError, MitsvbrdfError, warn_of
from .stores import Store, is_url

TOKEN = ".token"  # the file that marks a library
CALIBRATIONS = ("capture.json", "camera_pos.txt")
SIDE = 1024  # pixels a side of photos rectified here, at most; or the resolution of the fit, if that is more


class Entry(NamedTuple):
    """A capture to fit."""

    source: str  # its absolute path, or its URL
    own: tuple[str, ...] = ()  # options on its line of a list, split into words
    where: str = ""  # list and line, for errors; empty for a name on the command line
    base: str = ""  # paths in the options are relative to this folder; empty: to the current one


@contextlib.contextmanager
def told_with(where: str) -> Iterator[None]:
    """Add ``where`` to the text of each error that is raised inside the block, unless it has it."""
    try:
        yield
    except MitsvbrdfError as error:
        if where in str(error):
            raise
        raise type(error)(error.expected, f"{error.got} ({where})", error.fix) from None


def captures(names: Sequence[str]) -> list[Entry]:
    """The captures found under these names, in the order of the names.

    A name is a capture (a folder, its JSON file, or a URL), a folder of captures, or a list: a text file
    with a capture or folder of captures a line, then options. ``#`` begins a remark. Libraries are skipped.

    Raises:
        CaptureError: nothing is found under a name, or there is no capture at all.
    """
    found = [entry for name in names for entry in _expanded(name)]
    if not found:
        raise CaptureError("captures to fit", "none", "name folders, or a list file")
    return found


def name_of(source: str) -> str:
    """The name of a capture's folder; ``_`` replaces all but ASCII letters, digits, ``.``, ``_``, ``-``."""
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
    """A capture as a local folder. A capture behind a URL is copied; the copy lasts as long as the block."""
    if not is_url(source):
        yield Path(source)
        return
    with tempfile.TemporaryDirectory(prefix="mitsvbrdf-capture-") as folder:
        target = Path(folder) / name_of(source)
        Store(source).fetch(target)
        yield target


def rectified(folder: Path, out: Path, sheet: float | None, transfer: Transfer | None,
              resolution: int) -> Path:
    """Rectify raw photos into a capture in ``out``, with its page; return the folder of the capture to fit.

    Rectified photos stay where they are. The photos of ``out`` have at most :data:`SIDE` pixels a side, or
    ``resolution`` if that is more. ``transfer`` None: as in the photos. CaptureError: no poses can be found.
    """
    from ..capture import write_capture
    from ..capture.align.from_sheet import refuse_tags
    from ..capture.photo import Photo, photos_in
    from ..capture.rig import LEAST_PHOTOS, OnePlace
    from ..capture.stages import MOST_SIDE, capture_keys, make_capture
    from ..report.capture_page import write_quality

    if is_calibrated(str(folder)):
        return folder
    photos = [Photo.open(path) for path in photos_in(folder)]
    if sheet is None:
        refuse_tags(photos, "give that, for example `--sheet 18`, to the command or on the line of a list")
        if len(photos) < LEAST_PHOTOS:
            return folder
    try:
        made = make_capture(photos, sheet, transfer=transfer,
                            resolution=min(max(resolution, SIDE), MOST_SIDE))
    except OnePlace:  # the photos are rectified already, without views: the fit estimates these
        return folder
    write_capture(made.capture, out, capture_keys(made))
    write_quality(made, out)
    return out


def _expanded(name: str, own: tuple[str, ...] = (), where: str = "", base: str = "") -> Iterator[Entry]:
    """The captures of one name; ``where`` is not empty for a name in a list."""
    path = Path(os.path.expanduser(name))
    if is_url(name):
        yield from (Entry(url, own, where, base) for url in _behind(name))
    elif path.is_dir():
        yield from (Entry(os.path.realpath(folder), own, where, base) for folder in _captures_in(path))
    elif path.suffix.lower() == ".json" and path.is_file():
        yield Entry(os.path.realpath(path), own, where, base)
    elif not where and path.is_file():
        yield from _listed(path)
    else:
        kind = "a folder of photos" if where else "a folder of photos or a list file"
        raise CaptureError(kind, f"{'no folder' if path.exists() else 'nothing'} at {name}", "check the name")


def _captures_in(folder: Path) -> list[Path]:
    """The folder itself if it is a capture, else the captures directly inside it. A library has none."""
    if (folder / TOKEN).is_file():
        return []
    found, inside = _capture_at(folder), list[Path]()
    if os.access(folder, os.R_OK) and (not found or found == folder and not is_calibrated(str(folder))):
        inside = [there for each in sorted(folder.iterdir()) if each.is_dir() and each.name[0] != "."
                  and (there := _capture_at(each))]
    if found and inside:
        warn_of(" is one capture, since photos lie right in it; the folders of photos inside it are passed "
                f"over: {', '.join(each.name for each in inside)}", folder)
    if found:
        return [found]
    if not inside:
        raise CaptureError("a capture, or a folder of captures", f"{folder}, which has no photos",
                           "check the name")
    return inside


def _capture_at(folder: Path) -> Path | None:
    """The folder if it is a capture, else the JSON file in it that describes a capture, else None."""
    from ..capture.calibrated import stated_in

    try:
        return folder if is_capture(os.listdir(folder)) else stated_in(folder)
    except PermissionError:
        return folder  # the batch then reports this capture as failed, and goes on with the others


def _behind(url: str) -> list[str]:
    """The URL itself if it is a capture, else the URLs of the captures directly inside it."""
    store = Store(url.removesuffix("/capture.json"))
    with contextlib.suppress(FileNotFoundError), store.reached():
        names, folders = store.listed()
        inside = (f"{store.address.rstrip('/')}/{name}" for name in sorted(folders) if name[0] != ".")
        found = [store.address] if is_capture(names) else [each for each in inside
                                                           if is_capture(Store(each).listed()[0])]
        if found:
            return found
    raise CaptureError("captures", f"none at {url}", "check the address")


def _listed(path: Path) -> Iterator[Entry]:
    """The entries of a list file. A relative path starts in the folder of the list."""
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, ValueError) as reason:
        raise CaptureError("a list of captures, one a line", f"{path}: {reason}",
                           "write it as UTF-8 text") from None
    for number, line in enumerate(lines, 1):
        where = f"line {number} of {path}"
        with told_with(where):
            try:
                words = shlex.split(re.sub(r"(^|\s)#.*", "", line))
            except ValueError as reason:
                raise ConfigError("a capture and its options", str(reason), "close the quotes") from None
            if words:
                source = words[0] if is_url(words[0]) else str(path.parent / os.path.expanduser(words[0]))
                yield from _expanded(source, tuple(words[1:]), where, os.path.abspath(path.parent))
