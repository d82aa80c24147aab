"""The page of a library: ``index.html``, which shows every material, and ``library.js``, its data.

A page that is opened from disk may not read a JSON file, but it may load a script: ``library.js`` is JSON in
an assignment. All materials may be thousands; ``library.js`` and ``cards.js`` of this folder, which the page
holds, show only those near the window.
"""

from __future__ import annotations

import json
import math
import re
import secrets
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from ...io import files
from ...report.page import page_text
from .where import SEARCHED, STATES, described

PAGE_FILE, DATA_FILE = "index.html", "library.js"
GLOBAL = "mitsvbrdfLibrary"  # what the data file sets

ABOUT = ("title", "made", "version", "progress", "stopped", "command")  # of the library as a whole
# Of a row, in the data file one list each: their names stand there once and not ten thousand times.
COLUMNS = ("name", "id", "folder", "state", "error", "left_out_error", "burn_in", "warnings", "seconds",
           "peak_bytes",
           "attempts", "date", "tags", "method", "resolution", "photos", "worker", "host", "source",
           "options", "reason")
LINKS = {"preview": "preview", "report": "report", "log": "log"}  # column of an address: the row's path
SORTS = {"name": "Name", "error": "Error", "left_out_error": "Left-out error", "burn_in": "Burn-in",
         "warnings": "Warnings",
         "seconds": "Seconds", "memory": "Memory", "attempts": "Attempts", "date": "Date"}


def write_library_page(folder: Path, library: dict) -> None:
    """Write ``index.html`` and ``library.js`` into the folder of a library.

    The page opens from disk and from a server, asks for nothing outside its folder, and takes whatever a row
    says as text. From a server it follows a batch at work: it asks for ``library.js`` again.

    Args:
        folder: of the library.
        library: as in ``library.json``: ``title``, ``made``, ``version``, ``materials`` (a row each); of a
            batch at work ``progress`` with ``per_hour`` and ``left_seconds``, either of which may be None; of
            one that ended with work left ``stopped``, and where known ``command``, which goes on.

    Raises:
        OutputError: the folder cannot be written.
    """
    files.write_bytes(Path(folder) / DATA_FILE, data_script(library).encode())
    files.write_bytes(Path(folder) / PAGE_FILE, library_page(library["title"],
                                                             secrets.token_urlsafe(16)).encode())


def library_page(title: str, nonce: str, served: bool = False) -> str:
    """The page without its data.

    Args:
        title: of the library.
        nonce: of its scripts.
        served: whether `mitsvbrdf view` shows it: it then looks for news also while no batch is at work.
    """
    asked = _json({"fields": described(), "states": STATES, "searched": SEARCHED, "served": served})
    return page_text("batch/library/library.html", title=title, sorts=SORTS, data_file=DATA_FILE,
                     fields=described(), nonce=nonce, asked=asked)


def data_script(library: Mapping) -> str:
    """The data file: one assignment, on its right JSON, ASCII, without a ``<``. Rows are in the order of
    their names.
    """
    rows = sorted(library["materials"], key=lambda row: _natural(row["name"]))
    columns = {name: [_finite(row.get(name)) for row in rows] for name in COLUMNS}
    columns |= {name: [address(row.get(path)) for row in rows] for name, path in LINKS.items()}
    data = {name: library.get(name) for name in ABOUT} | {"columns": columns}
    return f"{GLOBAL} = {_json(data)};\n"


def address(path: str | None) -> str | None:
    """A path below the library as a relative address; None for one that leads elsewhere.

    Each part is percent-encoded, so that none is a query or a fragment. Absolute paths, those with a scheme,
    with ``..``, ``.`` or an empty part, and those with a backslash, which a browser may take for a slash,
    lead nowhere.
    """
    if not path or "\\" in path or re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", path):
        return None
    parts = path.split("/")
    if any(part in ("", ".", "..") for part in parts):
        return None
    try:
        return "/".join(quote(part, safe="", errors="surrogateescape") for part in parts)
    except UnicodeEncodeError:  # half a character: no name of a file
        return None


def _json(value: object) -> str:
    """JSON that may stand in a script: ASCII, so without U+2028, and nothing that looks like a tag."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", r"\u003c")


def _finite(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _natural(name: str) -> tuple:
    """Numbers in a name count as such: oak-2 comes before oak-10."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return [(len(digits := part.lstrip("0")), digits) if k % 2 else part
            for k, part in enumerate(parts)], name
