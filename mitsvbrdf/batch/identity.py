"""Which result belongs to which capture: a hash of all that decides it, so that nothing is fitted twice or
mistaken.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path

from .. import __version__
from ..capture.photo import SUFFIXES
from ..io.json import load
from .places.address import is_url
from .places.remote import CALIBRATIONS, remote_contents

CALIBRATION_FILES = ("capture.json", "camera_pos.txt", "image_size.txt", "light_power.txt", "light_pos.txt")

Hash = Callable[[Path], str]


def identity(source: str, asked: dict, hash_of: Hash) -> str:
    """SHA-256, in hex, of photos, calibration, options and version.

    Args:
        source: a capture's path, or its URL.
        asked: method, settings and options as JSON.
        hash_of: of a file's content; ``files.file_hash``, or one that remembers.
    """
    if is_url(source):
        contents: list[list] = remote_contents(source)
    else:
        contents = [[os.path.relpath(path, source), hash_of(path)] for path in capture_files(Path(source))]
    named = [[name, hash_of(Path(name))] for name in _files_named(asked)]
    text = json.dumps([__version__, asked, contents, named], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def identity_of_unreadable(source: str, asked: dict) -> str:
    """In the place of the identity of a capture whose photos cannot be read: a hash of its address and its
    options.
    """
    return hashlib.sha256(json.dumps([__version__, asked, source, "unreadable"],
                                     sort_keys=True).encode()).hexdigest()


def is_calibrated(source: str) -> bool:
    """Whether a capture (its folder, its JSON file, or a URL) states its views; others are raw photos."""
    if is_url(source):
        return any(name in CALIBRATIONS for name, *_ in remote_contents(source))
    return os.path.isfile(source) or any(os.path.isfile(os.path.join(source, name)) for name in CALIBRATIONS)


def capture_files(source: Path) -> list[Path]:
    """The files that a capture is read from: calibration and photos, by name."""
    folder = source.parent if source.is_file() else source
    folders = {folder}
    stated = source if source.is_file() else folder / "capture.json"
    try:
        target = load(stated)["target_dir"]
        folders.add(folder / target)
    except (OSError, ValueError, KeyError, TypeError):
        pass  # no such file, or a wrong one, which the fit will say
    inside = [path for each in folders if each.is_dir() for path in each.iterdir() if path.is_file()
              and path.name[0] != "."]
    return sorted({path for path in inside if path == source or path.name in CALIBRATION_FILES
                   or path.suffix.lower() in SUFFIXES})


def _files_named(asked: object) -> list[str]:
    """The files that options name: a fixed map, pretrained weights."""
    if isinstance(asked, dict):
        asked = list(asked.values())
    if isinstance(asked, (list, tuple)):
        return [name for part in asked for name in _files_named(part)]
    name = asked.partition("=")[2] or asked if isinstance(asked, str) else ""
    return [name] if name and os.path.isfile(name) else []
