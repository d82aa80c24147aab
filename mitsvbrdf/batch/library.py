"""What a library holds: rows for pandas and for the page, read from its folders."""

from __future__ import annotations

import json
import re
import secrets
from collections import Counter
from collections.abc import Collection
from urllib.parse import quote

import msgspec

from .. import __version__
from ..report.page import page_text
from .fitting import now
from .records import Failure, Material, Pending, Result, Row
from .results import FAILED, LOG, PAGES, ResultStore

INDEX, DATA, PAGE = PAGES
STATES = "done", "failed", "running", "pending"
GLOBAL = "mitsvbrdfLibrary"  # what the data of the page set
# Of a row, in the data of the page one list each: their names stand there once and not ten thousand times.
COLUMNS = ("name", "id", "folder", "state", "error", "held_out_error", "burn_in", "warnings", "seconds",
           "peak_bytes", "attempts", "date", "tags", "method", "resolution", "photos", "host", "source",
           "options", "reason")
FILES = {"preview": "preview.jpg", "report": "report.html"}  # of a result, what the page shows
LINKS = *FILES, "log"  # columns of addresses
SEARCHED = "name", "tags", "source", "method", "host", "options", "reason"
SORTS = {"name": "Name", "error": "Error", "held_out_error": "Held-out error", "burn_in": "Burn-in",
         "seconds": "Seconds", "peak_bytes": "Memory", "attempts": "Attempts", "date": "Date"}


class Library:
    """The materials of a library, read once and kept up to date by whoever changes it.

    Args:
        results: where it lies.
    """

    def __init__(self, results: ResultStore) -> None:
        self.results = results
        self.materials: dict[str, Material] = {**results.pending(), **results.failures()}
        self._unsettled = set(self.materials)  # folders that are waited for, or failed
        self.materials |= {name: found for name in results.names() if (found := results.result(name))}
        self.running = set[str]()  # folders of what is fitted now

    def wants(self, material: Pending) -> None:
        """A material waits to be fitted."""
        self.results.want(material)
        self.materials[material.folder] = material
        self._unsettled.add(material.folder)

    def done(self, result: Result) -> None:
        """A result lies in the library."""
        if result.folder in self._unsettled:
            self.results.settle(result.folder)
            self._unsettled.discard(result.folder)
        self.materials[result.folder] = result

    def failed(self, failure: Failure, log: str = "") -> None:
        """A material failed; its log is what the fit printed."""
        failure = msgspec.structs.replace(failure, log=bool(log.strip()), date=now())
        self.results.settle(failure.folder, failure, log)
        self.materials[failure.folder] = failure
        self._unsettled.add(failure.folder)

    def shown(self) -> dict[str, Material]:
        """The materials that no newer one of the same capture and options takes the place of."""
        newest: dict[tuple[str, str], Material] = {}
        for each in self.materials.values():
            other = newest.get(key := self.key(each))
            if other is None or _when(each) >= _when(other):
                newest[key] = each
        return {each.folder: each for each in newest.values()}

    @staticmethod
    def key(material: Material) -> tuple[str, str]:
        """What materials have in common of which one takes the other's place: capture and options."""
        return material.source or material.folder, json.dumps(material.asked, sort_keys=True)

    def state(self, material: Material) -> str:
        """One of STATES."""
        if isinstance(material, Result):
            return "done"
        if isinstance(material, Failure):
            return "failed"
        return "running" if material.folder in self.running else "pending"

    def counts(self) -> Counter[str]:
        """How many are in each state."""
        return Counter(map(self.state, self.shown().values()))

    def rows(self) -> list[dict]:
        """One row a material, as ``library.json`` has it, in the order of their names."""
        materials = sorted(self.shown().values(), key=lambda each: _natural(each.name))
        return [self.row(each) for each in materials]

    def row(self, material: Material) -> dict:
        """What is known of a material; paths are below the library."""
        state, row = self.state(material), material.row if isinstance(material, Result) else Row()
        folder = f"{FAILED}/{material.folder}" if state == "failed" else material.folder
        config, options = (found if isinstance(found := material.asked.get(name), dict) else {}
                           for name in ("config", "options"))
        found = {"name": material.name, "id": material.identity[:8], "folder": folder, "state": state,
                 "reason": material.reason if isinstance(material, Failure) else "",
                 **msgspec.structs.asdict(row), "attempts": material.attempts, "date": material.date,
                 "tags": material.tags, "host": material.host if isinstance(material, Result) else None,
                 "source": material.source, "options": material.words,
                 "method": row.method or config.get("method"),
                 "resolution": row.resolution or options.get("resolution"),
                 "log": f"{folder}/{LOG}" if isinstance(material, Failure) and material.log else None}
        return found | {name: f"{folder}/{file}" if found[name] else None for name, file in FILES.items()}

    def write(self, progress: str = "", command: str | None = None) -> None:
        """Write ``library.json``, for pandas and others, and the page.

        Args:
            progress: how the batch that is at work stands, in words; empty where none is.
            command: goes on with what is left.
        """
        rows = self.rows()
        about = {"title": self.results.title, "made": now(), "version": __version__, "progress": progress,
                 "command": command if any(row["state"] in ("running", "pending") for row in rows) else None}
        write = self.results.store.write
        write(INDEX, (json.dumps(about | {"materials": rows}, indent=1) + "\n").encode())
        write(DATA, data_script(about, rows).encode())
        write(PAGE, library_page(self.results.title).encode())


def library_page(title: str) -> str:
    """The page without its data; it opens from disk and asks for nothing outside of its folder."""
    return page_text("batch/library.html", title=title, nonce=secrets.token_urlsafe(16), sorts=SORTS,
                     states=STATES, data=DATA, searched=json.dumps(SEARCHED))


def data_script(about: dict, rows: list[dict]) -> str:
    """The data of the page: one assignment, on its right JSON, ASCII, without a ``<``.

    A page that is opened from disk may not read a JSON file, but it may load a script.
    """
    columns = {name: [row[name] for row in rows] for name in COLUMNS}
    columns |= {name: [row[name] and quote(row[name]) for row in rows] for name in LINKS}
    text = json.dumps(about | {"columns": columns}, separators=(",", ":"), allow_nan=False)
    return f"{GLOBAL} = {text.replace('<', chr(92) + 'u003c')};\n"


def matches(row: dict, text: str, states: Collection[str] = ()) -> bool:
    """Whether a row has a text in it, capitals or not, and one of these states; none stands for all."""
    words = (" ".join(value) if isinstance(value, list) else str(value or "")
             for value in (row[name] for name in SEARCHED))
    found = any(text.casefold() in word.casefold() for word in words)
    return found and (not states or row["state"] in states)


def _when(material: Material) -> str:
    """When it was the newest of its capture; what is asked for now is newer than all."""
    return "~" if isinstance(material, Pending) else material.date


def _natural(name: str) -> tuple:
    """Numbers in a name count as such: oak-2 comes before oak-10."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return [(len(digits := part.lstrip("0")), digits) if k % 2 else part
            for k, part in enumerate(parts)], name
