"""A library in a browser of this machine, while a batch fills it and afterwards."""

from __future__ import annotations

import os
import secrets
import threading
from pathlib import Path

from ...io.files import open_regular
from ...io.json import parsed
from ...report.live import HTML, LIVE_POLICY, REPORT_POLICY, Answer
from ..manifest import FILE
from ..places.place import QUARANTINE
from ..prepare import TOKEN
from .page import DATA_FILE, PAGE_FILE, address, data_script, library_page
from .rows import INDEX

# Of a material, what is served: media type and content security policy.
KINDS = {"preview.jpg": ("image/jpeg", ""), "report.html": (HTML, REPORT_POLICY),
         "look.html": (HTML, REPORT_POLICY),
         "log.txt": ("text/plain; charset=utf-8", "")}
SERVED = {"done": ("preview.jpg", "report.html", "look.html"), "failed": ("log.txt",)}


def is_library(folder: Path) -> bool:
    """Whether a batch has made the folder its own."""
    return any((folder / name).is_file() for name in (FILE, TOKEN))


class LibrarySite:
    """The page of a library, its data, of each material that is done its picture and reports, and the log of
    one that failed.

    Page and data are made anew from ``library.json``, so that no script of the folder runs. A request is
    looked up in a table of addresses that is made from the same rows.

    Args:
        root: folder of the library; it need not be there yet.
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(os.path.abspath(root))
        self._lock = threading.Lock()
        self._read: tuple | None = None  # what tells one library.json from the next
        self._script = data_script({"title": self.root.name, "materials": []}).encode()
        self._files: dict[str, Path] = {}  # by address

    def answer(self, path: str) -> Answer | None:
        """The page, its data, or a file of a material."""
        if path in ("/", f"/{PAGE_FILE}"):
            nonce = secrets.token_urlsafe(16)
            page = library_page(self.root.name, nonce, served=True)
            return Answer(page.encode(), HTML, LIVE_POLICY.format(nonce=nonce))
        with self._lock:
            self._look()
            script, file = self._script, self._files.get(path)
        if path == f"/{DATA_FILE}":
            return Answer(script, "text/javascript", again=True)
        content = self._content(file) if file else None
        return Answer(content, *KINDS[file.name]) if file and content is not None else None

    def _look(self) -> None:
        """Read ``library.json`` where it is another one; one that cannot be read changes nothing."""
        try:
            found = (self.root / INDEX).stat()
            read = found.st_ino, found.st_size, found.st_mtime_ns
            if read == self._read:
                return
            library = parsed(self._content(self.root / INDEX) or b"")
            script = data_script(library).encode()
            self._files = {f"/{link}/{name}": self.root / row["folder"] / name for row in library["materials"]
                           if (link := address(row["folder"]))
                           and "/" not in row["folder"].removeprefix(f"{QUARANTINE}/")
                           for name in SERVED.get(row["state"], ())}
            self._read, self._script = read, script
        except (OSError, ValueError, KeyError, TypeError, AttributeError):  # gone by now, or no library's
            return

    def _content(self, file: Path) -> bytes | None:
        """A regular file's content; None where there is none, or it lies outside of the library."""
        try:
            real = file.resolve(strict=True)
            if not real.is_relative_to(self.root.resolve()):
                return None
            with open_regular(real) as opened:
                return opened.read()
        except (OSError, RuntimeError):
            return None
