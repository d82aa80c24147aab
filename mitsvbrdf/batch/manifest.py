"""What became of every capture of a library: one SQLite file, written by one batch at a time.

SQLite and not Parquet: each change of a state is a transaction of its own that survives a power cut, and rows
change thousands of times; ``library.json`` is what pandas reads. Files are the truth and this is their index:
a result that lies in the library counts as done, whatever stands here, and so a manifest that was lost is
made anew from them.
"""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from ..errors import OutputError
from ..io.files import file_hash, is_entry

FILE = "manifest.sqlite"
VERSION = 1
IN_MEMORY = ":memory:"  # in place of a file: for simulations
HASHES_SECONDS = 5.0  # between two writings of hashes: what Ctrl-C may cost
SHORT = 8  # letters of an identity that a folder's name has, beside the capture's
UNIQUE = 16  # and that an attempt's name has, alone: of 100,000 captures, two are likely to share eight
AWAY = "move it away; results are found again"
# SQLite holds anything in any column; this is what ours hold.
_KINDS = dict.fromkeys(("identity", "name", "folder", "source", "asked", "own", "tags", "state", "reason"),
                       (str,)) | {
    "cost": (int, float), "attempts": (int,), "seconds": (int, float, type(None)),
    "peak_bytes": (int, float, type(None))
} | dict.fromkeys(("published", "worker", "host", "date", "row"), (str, type(None)))
_TABLES = """
create table if not exists materials (
  identity text primary key, name text not null, folder text not null unique, source text not null, asked text not null,
  own text not null, tags text not null, cost real not null, wanted integer not null, state text not null default 'pending',
  reason text not null default '', attempts integer not null default 0, published text, seconds real, peak_bytes integer,
  worker text, host text, date text, row text);
create table if not exists attempts (
  attempt text primary key, identity text not null, worker text not null, host text, started text not null, ended text,
  state text not null default 'running', reason text not null default '', seconds real, peak_bytes integer);
create table if not exists hashes (path text primary key, bytes integer, changed integer, sha256 text);
create index if not exists by_state on materials (wanted, state);
create index if not exists by_source on materials (source);
"""


