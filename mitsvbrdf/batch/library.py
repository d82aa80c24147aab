"""The list of a library's materials, read from its folders: rows for pandas and for the page."""

import json
import secrets
from collections import Counter

import msgspec

from .. import __version__
from ..report.page import page_text
from .fitting import now
from .records import Material
from .results import FAILED, LOG, PAGES, ResultStore

INDEX, DATA, PAGE = PAGES
STATES = "done", "failed", "running", "pending"
GLOBAL = "mitsvbrdfLibrary"  # the variable that the data script of the page sets
FILES = {"preview": "preview.jpg", "report": "report.html", "log": LOG}  # files shown or linked on the page
SEARCHED = "name", "tags", "source", "method", "host", "options", "reason"
SORTS = {"name": "Name", "error": "Error", "held_out_error": "Held-out error", "burn_in": "Burn-in",
         "seconds": "Seconds", "attempts": "Attempts", "date": "Date"}


class Library:
    """The materials of the library ``results``, read once and kept up to date by whoever changes it."""

    def __init__(self, results: ResultStore) -> None:
        self.results, self.materials = results, results.materials()
        self._failed = set(results.store.listed(FAILED)[1])
        self.running = set[str]()  # folders of the materials being fitted

    def done(self, result: Material) -> None:
        """Note that a result is in the library; an earlier failure is forgotten."""
        if result.folder in self._failed:
            self.results.forget(result.folder)
        self.materials[result.folder] = result

    def failed(self, material: Material, reason: str, log: str = "") -> None:
        """Note that a material failed; ``log`` is the output of the fit."""
        failure = material.but(state="failed", reason=reason, log=bool(log.strip()), date=now())
        self.results.fail(failure, log)
        self.materials[failure.folder] = failure
        self._failed.add(failure.folder)

    def shown(self) -> dict[str, Material]:
        """A dict: folder to material; of materials with the same capture and options only the newest."""
        newest: dict[tuple[str, str], Material] = {}
        # a pending material is newer than all others
        for each in sorted(self.materials.values(), key=lambda each: (each.state == "pending", each.date)):
            newest[each.source or each.folder, json.dumps(each.asked, sort_keys=True)] = each
        return {each.folder: each for each in newest.values()}

    def counts(self) -> Counter[str]:
        """How many of the materials of :meth:`shown` are in each state."""
        return Counter(each.state for each in self.shown().values())

    def rows(self, replaced: bool = False) -> list[dict]:
        """Rows as in ``library.json``, sorted by folder: of the newest materials, or of the replaced ones."""
        shown = self.shown()
        found = (each for folder, each in self.materials.items() if (folder not in shown) == replaced)
        return [self.row(each) for each in sorted(found, key=lambda each: each.folder.lower())]

    def row(self, material: Material) -> dict:
        """The row of a material; its paths are relative to the library."""
        folder = f"{FAILED}/{material.folder}" if material.state == "failed" else material.folder
        config, options = (found if isinstance(found := material.asked.get(name), dict) else {}
                           for name in ("config", "options"))
        there = {*material.files, *([LOG] if material.log else [])}
        return {**{name: getattr(material, name) for name in ("name", "state", "reason", "source", "tags",
                                                              "date", "attempts", "host")},
                **msgspec.structs.asdict(material.row), "id": material.identity[:8], "folder": folder,
                "state": "running" if material.folder in self.running else material.state,
                "options": material.words, "method": config.get("method"),
                "resolution": options.get("resolution"),
                **{name: f"{folder}/{file}" if file in there else None for name, file in FILES.items()}}

    def write(self, progress: str = "") -> None:
        """Write the page, and ``library.json`` for pandas and others. ``progress``: of a batch, in words."""
        write = self.results.store.write
        told = {"title": self.results.title, "made": now(), "version": __version__, "progress": progress,
                "materials": self.rows()}
        write(INDEX, (json.dumps(told, indent=1) + "\n").encode())
        write(DATA, data_script(told).encode())
        write(PAGE, library_page(self.results.title).encode())


def library_page(title: str) -> str:
    """The page without its data, as HTML. It opens from disk and loads nothing from outside its folder."""
    return page_text("batch/library.html", title=title, nonce=secrets.token_urlsafe(16), sorts=SORTS,
                     states=STATES, data=DATA, searched=json.dumps(SEARCHED))


def data_script(told: dict) -> str:
    """The data of the page: one assignment of JSON to a variable, in ASCII, without a ``<``.

    A page that is opened from disk may not read a JSON file, but it may load a script.
    """
    text = json.dumps(told, separators=(",", ":"), allow_nan=False)
    return f"{GLOBAL} = {text.replace('<', chr(92) + 'u003c')};\n"


def matches(row: dict, text: str) -> bool:
    """Whether one of the searched columns of a row contains a text; case does not count."""
    words = (" ".join(value) if isinstance(value, list) else str(value or "")
             for value in (row[name] for name in SEARCHED))
    return any(text.casefold() in word.casefold() for word in words)
