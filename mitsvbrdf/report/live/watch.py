"""What the folder of a fit says now, whether the fit is about to begin, runs, has ended or died."""

from __future__ import annotations

import math
import os
import stat
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...capture.photo import SUFFIXES
from ...errors import OutputError
from ...fit.checkpoint import load_tensors
from ...fit.record import FILE as FIT_FILE
from ...fit.record import record_in
from ...io import images, results
from ...io.files import in_use
from ...material.maps import CHANNELS, TITLES, shown_map

OPENED = "the OUT of `mitsvbrdf fit -o OUT` or the LIBRARY of `mitsvbrdf batch -o LIBRARY`"
REPORT_FILE, SHEET_FILE = "report.html", "sheet.png"
ENDED = {"settled": "settled: going on would change little", "budget": "out of seconds",
         "iterations": "all iterations done",
         "interrupted": "interrupted by Ctrl-C", "unstable": "too many steps had to be undone"}


@dataclass(frozen=True)
class Shown:
    """A state of a fit: a live record, or the ``fit.json`` of a result."""

    note: dict
    maps: dict[str, bytes]  # PNG files by the name of the map
    version: str


class Watch:
    """Looks into a folder that a fit writes to, has written to, or will write to.

    Files may come, go or be half there at any moment: what cannot be read now is as if it were not there. The
    last live record is kept in memory, to be shown where a fit dies and takes its files along.

    Args:
        out: the folder; it need not be there yet.

    Raises:
        OutputError: a file, a folder in a place that is missing, or one with files of others only.
    """

    def __init__(self, out: Path) -> None:
        self.out = Path(os.path.abspath(out))
        self.partial = results.partial_folder(self.out)
        if self.out.exists() and not self.out.is_dir():
            raise OutputError(OPENED, f"the file {out}", "name such a folder")
        if not self.out.parent.is_dir():
            raise OutputError(OPENED, f"{out}, and there is no {self.out.parent}",
                              "check the name, or start the fit or the batch first")
        names = {path.name for path in self.out.iterdir()} if self.out.is_dir() else set()
        ours = {FIT_FILE, REPORT_FILE, results.MANIFEST, self.partial.name}
        if "capture.json" in names or names and not names & ours:
            photos = any(name == "capture.json" or os.path.splitext(name)[1].lower() in SUFFIXES
                         for name in names)
            raise OutputError(OPENED, f"{out}, which {'holds photos' if photos else 'has other files'}",
                              "name such a folder")
        self.record: Shown | None = None
        self.record_time = 0  # when it was written, in ns
        self.result: Shown | None = None
        self.lock = threading.Lock()

    def picture(self, name: str) -> bytes | None:
        """The PNG of a map of the record that :meth:`state` showed last."""
        record = self.record
        return record.maps.get(name) if record else None

    def state(self) -> dict:
        """What to show now, ready for JSON.

        ``phase`` is ``waiting``, ``starting``, ``running``, ``writing``, ``done`` or ``died``, and ``says``
        the same in a sentence. ``report`` and ``sheet`` are the versions of these files, null where there is
        none. The rest is that of the live record, or of ``fit.json``: ``fit``, null where there is neither.
        """
        with self.lock:
            # In this order: whatever happens in between, a fit that ends meanwhile is not taken for one that
            # died.
            there = self._read_record()
            at_work = in_use(self.out)
            finished = _time(self.out / FIT_FILE)
            if at_work:
                if not there:
                    self.record = None  # that of an earlier fit
                stopped = self.record and self.record.note["stopped"]
                phase = "starting" if self.record is None else "writing" if stopped else "running"
            elif (self.record and self.record_time > finished
                  or _time(self.partial / results.CHECKPOINT) > finished):
                phase = "died"
            else:
                self.record = None
                phase = "done" if finished or _time(self.out / REPORT_FILE) else "waiting"
            shown = self._read_result() if phase == "done" else self.record
            return {"phase": phase, "says": self._says(phase, shown), "out": str(self.out),
                    "report": _version(self.out / REPORT_FILE), "sheet": _version(self.out / SHEET_FILE),
                    "fit": shown and {**shown.note, "version": shown.version,
                                      "maps": {name: TITLES[name] for name in shown.maps}}}

    def _says(self, phase: str, shown: Shown | None) -> str:
        stopped = shown.note["stopped"] if shown else None
        why = ENDED.get(stopped, stopped) if stopped else None
        if phase == "died":
            resumes = (self.partial / results.CHECKPOINT).is_file()
            return ("The fit ended without a result. " if shown else "A fit was left unfinished here. ") + (
                "The same command with --resume goes on from its checkpoint." if resumes
                else "Its terminal may say why; the same command starts it anew.")
        return {"waiting": f"No fit in {self.out} yet, and no batch. This page shows one as soon as it "
                           "starts.",
                "starting": "A command is at work here; a fit shows once its first step is set up.",
                "running": "Fitting",
                "writing": f"The fit ended ({why}). Its result is being written.",
                "done": f"The fit ended ({why})." if why else "A finished fit."}[phase]

    def _read_record(self) -> bool:
        """Whether a live record is there; :attr:`record` is the last that could be read."""
        path = self.partial / results.LIVE
        version, written = _version(path), _time(path)
        if version and not (self.record and self.record.version == version):
            try:
                tensors, note = load_tensors(path)
                maps = {name: images.encode_png(shown_map(name, tensors[name].float().nan_to_num()))
                        for name in CHANNELS[note["bsdf"]]}
                shown = {key: note[key] for key in ("run", "method", "renderer", "capture", "bsdf",
                                                    "resolution", "iteration",
                                                    "seconds", "share", "stopped", "latest_is_best", "trace",
                                                    "latest",
                                                    "warnings")}
            # gone by now, half there, or of another version: whatever it is, it is no record
            except Exception:
                return bool(self.record)
            self.record, self.record_time = Shown(_for_json(shown), maps, version), written
        return version is not None

    def _read_result(self) -> Shown | None:
        version = _version(self.out / FIT_FILE)
        if version and not (self.result and self.result.version == version):
            try:
                record = record_in(self.out)
                note = {key: record[key] for key in ("method", "renderer", "bsdf", "stopped", "trace",
                                                     "warnings", "seconds")}
                note |= {"run": None, "capture": record["capture"]["name"],
                         "resolution": record["capture"]["resolution"],
                         "iteration": record["iterations"], "share": 1.0, "latest": None}
                self.result = Shown(_for_json(note), {}, version)
            except (OSError, ValueError, KeyError, TypeError):
                return None
        return self.result if version else None


def _version(path: Path) -> str | None:
    """Changes whenever the file does; None where there is no regular file."""
    try:
        found = path.lstat()
    except OSError:
        return None
    return (f"{found.st_mtime_ns:x}-{found.st_size:x}-{found.st_ino:x}" if stat.S_ISREG(found.st_mode)
            else None)


def _time(path: Path) -> int:
    """When a file was written, in ns; 0 where there is none."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _for_json(value: Any) -> Any:
    """The same without NaN and infinity, which JSON has not."""
    if isinstance(value, dict):
        return {str(key): _for_json(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_for_json(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