def now() -> str:
    """The time as the manifest has it: UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _opened(path: Path, readonly: bool) -> tuple[sqlite3.Connection, int]:
    """The file, and its version, 0 where it is new."""
    address = (f"{path.resolve().as_uri()}?mode={'ro' if readonly else 'rwc'}" if str(path) != IN_MEMORY
               else f"file:{path}")
    db = sqlite3.connect(address, uri=True, timeout=30)
    try:
        return db, db.execute("pragma user_version").fetchone()[0]
    except sqlite3.OperationalError:
        db.close()
        if not readonly:
            raise
    # a batch died in the midst of a change: whoever may write takes it back
    return _opened(path, readonly=False)


def _way_out(reason: sqlite3.Error, otherwise: str) -> str:
    """What to do about a file that cannot be opened or written."""
    code = getattr(reason, "sqlite_errorcode", 0) & 0xFF  # the rest of it says more than is needed here
    if code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_AUTH):
        return "check your rights to it and to its folder"
    return "free space" if code == sqlite3.SQLITE_FULL else otherwise


class Manifest:
    """The materials of a library, their attempts, and the hashes of files that did not change.

    Args:
        path: of the file, made where it is missing.
        readonly: whether it is only looked at; it may be in use by a batch meanwhile.

    Raises:
        OutputError: it cannot be opened, or is none of ours.
    """

    def __init__(self, path: Path, readonly: bool = False) -> None:
        self.path = path
        self._hashes: list[tuple[str, int, int, str]] = []  # not written yet
        self._hashes_due = 0.0
        try:
            self.db, version = _opened(path, readonly)
            if not readonly and not version:
                self.db.executescript(f"begin; {_TABLES} pragma user_version = {VERSION}; commit;")
                version = VERSION
            self.db.row_factory = sqlite3.Row
        except sqlite3.Error as reason:
            raise OutputError("a library's manifest", f"{path}: {reason}",
                              _way_out(reason, AWAY)) from None
        if version != VERSION:
            raise OutputError(f"a manifest of version {VERSION}", f"{version} in {path}",
                              "use the version that made it")

    def close(self) -> None:
        """Close the file."""
        if self._hashes:
            with contextlib.suppress(OutputError):
                self._keep_hashes()
        self.db.close()

    @contextmanager
    def _change(self) -> Iterator[None]:
        try:
            with self.db:
                yield
        except sqlite3.Error as reason:
            raise OutputError(f"to write {self.path}", str(reason),
                              _way_out(reason, "free space, or check the disk")) from None

    def wrong(self, what: str) -> OutputError:
        """The error of a file that holds something else than we wrote."""
        return OutputError("a library's manifest", f"{self.path}: {what}", AWAY)

    def _read(self, query: str, *values: object) -> list[sqlite3.Row]:
        try:
            return self.db.execute(query, values).fetchall()
        except sqlite3.Error as reason:
            raise OutputError("a library's manifest", f"{self.path}: {reason}",
                              _way_out(reason, AWAY)) from None

    def hash_of(self, path: Path) -> str:
        """A file's SHA-256, remembered for as long as its size and time of change stay."""
        stat, name = path.stat(), os.path.abspath(path)
        for known in self._read("select * from hashes where path = ?", name):
            if (known["bytes"], known["changed"]) == (stat.st_size, stat.st_mtime_ns):
                return known["sha256"]
        found = file_hash(path)
        self._hashes.append((name, stat.st_size, stat.st_mtime_ns, found))
        if time.monotonic() > self._hashes_due:
            self._keep_hashes()
        return found

    def _keep_hashes(self) -> None:
        """In few transactions: each takes as long as reading a photo."""
        with self._change():
            self.db.executemany("insert or replace into hashes values (?, ?, ?, ?)", self._hashes)
        self._hashes, self._hashes_due = [], time.monotonic() + HASHES_SECONDS

    def want(self, materials: Iterable[dict]) -> None:
        """These are what the batch is about; others stay, and are wanted no more where source and options are
        the same.

        Args:
            materials: ``identity``, ``name``, ``source``, ``asked`` (with ``folder``, where paths start, and
                ``limit`` in seconds), ``own`` (its options in words), ``tags``, ``cost``.
        """
        materials = list(materials)
        self._keep_hashes()
        with self._change():
            self.db.executemany(  # with other options it is another material, and stays
                "update materials set wanted = 0 where source = ? "
                "and json_remove(asked, '$.folder', '$.limit') = json_remove(?, '$.folder', '$.limit')",
                {(each["source"], json.dumps(each["asked"])) for each in materials})
            for each in materials:
                folder = f"{each['name']}-{each['identity'][:SHORT]}"
                self.db.execute(
                    "insert into materials (identity, name, folder, source, asked, own, tags, cost, wanted) "
                    "values "
                    "(:identity, :name, :folder, :source, :asked, :own, :tags, :cost, 1) on conflict "
                    "(identity) do update set "
                    "source = :source, asked = :asked, own = :own, tags = :tags, cost = :cost, wanted = 1",
                    each | {"folder": folder, "asked": json.dumps(each["asked"]),
                            "tags": json.dumps(each["tags"])})

    def refuse(self, reasons: Mapping[str, str]) -> None:
        """These have failed before anybody could try.

        Args:
            reasons: why, by identity.
        """
        with self._change():
            self.db.executemany("update materials set state = 'failed', reason = ? where identity = ?",
                                [(reason, identity) for identity, reason in reasons.items()])

    def materials(self, *states: str, wanted: bool = True) -> list[sqlite3.Row]:
        """The materials in these states, all where none is named; by name."""
        some = f" and state in ({', '.join('?' * len(states))})" if states else ""
        found = self._read(f"select * from materials where wanted >= ?{some} order by name, identity",
                           int(wanted), *states)
        for each in found:
            if wrong := next((name for name, kinds in _KINDS.items() if not isinstance(each[name], kinds)),
                             None):
                raise self.wrong(f"{each[wrong]!r:.60} as {wrong}")
            if not is_entry(each["folder"]):
                raise self.wrong(f"{each['folder']!r:.60} as folder")
        return found

    def material(self, identity: str) -> sqlite3.Row:
        """The material of an identity."""
        return self._read("select * from materials where identity = ?", identity)[0]

    def counts(self) -> dict[str, int]:
        """How many are wanted in each state."""
        return {"done": 0, "failed": 0, "running": 0, "pending": 0} | dict(
            map(tuple, self._read("select state, count(*) from materials where wanted = 1 group by state")))

    def begin(self, identity: str, worker: str, host: str) -> str:
        """An attempt begins; returns its name."""
        with self._change():
            self.db.execute("update materials set state = 'running', attempts = attempts + 1, worker = ?, "
                            "host = ?, "
                            "reason = '' where identity = ?", (worker, host, identity))
            count = self.db.execute("select attempts from materials where identity = ?",
                                    (identity,)).fetchone()[0]
            attempt = f"{identity[:UNIQUE]}-{count}"
            self.db.execute("insert into attempts (attempt, identity, worker, host, started) values (?, ?, "
                            "?, ?, ?)",
                            (attempt, identity, worker, host, now()))
        return attempt

    def end(self, attempt: str, state: str, outcome: dict, ended: str = "") -> None:
        """An attempt has ended.

        Args:
            attempt: its name.
            state: of its material from now on: pending (again), done or failed.
            outcome: ``state`` of the attempt, ``reason``, and where known ``seconds``, ``peak_bytes``,
                ``row``.
            ended: the attempt whose result counts, where it is another one.
        """
        facts = {"seconds": None, "peak_bytes": None, "row": None, "reason": ""} | outcome
        facts |= {"attempt": attempt, "material": state, "time": now(), "row": json.dumps(facts["row"]),
                  "published": (ended or attempt) if state == "done" else None}
        with self._change():
            self.db.execute("update attempts set ended = :time, state = :state, reason = :reason, seconds = "
                            ":seconds, "
                            "peak_bytes = :peak_bytes where attempt = :attempt", facts)
            self.db.execute("update materials set state = :material, reason = :reason, seconds = :seconds, "
                            "peak_bytes = :peak_bytes, row = :row, date = :time, published = :published "
                            "where identity = "
                            "(select identity from attempts where attempt = :attempt)", facts)

    def adopt(self, identity: str, record: dict) -> None:
        """A result that lies in the library counts as done: that of an attempt whose end nobody saw."""
        with self._change():
            self.db.execute("update attempts set state = 'done', ended = ?, reason = 'found in the library' "
                            "where attempt = ? "
                            "and identity = ?", (now(), record["attempt"], identity))
            self.db.execute("update materials set state = 'done', reason = '', seconds = ?, row = ?, date = "
                            "?, published = ?, "
                            "attempts = max(attempts, ?) where identity = ?",
                            (record["row"].get("seconds"), json.dumps(record["row"]),
                             record["row"].get("date"),
                             record["attempt"], int(record["attempt"].rpartition("-")[2]), identity))

    def again(self, identity: str, reason: str = "") -> None:
        """A material waits to be fitted (again)."""
        with self._change():
            self.db.execute("update materials set state = 'pending', reason = ?, row = null, published = "
                            "null "
                            "where identity = ?", (reason, identity))

    def interrupted(self) -> None:
        """What was running when an earlier batch died waits again, and its attempts are lost."""
        with self._change():
            self.db.execute("update attempts set state = 'lost', ended = ?, reason = 'the batch ended' "
                            "where state = 'running'", (now(),))
            self.db.execute("update materials set state = 'pending' where state = 'running'")

    def forget(self, identity: str) -> None:
        """Take a material that is wanted no more out of the list."""
        with self._change():
            self.db.execute("delete from attempts where identity = ?", (identity,))
            self.db.execute("delete from materials where identity = ?", (identity,))
